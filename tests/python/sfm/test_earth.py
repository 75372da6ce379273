"""Up, north and metres of poses, from how cameras were held and from GPS; or not."""

import dataclasses
import math

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.sfm.solution.result import Solution
from gsut.sfm.world.earth import find_earth, find_stated_up, move_to_earth

COUNT = 24
SCALE = 7.0  # metres in a unit of the world
ORIGIN = (47.37, 8.54, 430.0)
NORTH = 111_180.0  # metres in a degree of latitude there
EAST = 75_540.0  # of longitude
PANORAMA = gsut.Camera("equirectangular", [], 400, 200)


def make_walk(rng, size=30.0, roll=3.0, heading=300.0, pitch=0.2):
    """A walk of level cameras in a world turned anyhow, and its centres: east, up, north (m)."""
    share = np.linspace(0, 1, COUNT)
    east = size * (np.cos(4 * share) + 0.3 * share)
    north = size * np.sin(4 * share)
    truth = np.stack([east, 0.02 * size * np.sin(9 * share), north], axis=1)
    turn = _core.exp_pose([0, 0, 0, 0.7, -1.1, 0.4])[:3, :3]
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    for i in range(COUNT):
        # East, down, north: x right, y down, z forward.
        angle = math.radians(heading * share[i])
        level = _core.exp_pose([0, 0, 0, 0, angle, 0])[:3, :3]
        held = _core.exp_pose([0, 0, 0, pitch, 0, math.radians(roll) * rng.standard_normal()])
        rotation = held[:3, :3] @ level @ turn.T
        center = turn @ (truth[i] * [1, -1, 1]) / SCALE + [3, -5, 2]
        poses[i, :3, :3], poses[i, :3, 3] = rotation, -rotation @ center
    names = [f"{i:02d}.jpg" for i in range(COUNT)]
    empty = np.zeros((0, 3))
    flat = np.zeros((0, 3), np.int32)
    solution = Solution(
        names, [], np.ones(COUNT, bool), poses, np.tile(np.eye(6), (COUNT, 1, 1)),
        np.array([[1.0, 2.0, 3.0]]), empty.astype(np.uint8), np.zeros(1), flat, empty[:, :2],
        empty[:, :2], np.zeros(0), (0, 1), 0, 0.1, 0.1,
    )  # fmt: skip
    return solution, truth


def gps(truth, rng, noise):
    """Places with errors of so many metres, three times that in height."""
    off = truth + noise * rng.standard_normal(truth.shape) * [1, 3, 1]
    rows = ORIGIN + off[:, [2, 0, 1]] / [NORTH, EAST, 1]
    return {f"{i:02d}.jpg": tuple(row) for i, row in enumerate(rows)}


def upright(solution):
    return dict.fromkeys(solution.names, 1)


def centers(solution):
    poses = solution.camera_from_world
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])


@pytest.mark.parametrize(("noise", "wrong"), [(0.02, 0), (1.5, 0), (1.5, 4)])
def test_gps_gives_metres_north_and_up(noise, wrong):
    rng = np.random.default_rng(1)
    solution, truth = make_walk(rng)
    places = gps(truth, rng, noise)
    for name in list(places)[:wrong]:  # of another moment
        latitude, longitude, height = places[name]
        places[name] = (latitude + 0.001, longitude, height)
    earth = find_earth(solution, upright(solution), places)
    assert earth.figures["gps"]["applied"] and "metres and north" in earth.notes[0]
    assert earth.scale == pytest.approx(SCALE, rel=0.002 + 0.02 * noise)
    found = centers(move_to_earth(solution, earth))
    moved = (found - found.mean(axis=0)) * [1, -1, 1] - (truth - truth.mean(axis=0))
    assert np.abs(moved[:, [0, 2]]).max() < tolerances.SFM_EARTH_METRES + 1.2 * noise
    assert np.abs(moved[:, 1]).max() < tolerances.SFM_EARTH_HEIGHT + noise


