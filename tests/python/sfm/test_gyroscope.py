"""A gyroscope's record: integrated, calibrated by poses, and beside features in the adjustment."""

import dataclasses

import numpy as np
import pytest
from test_look_alikes import OPTIONS, VISIT, mapped, two_visits

import tolerances
from gsut import _core
from gsut.gaussians import find_rotation_vectors
from gsut.sfm.gyroscope import (
    calibrate_turns,
    correct_by_turns,
    find_focal_by_turns,
    sharpen_rates,
    use_gyroscope,
)
from gsut.sfm.gyroscope.calibration import QUARTER_TURNS
from gsut.sfm.gyroscope.curve import TurnCurve
from gsut.sfm.gyroscope.evidence import calibrate_best, hold_near_record
from gsut.sfm.lens import judge_lens
from gsut.sfm.lens.prior import find_focal
from gsut.sfm.mapping import Mapping, PosesLog
from gsut.sfm.photographs import Photographs
from made_flight import LENS, fly_again

APART = 0.5  # seconds between pictures
HERTZ = 200.0
BIAS = np.array([0.008, -0.005, 0.003])  # rad/s
NOISE = 0.003  # rad/s of a sample
TURN = 0.06  # radians about the vertical from one picture of a flight to the next


def record(rotations, rng, offset=0.0, axes=None, bias=BIAS, noise=NOISE, scale=1.0):
    """A record (N, 4) of a camera that turns evenly from each of its poses (F, 3, 3) to the next.

    offset: seconds by which it is late. axes: camera_from_sensor.
    """
    vectors = find_rotation_vectors(rotations[1:] @ rotations[:-1].transpose(0, 2, 1))
    times = np.arange(-1.0, APART * len(rotations) + 1.0, 1 / HERTZ)
    interval = np.floor((times - offset) / APART + 1e-9).astype(int)
    inside = (interval >= 0) & (interval < len(vectors))
    rates = np.where(inside[:, None], -vectors[np.clip(interval, 0, len(vectors) - 1)] / APART, 0)
    rates = scale * rates @ (np.eye(3) if axes is None else axes)
    return np.column_stack([times, rates + bias + noise * rng.standard_normal(rates.shape)])


def make_walk(rng, count=40):
    """Poses' rotations (F, 3, 3) of a camera that a hand turns, and the times of their pairs."""
    rotations = [np.eye(3)]
    for vector in 0.08 * rng.standard_normal((count, 3)):
        rotations.append(_core.exp_pose([0, 0, 0, *vector])[:3, :3] @ rotations[-1])
    times = APART * np.arange(len(rotations))
    return np.array(rotations), np.stack([times[:-1], times[1:]], axis=1)


def step_between(rotations):
    return rotations[1:] @ rotations[:-1].transpose(0, 2, 1)


def test_curve_of_a_record_without_errors_has_the_turns_of_the_poses(rng):
    rotations, times = make_walk(rng)
    curve = TurnCurve(record(rotations, rng, bias=0, noise=0), np.zeros(3))
    found = curve.find_turns(*times.T).rotations
    assert np.abs(found - step_between(rotations)).max() < tolerances.GYROSCOPE_INTEGRAL


@pytest.mark.parametrize("unknown", ["bias", "offset"])
def test_curve_derivatives_agree_with_differences(unknown, rng):
    rotations, times = make_walk(rng)
    rates, step = record(rotations, rng), 1e-6
    inner = times + np.full(2, 0.1012)  # away from where rates jump
    found = TurnCurve(rates, np.zeros(3)).find_turns(*inner.T)
    if unknown == "bias":
        bias = np.array([step, 0, 0])
        changed, by = TurnCurve(rates, bias).find_turns(*inner.T), found.by_bias[:, :, 0]
    else:
        changed, by = TurnCurve(rates, np.zeros(3)).find_turns(*(inner + step).T), found.by_offset
    difference = (
        find_rotation_vectors(changed.rotations @ found.rotations.transpose(0, 2, 1)) / step
    )
    assert np.abs(difference - by).max() < tolerances.GYROSCOPE_DERIVATIVES * np.abs(by).max()


def test_curve_knows_no_turn_over_a_gap(rng):
    rotations, times = make_walk(rng)
    rates = record(rotations, rng)
    rates[np.searchsorted(rates[:, 0], 3.2), 1:] = np.nan
    unknown = np.isnan(TurnCurve(rates, BIAS).find_turns(*times.T).rotations).any(axis=(1, 2))
    assert np.flatnonzero(unknown).tolist() == [6]


