"""Structure from motion through a rolling shutter: velocities, readout time, real frames."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.sfm.lens.candidates import guess_lens
from gsut.sfm.lens.search import search_lens
from gsut.sfm.matches.matching import match_images
from gsut.sfm.matches.verification import verify_matches
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.solution.result import measure_agreement
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.world.comparison import compare_poses
from synthetic_walk import Synthetic, quiet

_BESIDE = Path(__file__).resolve().parents[4] / "shared"
HELMET = Path(os.environ.get("GSUT_SHARED", _BESIDE)) / "data" / "helmet_distorted_rs"
READOUT = 0.7  # of the time between frames
IMAGES = 10
HELMET_VIEWS = 14
SHUTTER = _core.Shutter("top_to_bottom")


def solved(scene, shutter, options):
    """The walk solved, with matches as loose as the shutter needs."""
    images = scene.images(shutter=SHUTTER)
    raw = match_images(images.names, scene.features, options, quiet)
    verified = verify_matches(images, raw, options)
    return images.names, solve_poses(scene.images(shutter=shutter), verified, options)


@pytest.fixture(scope="module")
def walk():
    """A walk through a rolling shutter and square pixels, exact but for 0.1 px of noise."""
    rng, values = np.random.default_rng(11), [300, 300, 500, 505, 0.02, -0.01, 0.002, -0.0003]
    lens = gsut.Camera("kannala_brandt", values, 1000, 1010)
    return Synthetic(rng, images=IMAGES, noise=0.1, readout=READOUT, camera=lens)


@pytest.fixture(scope="module")
def rolling(walk):
    """The walk solved with a velocity an image: names, solution."""
    return solved(walk, SHUTTER, PosesOptions())


def test_solve_rolling_walk_is_far_better_than_global(walk, rolling):
    truth = np.array(walk.poses)
    found = rolling[1]
    assert found.registered.all()
    errors = compare_poses(found.camera_from_world, truth)
    # The global shutter's best chance: errors as large as the motion makes them are let through.
    loose = PosesOptions(max_error=1.8 * 12)
    still = solved(walk, None, loose)[1]
    beside = compare_poses(still.camera_from_world[still.registered], truth[still.registered])
    assert 3 * errors.ate_percent < beside.ate_percent
    assert errors.ate_percent < tolerances.SFM_ROLLING_ATE_PERCENT
    assert errors.rotation_degrees.max() < tolerances.SFM_ROLLING_DEGREES


def test_solve_rolling_walk_finds_velocities(walk, rolling):
    found = rolling[1]
    turns = np.degrees(np.linalg.norm(found.velocities[:, 3:], axis=1))
    expected = np.degrees(np.linalg.norm(np.array(walk.velocities)[:, 3:], axis=1))
    assert np.abs(turns - expected).max() < tolerances.SFM_ROLLING_DEGREES


def test_solve_with_the_readout_time_given_agrees(walk):
    found = solved(walk, SHUTTER, PosesOptions(readout_time=READOUT))[1]
    errors = compare_poses(found.camera_from_world, np.array(walk.poses))
    assert errors.ate_percent < tolerances.SFM_ROLLING_ATE_PERCENT


def test_search_lens_finds_a_rolling_fisheye_with_the_poses(walk):
    guess = guess_lens(walk.camera.width, walk.camera.height, 180.0)
    mapping = walk.mapping(PosesOptions(fov=180.0), camera=guess, shutter=SHUTTER)
    mapping = search_lens(mapping)
    found = mapping.solved
    assert found.registered.all() and found.velocities is not None
    errors = compare_poses(found.camera_from_world, np.array(walk.poses))
    assert errors.ate_percent < tolerances.SFM_ROLLING_ATE_PERCENT
    assert errors.rotation_degrees.max() < tolerances.SFM_ROLLING_DEGREES
    assert abs(found.cameras[0].params[0] / walk.camera.params[0] - 1) < tolerances.SFM_FOCAL
    assert measure_agreement(found, mapping.pairs).share > 0.95


def test_solve_rolling_start_and_end_poses_meet_the_middle(rolling):
    found = rolling[1]
    for i in range(IMAGES):
        motion = _core.CameraMotion(
            found.interpolate_poses(0.0)[i], found.interpolate_poses(1.0)[i], SHUTTER
        )
        assert np.abs(motion.at(0.5) - found.camera_from_world[i]).max() < 1e-12
    # The residuals are those of the moving camera.
    assert np.median(np.linalg.norm(found.residuals, axis=1)) < 0.2


def some_helmet(folder, choose):
    """A data set of some of the helmet's views: those that `choose` takes of all, by name."""
    if not HELMET.is_dir():
        pytest.skip("shared data is absent")
    (folder / "images").symlink_to(HELMET / "images")
    values = json.loads((HELMET / "transforms.json").read_text())
    frames = sorted(values["frames"], key=lambda frame: frame["file_path"][-7:])
    values["frames"] = choose(frames)
    for key in ("train_filenames", "test_filenames", "ply_file_path"):
        values.pop(key, None)
    (folder / "transforms.json").write_text(json.dumps(values))
    return folder


@pytest.fixture(scope="module")
def solved_helmet(tmp_path_factory):
    """The first views, which go all around the helmet, solved by both shutters"""
    folder = some_helmet(tmp_path_factory.mktemp("helmet"), lambda frames: frames[:HELMET_VIEWS])
    results = {}
    for shutter in ("auto", "global"):
        out = folder / shutter
        loose = {"max_error": 22.0} if shutter == "global" else {}
        gsut.find_poses(folder, out, options=gsut.PosesOptions(shutter=shutter, **loose))
        results[shutter] = out
    return folder, results


@pytest.mark.slow
def test_poses_command_helmet_rolling_beats_global(solved_helmet):
    folder, results = solved_helmet
    truth = {v.image_path.resolve(): v for v in gsut.load_dataset(folder, test_every=0).views}
    ate = {}
    for shutter, out in results.items():
        scene = gsut.load_dataset(out, test_every=0)
        views = [truth[v.image_path.resolve()] for v in scene.views]
        found = np.array([v.camera_from_world for v in scene.views])
        reference = np.array([v.camera_from_world for v in views])
        ate[shutter] = compare_poses(found, reference).ate_percent
        if shutter == "auto":
            assert len(views) == HELMET_VIEWS
            for own, other in zip(scene.views, views, strict=True):
                assert own.shutter.direction == "top_to_bottom"
                turns = [
                    np.trace(v.camera_from_world_end[:3, :3] @ v.camera_from_world_start[:3, :3].T)
                    for v in (own, other)
                ]
                angles = np.degrees(np.arccos(np.clip((np.array(turns) - 1) / 2, -1, 1)))
                assert abs(angles[0] - angles[1]) < tolerances.SFM_HELMET_DEGREES
        else:
            assert all(view.shutter is None for view in scene.views)
    assert 3 * ate["auto"] < ate["global"]
    figures = json.loads((results["auto"] / "poses.json").read_text())
    assert figures["shutter"] == "top_to_bottom"
    assert figures["matches_in_points"] > 0.8  # observed 0.87
    assert not any("bent" in note for note in figures["notes"])