def test_moved_solution_sees_its_points_as_before():
    rng = np.random.default_rng(2)
    solution, truth = make_walk(rng)
    earth = find_earth(solution, upright(solution), gps(truth, rng, 0.1))
    moved = move_to_earth(solution, earth)
    before, after = (
        s.camera_from_world[:, :3, :3] @ s.points[0] + s.camera_from_world[:, :3, 3]
        for s in (solution, moved)
    )
    assert np.abs(after - earth.scale * before).max() < 1e-9
    assert np.trace(moved.covariances[0, :3, :3]) == pytest.approx(3 * earth.scale**2)


def test_gps_of_a_room_gives_no_scale_but_cameras_tell_up():
    rng = np.random.default_rng(3)
    solution, truth = make_walk(rng, size=2.0)
    earth = find_earth(solution, upright(solution), gps(truth, rng, 4.0))
    assert not earth.figures["gps"]["applied"] and earth.scale == 1.0
    assert "scale and north stay open" in earth.notes[0]
    down = earth.rotation @ np.linalg.svd(solution.camera_from_world[:, 0, :3])[2][-1]
    assert abs(down[1]) > math.cos(math.radians(2))


def test_gps_that_contradicts_the_poses_is_named_and_not_used():
    rng = np.random.default_rng(4)
    solution, truth = make_walk(rng)
    earth = find_earth(solution, upright(solution), gps(truth[rng.permutation(COUNT)], rng, 0.1))
    assert "contradicts" in earth.notes[0] and earth.scale == 1.0


@pytest.mark.parametrize("along_view", [True, False])
def test_straight_flight_takes_up_from_its_slope_and_level_cameras(along_view):
    rng = np.random.default_rng(7)
    solution, _ = make_walk(rng, heading=0.0, roll=1.0)
    # Ahead with a slope, as the cameras look; or sideways, which says nothing of how they tilt.
    share = np.linspace(0, 1, COUNT)[:, None]
    truth = 40.0 * share * ([0.0, 0.2, 1.0] if along_view else [1.0, 0.0, 0.0])
    turn = _core.exp_pose([0, 0, 0, 0.7, -1.1, 0.4])[:3, :3]
    for pose, center in zip(solution.camera_from_world, truth * [1, -1, 1] / SCALE, strict=True):
        pose[:3, 3] = -pose[:3, :3] @ turn @ center
    earth = find_earth(solution, upright(solution), gps(truth, rng, 0.3))
    assert earth.figures["gps"]["applied"] is along_view
    if along_view:
        assert "path of GPS" in earth.figures["up"]
        assert earth.scale == pytest.approx(SCALE, rel=0.02)
        down = earth.rotation @ turn @ [0, 1, 0]
        assert down[1] > math.cos(math.radians(4))
    else:
        assert "which way is up" in earth.notes[0] or earth.figures["up"] == "by the cameras"


def test_panoramas_of_one_direction_are_level_and_gps_takes_up_from_them():
    rng = np.random.default_rng(8)
    solution, truth = make_walk(rng, heading=10.0, roll=2.0, pitch=0.01)
    for cameras, is_level in (([], False), ([PANORAMA], True)):
        found = dataclasses.replace(solution, cameras=cameras)
        assert (
            find_earth(found, upright(solution), {}).figures["up"] == "by the cameras"
        ) == is_level
        earth = find_earth(found, upright(solution), gps(0.02 * truth, rng, 0.02))
        down = earth.rotation @ _core.exp_pose([0, 0, 0, 0.7, -1.1, 0.4])[:3, :3] @ [0, 1, 0]
        assert (down[1] > math.cos(math.radians(2))) or not is_level


def test_few_panoramas_are_level_and_few_pictures_show_nothing():
    solution, _ = make_walk(np.random.default_rng(9), roll=2.0, pitch=0.01)
    few = dict.fromkeys(solution.names[:4], 1)
    assert find_earth(solution, few, {}) is None
    found = dataclasses.replace(solution, cameras=[PANORAMA])
    assert find_earth(found, few, {}).figures["up"] == "by the cameras"


def test_one_place_for_all_images_says_nothing():
    solution, _ = make_walk(np.random.default_rng(5))
    places = dict.fromkeys(solution.names, ORIGIN)
    earth = find_earth(solution, upright(solution), places)
    assert "1 place(s)" in earth.notes[0] and earth.figures["up"] == "by the cameras"