@pytest.mark.parametrize("seed", range(3))
def test_calibration_finds_axes_delay_and_bias(seed):
    rng = np.random.default_rng(seed)
    rotations, times = make_walk(rng)
    small = _core.exp_pose([0, 0, 0, 0.03, -0.02, 0.04])[:3, :3]
    axes = small @ QUARTER_TURNS[5 + 3 * seed]
    found = calibrate_turns(
        record(rotations, rng, offset=0.035, axes=axes), times, step_between(rotations)
    )
    assert found is not None and found.explained > 0.99 and found.used.all()
    assert abs(found.offset - 0.035) < tolerances.GYROSCOPE_OFFSET_SECONDS
    assert np.abs(found.bias - BIAS).max() < tolerances.GYROSCOPE_BIAS
    assert np.abs(found.camera_from_sensor - axes).max() < tolerances.GYROSCOPE_AXES
    assert abs(found.scale - 1) < tolerances.GYROSCOPE_SCALE


def test_calibration_leaves_out_poses_that_are_wrong(rng):
    rotations, times = make_walk(rng)
    steps = step_between(rotations)
    steps[7] = _core.exp_pose([0, 0, 0, 0.5, 0.5, 0])[:3, :3] @ steps[7]
    found = calibrate_turns(record(rotations, rng), times, steps)
    assert np.flatnonzero(~found.used).tolist() == [7]
    assert found.explained > 0.99


def test_record_of_another_film_explains_nothing(rng):
    rotations, times = make_walk(rng)
    found = calibrate_turns(record(make_walk(rng)[0], rng), times, step_between(rotations))
    assert found.explained < 0.5


def fly_recorded(rates_of, seed=1, relief=0.02, turn=TURN):
    """A flight over ground with a record of its turns."""
    run = fly_again(seed, relief, turn=turn)
    names, rng = run.solved.names, np.random.default_rng(seed)
    truth = [_core.exp_pose([0, 0, 0, 0, turn * (i % 3), turn * i]) for i in range(len(names))]
    photographs = dataclasses.replace(
        run.photographs,
        times={name: APART * i for i, name in enumerate(names)},
        turns={"gyroscope": rates_of(np.array(truth)[:, :3, :3], rng)},
    )
    return dataclasses.replace(run, photographs=photographs)


def fly_with(rates_of, seed=1, relief=0.02, turn=TURN):
    """Such a flight, judged with and without its record."""
    bare = fly_again(seed, relief, turn=turn)
    found = find_focal_by_turns(use_gyroscope(fly_recorded(rates_of, seed, relief, turn)))
    return judge_lens(found), judge_lens(bare)


@pytest.mark.parametrize("seed", range(1, 4))
def test_focal_length_of_a_flight_over_flat_ground_is_that_of_the_gyroscope(seed):
    found, bare = fly_with(record, seed)
    figures = found.found.figures["gyroscope"]
    assert figures["used"] == "gyroscope" and figures["explained"]["gyroscope"] > 0.99
    before, after = (each.found.figures["focal_sigma_percent"] for each in (bare, found))
    assert after < 0.7 * before
    off = 100 * abs(find_focal(found.solved) / LENS.params[0] - 1)
    assert off < tolerances.GYROSCOPE_FOCAL_SIGMAS * after
    assert found.found.figures["focal_prior"]["sigma_percent"] == after


def test_focal_sigma_covers_a_gyroscope_of_wrong_scale():
    found, _ = fly_with(lambda truth, rng: record(truth, rng, scale=1.03), turn=0.2)
    figures = found.found.figures
    prior = figures["focal_prior"]
    assert prior["source"] == "the gyroscope" and not prior["agrees"]
    off = 100 * abs(find_focal(found.solved) / LENS.params[0] - 1)
    assert off < tolerances.GYROSCOPE_FOCAL_SIGMAS * figures["focal_sigma_percent"]


def test_gyroscope_of_another_film_changes_nothing():
    other = make_walk(np.random.default_rng(5), 12)[0]
    found, bare = fly_with(lambda _, rng: record(other, rng))
    assert found.found.figures["gyroscope"]["used"] is None
    assert "is not used" in " ".join(found.log.notes)
    assert np.array_equal(found.solved.camera_from_world, bare.solved.camera_from_world)


def test_structure_held_near_a_record_that_is_rejected_is_adjusted_without_it():
    run = fly_recorded(lambda truth, rng: record(truth, rng, scale=1.03), turn=0.2)
    held, _ = hold_near_record(run, calibrate_best(run))
    other = fly_recorded(lambda _, rng: record(make_walk(rng, 12)[0], rng), turn=0.2)
    found = use_gyroscope(held.replace(photographs=other.photographs))
    off = [
        np.abs(each.solved.camera_from_world - run.solved.camera_from_world).max()
        for each in (held, found)
    ]
    assert off[1] < tolerances.GYROSCOPE_ADJUSTED_AGAIN < off[0] / 1000
    assert held.turns is not None and found.turns is None
    assert found.found.figures["gyroscope"]["used"] is None
    assert "is not used" in " ".join(found.log.notes)


