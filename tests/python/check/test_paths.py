"""Errors along a path are named: breaks, scales that change, open loops, lines taken for one."""

import types

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut.check import breaks
from gsut.check.breaks import _find_break, _Triple, check_scale
from gsut.check.drift import check_drift
from gsut.check.evidence import gather_evidence
from gsut.check.far_poses import check_far_pose
from gsut.check.lens_errors import name_other_model
from gsut.check.matches import _CLOSE, _QUICK, ImagePair, _choose_pairs
from gsut.check.photographs import check_closely, check_photographs
from gsut.check.shutter import _measure_speeds, check_timing, fit_timing, move_poses
from gsut.check.turns import rate_as_degrees, to_rotation_vector

LENS = gsut.Camera("pinhole", [150.0, 150.0, 120.0, 90.0], 240, 180)
VIEWS = 48  # two laps of a circle, looking outwards: images of the second lap close loops
NOISE = 0.2  # pixels
POINTS = 600


def make_laps(count=VIEWS):
    """Poses (count, 4, 4) world_from_camera of two laps of a circle."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, angle in zip(poses, 4 * np.pi * np.arange(count) / count, strict=True):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        pose[:3, :3] = np.stack([np.cross(down, out), down, out], axis=1)
        pose[:3, 3] = 1.5 * out + [0.0, 0.0, 0.2 * np.sin(3 * angle)]
        pose[:] = pose @ gsut.exp_pose([0, 0, 0, 0.1 * np.sin(5 * angle), 0, 0.1 * np.cos(angle)])
    return poses


def make_walk(bend=0.08):
    """Poses (24, 4, 4) world_from_camera of a walk forwards, which turns by some radians a step."""
    poses = np.tile(np.eye(4), (24, 1, 1))
    for k in range(1, len(poses)):
        turn = bend * np.array([0.25 * np.sin(k), np.cos(k / 4), 0.25 * np.cos(k)])
        step = gsut.exp_pose([0.02 * np.sin(k), 0.02 * np.cos(2 * k), 0.15, *turn])
        poses[k] = poses[k - 1] @ step
    return poses


def observe(poses, rng, readout=0.0, lens=LENS):
    """Pixels (V, P, 2) of points through poses, a line each where read out; NaN: not seen."""
    points = rng.normal(size=(POINTS, 3))
    points *= rng.uniform(4.0, 8.0, (POINTS, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    scene = make_scene(poses)
    speeds = _measure_speeds(scene)
    pixels = np.full((len(poses), len(points), 2), np.nan)
    for view, pose in enumerate(poses):
        line = np.zeros(len(points))
        for _ in range(6 if readout else 1):
            moved = move_poses(
                np.tile(pose, (len(points), 1, 1)),
                np.tile(speeds[view], (len(points), 1)), readout * line,
            )  # fmt: skip
            seen = np.einsum("pji,pj->pi", moved[:, :3, :3], points - moved[:, :3, 3])
            found, valid = lens.project(seen)
            line = np.clip(np.nan_to_num(found[:, 1]) / LENS.height - 0.5, -0.5, 0.5)
        inside = np.asarray(valid) & ((found > 0) & (found < [240, 180])).all(axis=1)
        pixels[view, inside] = found[inside] + NOISE * rng.normal(size=(inside.sum(), 2))
    return pixels


def make_scene(poses, lens=LENS):
    images = [np.zeros((lens.height, lens.width, 3), np.uint8)] * len(poses)
    return gsut.scene_from_arrays(images, lens, np.linalg.inv(poses), test_every=0)


def gather(poses, pixels, look=_CLOSE, lens=LENS):
    """Evidence of exact matches beside given poses, in the pairs of a look."""
    scene, pairs = make_scene(poses, lens), []
    for a, b in _choose_pairs(scene, look):
        both = np.isfinite(pixels[[a, b]]).all(axis=(0, 2))
        if both.sum() >= 16:
            pairs.append(ImagePair(a, b, pixels[[a, b]][:, both]))
    return gather_evidence(scene, pairs)


def list_texts(evidence):
    found = check_closely(evidence)
    return [str(each) for each in found if each.severity != "info"]


def add_steps(poses, change):
    """Sums a path anew from its steps, each changed by a function of the step."""
    new = poses.copy()
    for k in range(1, len(poses)):
        new[k] = new[k - 1] @ change(np.linalg.inv(poses[k - 1]) @ poses[k], k)
    return new


def test_exact_path_is_not_accused(rng):
    poses = make_laps()
    evidence = gather(poses, observe(poses, rng))
    loops = sum(pair.second - pair.first >= VIEWS / 4 for pair in evidence.pairs)
    assert loops == 12
    assert list_texts(evidence) == []
    assert check_timing(evidence, most=1.0) == []


def test_path_that_does_not_close_is_named(rng):
    poses = make_laps()
    turn = gsut.exp_pose([0, 0, 0, 0, np.radians(12.0 / VIEWS), 0])
    said = list_texts(gather(add_steps(poses, lambda step, _: step @ turn), observe(poses, rng)))
    assert any("path of the poses does not close" in text for text in said), said


def test_turn_that_grows_along_an_open_path_is_named(rng):
    poses = make_walk()
    pixels = observe(poses, rng)
    assert check_drift(gather(poses, pixels, _QUICK)) == []
    for degrees in (4.0, 15.0):
        turn = gsut.exp_pose([0, 0, 0, 0, np.radians(degrees / 23), 0])
        wrong = gather(add_steps(poses, lambda step, _, turn=turn: turn @ step), pixels, _QUICK)
        said = [str(each) for each in check_drift(wrong)]
        assert any("accumulate from 000000 to 000023" in text for text in said), said
    (said,) = check_photographs(wrong.scene, wrong)
    assert "contradict the poses" in said.what and "accumulate" in said.what, said


def test_rotations_in_degrees_are_told_from_those_of_another_run(rng):
    poses = make_walk()
    pixels = observe(poses, rng)
    wrong = poses.copy()
    for pose, right in zip(wrong, poses, strict=True):
        pose[:3, :3] = cv2.Rodrigues(np.degrees(to_rotation_vector(right[:3, :3])))[0]
    assert rate_as_degrees(gather(wrong, pixels, _QUICK)) > 0.9
    straight = make_walk(bend=0.0)
    pixels = observe(straight, rng)
    other = straight.copy()
    for k, pose in enumerate(other):
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.26 * k, 0.0]))[0]
    assert rate_as_degrees(gather(other, pixels, _QUICK)) is None


def test_coefficients_that_move_few_pixels_are_named(rng):
    focal, k1, k2, p1, p2, k3 = [165.0, 165.0, 121.5, 92.0], -0.3, 0.11, 1e-3, -1e-3, -0.02
    right = gsut.Camera("opencv5", [*focal, k1, k2, p1, p2, k3], 240, 180)
    wrong = gsut.Camera("opencv5", [*focal, k1, k2, k3, p1, p2], 240, 180)
    poses = make_walk()
    pixels = observe(poses, rng, lens=right)
    exact = gather(poses, pixels, _QUICK, right)
    assert name_other_model(exact) == []
    (said,) = check_photographs(exact.scene, exact)
    assert "agree with poses and lens" in said.what, said
    misread = gather(poses, pixels, _QUICK, wrong)
    (said,) = check_photographs(misread.scene, misread)
    assert "in the order k1 k2 k3 p1 p2" in said.what, said


def test_half_of_the_path_in_another_world_is_named(rng):
    poses = make_laps()
    wrong = poses.copy()
    world = gsut.exp_pose([0.8, -0.6, 0.5, 0.0, 0.0, 0.4])
    wrong[24:] = world @ poses[24:]
    said = list_texts(gather(wrong, observe(poses, rng)))
    assert any("break between 000023 and 000024" in text for text in said), said


def test_scale_of_half_of_the_path_is_named(rng):
    poses = make_laps()
    wrong = poses.copy()
    wrong[24:, :3, 3] = poses[24, :3, 3] + 1.5 * (poses[24:, :3, 3] - poses[24, :3, 3])
    said = [str(each) for each in check_scale(gather(wrong, observe(poses, rng)))]
    assert any("changes by a factor of" in text for text in said), said


def test_far_camera_is_accused_unless_photographs_support_it(rng):
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = [0.0, 0.1, 0.2, 0.3, 0.4, 1.5]
    pixels = observe(poses, rng)
    assert check_far_pose(make_scene(poses), gather(poses, pixels)) == []
    wrong = poses.copy()
    wrong[5, 1, 3] = 9.0
    (said,) = check_far_pose(make_scene(wrong), gather(wrong, pixels))
    assert "000005 stands farther from all other cameras" in said.what
    assert len(check_far_pose(make_scene(poses), None)) == 1


def test_break_needs_more_contradictions_than_repeated_things_make():
    good = [(k, k + 1) for k in range(20)] + [(k, k + 2) for k in range(20)]
    far = [pair for pair in good if not pair[0] <= 9 < pair[1]]
    across = [(9, 10), (8, 10), (9, 11)]
    assert _find_break(across, far, [], across) == 9
    assert _find_break(across[:1], far, [], across) is None  # one pair may be an exception
    assert _find_break(across, [*far, (8, 11)], [], across) is None  # a pair across fits
    assert _find_break(across, far, [], near=[]) is None  # loops alone: a path that drifts
    often = [(k, k + 3) for k in (0, 2, 4, 12, 14, 16)]
    assert _find_break([*across, *often], far, [], across) is None  # as elsewhere
    assert _find_break([*across[:2], *often], far, across[:2], across) == 9  # these are sure


@pytest.mark.parametrize("readout", [0.3, -0.2])
def test_rolling_shutter_taken_for_a_global_one_is_named(readout, rng):
    poses = make_laps()
    evidence = gather(poses, observe(poses, rng, readout))
    found = fit_timing(evidence)
    print(found)
    assert abs(found.frames[0] - readout) < tolerances.READOUT_FRAMES
    said = [str(each) for each in check_timing(evidence, most=0.5)]
    way = "first to the last" if readout > 0 else "last to the first"
    assert any("rolling shutter" in text and way in text for text in said), said


def test_poses_of_a_late_clock_are_named(rng):
    angle = 2 * np.pi * np.arange(VIEWS) / VIEWS
    times = 12 * (angle + 0.25 * np.sin(3 * angle)) / np.pi  # of the views, on a smooth path
    path = [make_smooth(time) for time in (times, times + 0.4 * np.gradient(times))]
    evidence = gather(path[1], observe(path[0], rng), _QUICK)
    print(fit_timing(evidence))
    (said,) = check_timing(evidence, most=0.5)
    assert "frames earlier" in said.what, said


def make_smooth(times):
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    for pose, time in zip(poses, times, strict=True):
        pose[:] = gsut.exp_pose([0, 0, 0, 0, 0.2 * time, 0])
        pose[:3, 3] = [0.3 * time, 0.2 * np.sin(time / 2), 0.1 * time]
    return poses


@pytest.mark.parametrize(("freedom", "named"), [(6.0, False), (60.0, True)])
def test_scale_by_few_features_may_change_by_chance(freedom, named, monkeypatch):
    changes = [*np.random.default_rng(0).normal(0, 0.03, 40), 0.29]
    triples = [_Triple((k, k + 1, k + 2), 1, change, 0.05, freedom)
               for k, change in enumerate(changes)]  # fmt: skip
    monkeypatch.setattr(breaks, "_measure_triples", lambda _: triples)
    monkeypatch.setattr(breaks, "order_in_time", lambda _: [list(range(43))])
    views = [types.SimpleNamespace(name=str(number)) for number in range(43)]
    evidence = types.SimpleNamespace(
        scene=types.SimpleNamespace(views=views), make_finding=lambda *words: words
    )
    said = [what for _, what, _ in check_scale(evidence)]
    assert ["between 40 and 42" in what for what in said] == [True] * named
