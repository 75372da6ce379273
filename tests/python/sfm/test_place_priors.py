"""Places of GPS in the adjustment: flights over flat ground, with noise and with wrong places."""

import dataclasses

import numpy as np
import pytest

import tolerances
from gsut import _core
from gsut.data.poses import find_centers
from gsut.sfm.mapping import PosesLog
from gsut.sfm.rig import adjust_rig_near_places
from gsut.sfm.solution import similarity_from_points
from gsut.sfm.world import place_on_earth
from made_flight import CENTERS, fly, fly_again

METRES = 20.0  # in a unit of the flight's world: 200 m above the ground
ORIGIN = (47.37, 8.54, 430.0)
NORTH, EAST = 111_180.0, 75_540.0  # metres in a degree there


def state_places(truth, rng, noise, wrong=0, bowl=0.0):
    """States places with errors of so many metres, twice that in height.

    wrong: images whose places are of elsewhere. bowl: metres that heights rise at the rim.
    """
    metres = truth * METRES * [1, -1, -1] + noise * rng.standard_normal(truth.shape) * [1, 1, 2]
    away = (truth[:, :2] ** 2).sum(axis=1)
    metres[:, 2] += bowl * away / away.max()
    metres[:wrong, 0] += 300.0
    rows = ORIGIN + metres[:, [1, 0, 2]] / [NORTH, EAST, 1]
    return {f"{i:02d}.jpg": tuple(row) for i, row in enumerate(rows)}


def place(run, places):
    """Places a flight on the earth: the run, its notes, and metres that the ground is a dome."""
    run = dataclasses.replace(
        run, log=PosesLog(), found=type(run.found)(rig=run.found.rig),
        photographs=dataclasses.replace(run.photographs, places=places),
    )  # fmt: skip
    run = place_on_earth(run, adjust_rig_near_places)
    return run, run.log.notes, measure_dome(run.solved)


def measure_dome(solution):
    """Measures by how many metres the ground rises from the middle to the rim of the flight."""
    scale, rotation, shift = similarity_from_points(
        find_centers(solution.camera_from_world)[: len(CENTERS)], CENTERS
    )
    x, y, z = (scale * solution.points @ rotation.T + shift).T
    columns = np.stack([np.ones_like(x), x, y, x**2 + y**2], axis=1)
    rise = np.linalg.lstsq(columns, z, rcond=None)[0][3]
    return METRES * abs(rise) * (CENTERS**2).sum(axis=1).max()


@pytest.fixture(scope="module")
def flights():
    return [fly_again(seed, relief=0.02) for seed in (1, 2, 3)]


def test_exact_places_flatten_the_dome_over_flat_ground(flights):
    before, after = [], []
    for seed, run in enumerate(flights):
        places = state_places(CENTERS, np.random.default_rng(seed), 0.1)
        placed, notes, dome = place(run, places)
        before.append(measure_dome(run.solved))
        after.append(dome)
        assert placed.found.figures["earth"]["gps"]["in_adjustment"]
        assert "took part in the adjustment" in notes[-1]
    assert len(after) == 3 and np.mean(after) < tolerances.GPS_DOME_SHARE * np.mean(before)


SPEED = 0.3  # along x during a readout
SIDE = _core.exp_pose([0.3, 0.1, 0.0, 0.0, 0.0, 0.2])  # a second camera that looks down as well


def place_exactly(seed, **settings):
    """Places a made flight by exact places: the run, and its dome before and after."""
    run = fly(np.random.default_rng(seed), relief=0.02, **settings)
    truth = find_places(settings.get("mounts", ()))
    placed, notes, dome = place(run, state_places(truth, np.random.default_rng(seed), 0.1))
    assert placed.found.figures["earth"]["gps"]["in_adjustment"], notes
    return placed, measure_dome(run.solved), dome


def test_exact_places_flatten_the_dome_under_a_rolling_shutter():
    domes = []
    for seed in (1, 2):
        placed, *dome = place_exactly(seed, speed=SPEED)
        domes.append(dome)
        speed = np.linalg.norm(placed.solved.velocities[:, :3], axis=1)
        assert speed == pytest.approx(SPEED * METRES, rel=tolerances.GPS_RATE)
    before, after = np.mean(domes, axis=0)
    assert len(domes) == 2 and after < tolerances.GPS_ROLLING_DOME * before


def test_places_of_a_rolling_rig_keep_its_cameras_on_it():
    placed, before, after = place_exactly(1, speed=SPEED, mounts=[SIDE])
    assert after < tolerances.GPS_NOISY_DOME * before
    solution, rig = placed.solved, placed.found.rig.rig
    first, second = solution.camera_from_world[:12], solution.camera_from_world[12:]
    mount = rig.camera_from_reference[1]
    assert np.abs(mount @ first - second).max() < tolerances.GPS_RIG_RIGID
    length = np.linalg.norm(SIDE[:3, 3]) * METRES
    assert rig.baseline == pytest.approx(length, rel=tolerances.GPS_RIG_SIZE)


def find_places(mounts):
    """Where the cameras of a flight without turns stood, (N, 3)."""
    seats = [np.zeros(3), *(find_centers(np.array([mount]))[0] for mount in mounts)]
    return np.concatenate([CENTERS + seat for seat in seats])


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_noisy_places_leave_what_the_images_know_better(flights, noise):
    ratios = []
    for seed, run in enumerate(flights):
        places = state_places(CENTERS, np.random.default_rng(seed), noise)
        _, _, dome = place(run, places)
        ratios.append((measure_dome(run.solved), dome))
    before, after = np.mean(ratios, axis=0)
    assert after < tolerances.GPS_NOISY_DOME * before


def test_places_of_elsewhere_stay_out_and_wrong_heights_are_named(flights):
    rng = np.random.default_rng(9)
    places = state_places(CENTERS, rng, 0.1, wrong=2)
    placed, _, dome = place(flights[0], places)
    assert placed.found.figures["earth"]["gps"]["in_adjustment"]
    assert dome < measure_dome(flights[0].solved)
    placed, notes, dome = place(flights[0], state_places(CENTERS, rng, 0.1, bowl=12.0))
    assert not placed.found.figures["earth"]["gps"]["in_adjustment"]
    assert "the images contradict" in notes[-1]
    assert dome == pytest.approx(measure_dome(flights[0].solved))