def test_accelerometer_in_the_gyroscopes_axes_gives_up_in_the_cameras():
    run = fly_recorded(lambda truth, rng: record(truth, rng, axes=QUARTER_TURNS[9]))
    up = QUARTER_TURNS[9].T @ np.array([0.0, -1.0, 0.0])
    ups = {name: tuple(up) for name in run.solved.names}
    run = run.replace(photographs=dataclasses.replace(run.photographs, sensor_ups=ups))
    found = use_gyroscope(run).photographs.ups
    assert len(found) == len(ups)
    assert np.abs(np.array(list(found.values())) - [0, -1, 0]).max() < tolerances.GYROSCOPE_UP


def test_film_without_a_record_keeps_its_run():
    run = fly_again(1, 0.02)
    assert use_gyroscope(run) is run


def test_velocities_take_the_recorded_turn_and_a_better_shift(rng):
    run = fly_again(1, 0.02, turn=TURN)
    names = run.solved.names
    record_of = record(run.solved.camera_from_world[:, :3, :3], rng)
    photographs = dataclasses.replace(
        run.photographs,
        times={name: APART * i for i, name in enumerate(names)},
        turns={"gyroscope": record_of, "orientations": record_of},
    )
    run = run.replace(photographs=photographs)
    # A turn about y by e is mistaken for a shift along x by -e.
    error = rng.normal(0, 0.1, len(names))
    mistaken = np.array([-1.0, 0, 0, 0, 1, 0])
    turns = np.array([[0, 0, 0, 0, *steps[1:]] for steps in _turns_at_pictures(run)])
    spread = np.tile(0.1**2 * np.outer(mistaken, mistaken) + 1e-6 * np.eye(6), (len(names), 1, 1))
    rates = turns + error[:, None] * mistaken
    rates[3] = np.nan
    found, after = sharpen_rates(run, (rates, spread))
    known = np.isfinite(found).all(axis=1)
    assert np.flatnonzero(~known).tolist() == [3]
    inner = known & (np.arange(len(names)) > 0) & (np.arange(len(names)) < len(names) - 1)
    assert np.abs(found - turns)[inner].max() < tolerances.GYROSCOPE_VELOCITIES
    assert after[inner][:, 0, 0].max() < 0.1 * spread[0, 0, 0]
    stabilised = dataclasses.replace(photographs, turns={"orientations": record_of})
    unchanged = sharpen_rates(run.replace(photographs=stabilised), (rates, spread))
    assert unchanged[0] is rates and unchanged[1] is spread


def _turns_at_pictures(run):
    """Rates (F, 3) about each picture: the mean of those before and after it."""
    vectors = find_rotation_vectors(step_between(run.solved.camera_from_world[:, :3, :3])) / APART
    padded = np.concatenate([np.zeros((1, 3)), vectors, np.zeros((1, 3))])
    return (padded[1:] + padded[:-1]) / 2


def test_wrong_pose_is_corrected_where_the_record_contradicts_it():
    run = fly_recorded(record, relief=0.2)
    poses, wrong = run.solved.camera_from_world.copy(), 5
    poses[wrong] = _core.exp_pose([0, 0, 0, 0.0, 0.03, 0.02]) @ poses[wrong]
    found = correct_by_turns(
        run.replace(solution=dataclasses.replace(run.solved, camera_from_world=poses))
    )
    off = find_rotation_vectors(
        step_between(found.solved.camera_from_world[:, :3, :3])
        @ step_between(run.solved.camera_from_world[:, :3, :3]).transpose(0, 2, 1)
    )
    assert found.solved.registered.all() and found.turns is not None
    assert np.abs(off).max() < tolerances.GYROSCOPE_CORRECTED
    assert correct_by_turns(run) is run


def visit_rooms(rng, turned):
    """Two visits to rooms that look the same, as one; the record turns in between."""
    scene = two_visits(rng, same_room=True)
    away = _core.exp_pose([0, 0, 0, 0, turned, 0])[:3, :3]
    rotations = scene.poses[:, :3, :3].copy()
    rotations[VISIT:] = rotations[VISIT:] @ away
    photographs = Photographs(
        None, scene.names, [], [None] * len(scene.names), [scene.camera] * len(scene.names),
        times={name: APART * i for i, name in enumerate(scene.names)},
        turns={"gyroscope": record(rotations, rng)},
    )  # fmt: skip
    solution = mapped(scene, scene.pairs)
    assert solution.registered.all()
    return Mapping(
        photographs, OPTIONS, PosesLog(), features=scene.features, pairs=scene.pairs,
        solution=solution,
    )  # fmt: skip


def test_rooms_that_look_the_same_are_two_where_the_record_turns(rng):
    run = visit_rooms(rng, 2.5)
    found = correct_by_turns(run)
    assert found.solved.registered.reshape(2, VISIT).all(axis=1).sum() == 1
    assert found.solved.num_registered == VISIT
    assert all((pair.first < VISIT) == (pair.second < VISIT) for pair in found.pairs)
    assert "contradicts" in " ".join(found.log.notes)


def test_room_visited_twice_is_one_where_the_record_agrees(rng):
    run = visit_rooms(rng, 0.0)
    assert correct_by_turns(run) is run
