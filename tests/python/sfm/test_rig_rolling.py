"""Rigs whose cameras read their images line by line: poses, motion and files, against truth."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut import Shutter, _core
from gsut.data import load_dataset
from gsut.data.poses import invert_pose
from gsut.data.rigs import LineReading, read_rig
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.report.output import write_dataset
from gsut.sfm.rig import find_lens_pair, find_rig_shutter, write_rig_fit
from gsut.sfm.rig.fit import solve_rig
from gsut.sfm.shutter import find_shutter
from gsut.sfm.solution import Adjustment
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.world.comparison import compare_poses
from synthetic_rig import BACKWARD, SyntheticRig


def fisheye():
    return gsut.Camera(
        "kannala_brandt", [300, 300, 400, 400, 0.02, -0.01, 0, 0], 800, 800,
        valid_field_angle=np.radians(95),
    )  # fmt: skip


DOWN, UP, RIGHT = (
    LineReading(Shutter(direction), seconds)
    for direction, seconds in
    (("top_to_bottom", 0.02), ("bottom_to_top", 0.02), ("left_to_right", 0.01))
)  # fmt: skip
READINGS = {
    "alike": (DOWN, DOWN), "opposite": (DOWN, UP), "sideways in half the time": (DOWN, RIGHT),
    "one at once": (DOWN, None),
}  # fmt: skip


def describe(readings):
    return [(r.shutter.direction, r.seconds) if r else None for r in readings]


def make_rig(rng, readings, **settings):
    """A rig of two fisheyes back to back that reads its images while it moves."""
    lenses = (fisheye(), fisheye())
    return SyntheticRig(rng, BACKWARD, lenses=lenses, readings=readings, **settings)


def solved(scene, **known):
    mapping = scene.mapping(rig=scene.rig, **known)
    mapping = solve_rig(mapping)
    return mapping


def measure_ends(scene, solution):
    """Largest distance of a centre from the truth at both ends of the readouts."""
    onto = invert_pose(solution.camera_from_world[0]) @ scene.poses[0]
    longest = max(reading.seconds for reading in scene.rig.readings if reading)
    apart = []
    for image, camera in enumerate(scene.photographs.rig_cameras):
        reading = scene.rig.readings[camera]
        mount = scene.rig.camera_from_reference[camera]
        body = invert_pose(mount) @ scene.poses[image]
        velocity = scene.velocities[scene.photographs.frames[image]]
        for time in (0.0, 1.0) if reading else ():
            share = (time - 0.5) * reading.seconds / longest
            truth = mount @ _core.moved_pose(body, velocity, share)
            found = solution.interpolate_poses(time)[image] @ onto
            apart.append(np.linalg.norm(invert_pose(found)[:3, 3] - invert_pose(truth)[:3, 3]))
    assert len(apart) >= len(scene.poses)
    return max(apart)


@pytest.mark.parametrize("readings", READINGS.values(), ids=READINGS)
def test_solve_rig_exact_rolling_tracks_give_poses_and_motion_exactly(rng, readings):
    scene = make_rig(rng, readings, points=400)
    mapping = solved(scene)
    assert mapping.solved.registered.all()
    apart, _ = scene.worst(mapping.solved)  # no scale taken out
    assert apart < tolerances.RIG_ROLLING_EXACT
    # A straight line between both ends stands for the arc of a camera beside the body's centre.
    assert measure_ends(scene, mapping.solved) < tolerances.RIG_ROLLING_ENDS
    assert describe(mapping.found.rig.rig.readings) == describe(readings)


STEP = 0.05  # seconds before and after a frame, by which its flow is measured
READOUT = 0.03  # seconds; frames are a second apart
FLAGS = np.array([2, 2, 0, 0, 1, 1, 0, 0], np.uint8)  # of a lens that is estimated
BACK_OFF = [3.0, 3.0, 2.0, -1.0, 0, 0, 0, 0]  # of the back lens from the front one


def measure_flows(scene):
    """By name where some points are, and how far they move in a second."""
    flows = {}
    photographs = scene.photographs
    for name, frame, camera in zip(
        photographs.names, photographs.frames, photographs.rig_cameras, strict=True
    ):
        body, _ = scene._move_body(frame, photographs.frames.max() + 1)
        rate = scene.velocities[frame] / READOUT
        pixels = []
        for time in (-STEP, 0.0, STEP):
            pose = scene.rig.camera_from_reference[camera] @ _core.moved_pose(body, rate, time)
            lens = scene.rig.cameras[camera]
            found, valid = lens.project(scene.points @ pose[:3, :3].T + pose[:3, 3])
            inside = valid & (found > 0).all(axis=1) & (found < lens.width).all(axis=1)
            pixels.append(np.where(inside[:, None], found, np.nan))
        rows = np.hstack([pixels[1], (pixels[2] - pixels[0]) / (2 * STEP)])
        flows[name] = rows[np.isfinite(rows).all(axis=1)][:60]
    return flows


@pytest.mark.parametrize("readings", [(DOWN, UP), (UP, UP)], ids=["both ways", "up"])
def test_video_of_two_fisheyes_shows_its_rig_and_how_each_lens_is_read(readings):
    lenses = fisheye(), fisheye().with_params(fisheye().params + BACK_OFF)
    scene = SyntheticRig(
        np.random.default_rng(1), BACKWARD, noise=0.1, points=300, frames=10, lenses=lenses,
        readings=readings, readout=READOUT,
    )  # fmt: skip
    photographs = dataclasses.replace(
        scene.photographs, flows=measure_flows(scene), cameras=[lenses[0]] * len(scene.poses)
    )
    mapping = dataclasses.replace(
        scene.mapping(shutter=None, lines=None, lens_free=FLAGS), photographs=photographs
    )
    mapping = mapping.replace(
        solution=solve_poses(
            mapping.images, scene.pairs, PosesOptions(), adjustment=Adjustment(FLAGS)
        )
    )
    mapping = find_shutter(mapping)
    mapping = find_lens_pair(mapping)
    mapping = find_rig_shutter(mapping)
    fit = mapping.found.rig
    assert [r.shutter.direction for r in fit.rig.readings] == [
        r.shutter.direction for r in readings
    ]
    errors = compare_poses(mapping.solved.camera_from_world, scene.poses)
    assert [r.seconds for r in fit.rig.readings] == pytest.approx(
        [READOUT] * 2, rel=tolerances.RIG_READOUT
    )
    assert errors.rotation_degrees.max() < tolerances.RIG_DEGREES


def test_solve_rig_with_rolling_shutters_is_better_than_taken_for_global(rng):
    scene = make_rig(rng, READINGS["opposite"], noise=0.2, frames=8, points=400)
    rolling = scene.worst(solved(scene).solved)
    still = scene.worst(solved(scene, shutter=None, lines=None).solved)
    assert rolling[0] < tolerances.RIG_UNITS and rolling[1] < tolerances.RIG_DEGREES
    assert still[0] > 2 * rolling[0] and still[1] > 2 * rolling[1]


def test_solve_rig_with_rolling_shutters_has_the_same_bits_on_any_number_of_threads():
    found = []
    before = _core.num_threads()
    for threads in (1, 3):
        _core.set_num_threads(threads)
        mapping = solved(
            make_rig(np.random.default_rng(5), READINGS["opposite"], noise=0.2, frames=6)
        )
        found.append((mapping.solved.camera_from_world, mapping.solved.velocities))
    _core.set_num_threads(before)
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))


def test_rolling_rig_dataset_has_the_lines_of_each_camera(rng, tmp_path):
    scene = make_rig(rng, READINGS["opposite"])
    mapping = solved(scene)
    photographs = mapping.photographs
    for name in photographs.names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / name), np.zeros((800, 800), np.uint8))
    photographs.paths[:] = [tmp_path / name for name in photographs.names]
    (tmp_path / "out").mkdir()
    write_dataset(mapping.solved, photographs, tmp_path / "out")
    views = load_dataset(tmp_path / "out", test_every=0).views
    ways = {view.name.split("/")[-2]: view.shutter.direction for view in views}
    assert ways == {"left": "top_to_bottom", "right": "bottom_to_top"}
    text = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert "rolling_shutter" not in text and len(text["frames"]) == len(views)
    for camera, name in zip(scene.rig.cameras, scene.rig.names, strict=True):
        gsut.save_camera(camera, tmp_path / f"{name}.yaml")
    files = tuple((tmp_path / f"{name}.yaml", None) for name in scene.rig.names)
    rig = dataclasses.replace(mapping.found.rig.rig, lens_files=files)
    write_rig_fit(dataclasses.replace(mapping.found.rig, rig=rig), tmp_path)
    again = read_rig(tmp_path / "rig.json")
    assert describe(again.readings) == describe(READINGS["opposite"])