@pytest.mark.parametrize(
    ("roll", "heading", "how"),
    [(3, 300, "by the cameras"), (40, 300, "roughly, by the cameras' mean")],
)
def test_scene_stands_by_how_cameras_were_held(roll, heading, how):
    solution, _ = make_walk(np.random.default_rng(6), roll=roll, heading=heading)
    earth = find_earth(solution, upright(solution), {})
    assert earth.figures["up"] == how
    ups = -solution.camera_from_world[:, 1, :3]
    assert (earth.rotation @ ups.mean(axis=0))[1] < 0
    assert find_stated_up({"earth": earth.figures}) == (0, -1, 0)
    assert find_earth(solution, {}, {}) is None
    assert find_stated_up({}) is None


def test_photographs_on_their_side_tell_up_by_exif():
    solution, _ = make_walk(np.random.default_rng(7))
    first = find_earth(solution, upright(solution), {}).rotation
    # Turned by a quarter against the clock, as a phone held upright stores them.
    quarter = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    poses = solution.camera_from_world.copy()
    poses[:, :3] = np.einsum("ij,njk->nik", quarter, poses[:, :3])
    solution.camera_from_world[:] = poses
    second = find_earth(solution, dict.fromkeys(solution.names, 6), {}).rotation
    assert np.abs(first - second).max() < 1e-9


def look_down(solution, rng):
    """The same places with all cameras straight down, as from a drone, turned about the view."""
    poses = solution.camera_from_world.copy()
    turn = _core.exp_pose([0, 0, 0, 0.7, -1.1, 0.4])[:3, :3]
    for pose, center in zip(poses, centers(solution), strict=True):
        down = _core.exp_pose([0, 0, 0, -math.pi / 2, 0, 0])[:3, :3]
        spin = _core.exp_pose([0, 0, 0, 0, 0, rng.uniform(-3, 3)])[:3, :3]
        pose[:3, :3] = spin @ down @ turn.T
        pose[:3, 3] = -pose[:3, :3] @ center
    return dataclasses.replace(solution, camera_from_world=poses)


@pytest.mark.parametrize("wrong", [0, 4])
def test_flight_straight_down_takes_up_from_gps(wrong):
    rng = np.random.default_rng(5)
    solution, truth = make_walk(rng)
    places = gps(truth, rng, 0.1)
    for name in list(places)[:wrong]:
        latitude, longitude, height = places[name]
        places[name] = (latitude + 0.001, longitude, height)
    earth = find_earth(look_down(solution, rng), upright(solution), places)
    assert earth.figures["gps"]["applied"] and earth.figures["up"] == "by GPS"
    assert earth.scale == pytest.approx(SCALE, rel=tolerances.SFM_EARTH_SCALE)


def measure_ups(solution, rng, noise, turn):
    """Up in each camera's axes, with errors of so many radians, turned in the camera."""
    up = _core.exp_pose([0, 0, 0, 0.7, -1.1, 0.4])[:3, :3] @ [0, -1, 0]
    seen = solution.camera_from_world[:, :3, :3] @ up + noise * rng.standard_normal((COUNT, 3))
    seen = seen @ turn.T
    return dict(zip(solution.names, map(tuple, seen), strict=True)), up


def test_accelerometer_gives_up_where_cameras_were_not_level():
    rng = np.random.default_rng(6)
    solution, _ = make_walk(rng)
    solution = look_down(solution, rng)
    ups, up = measure_ups(solution, rng, 0.1, np.eye(3))
    earth = find_earth(solution, upright(solution), {}, ups)
    assert earth.figures["up"] == "by an accelerometer or gimbal" and earth.notes == ()
    assert np.degrees(np.arccos(-earth.rotation[1] @ up)) < tolerances.SFM_MEASURED_UP_DEGREES


def test_accelerometer_that_contradicts_the_poses_is_named_and_not_used():
    rng = np.random.default_rng(7)
    solution, _ = make_walk(rng)
    turn = _core.exp_pose([0, 0, 0, 0, 0, math.pi / 2])[:3, :3]
    ups, _ = measure_ups(solution, rng, 0.05, turn)
    earth = find_earth(solution, upright(solution), {}, ups)
    assert earth.figures["up"] == "by the cameras" and "contradicts the poses" in earth.notes[0]
