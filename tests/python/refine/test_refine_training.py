"""Poses and lens refined in training: the sweeps, their gauge, resuming, and what is written."""

import dataclasses
import json

import numpy as np
import pytest

import gsut
import tolerances
from box_room import make_fisheye, plan_walk, write_box_room
from disturbances import Disturbance, disturb_pose, disturb_scene, jitter_points
from gsut import TrainOptions, _core
from gsut.refine.motion import measure_pose_changes, remove_mean_motion, turn_onto
from gsut.refine.refiner import check_refinable
from gsut.refine.tracks import refine_by_tracks
from gsut.render.projection import DEFAULT_UNSCENTED
from gsut.run.folder import RunFile, RunFolder
from gsut.sfm.world.comparison import compare_poses
from gsut.training.record.trained_run import read_trained
from random_scenes import fisheye, gaussians_in_view, pinhole, random_pose
from room_dataset import write_room

OPTIONS = TrainOptions(steps=240, max_gaussians=400, checkpoint_every=0, seed=3, refine_poses=True)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refine") / "data"
    return gsut.load_dataset(write_room(folder, np.random.default_rng(7)))


def poses_of(scene):
    return scene.poses(scene.train_indices)


def test_mean_motion_of_all_poses_is_taken_out(rng):
    before = np.array([random_pose(rng) for _ in range(8)])
    small = gsut.exp_pose([0.02, -0.03, 0.01, 0.004, -0.002, 0.003])
    growth = 1.003
    after = before @ small
    after[:, :3, 3] *= growth  # the world grows about its origin
    found = measure_pose_changes(remove_mean_motion(after, before), before)
    assert found.degrees.max() < tolerances.MEAN_MOTION_DEGREES
    assert found.distances.max() < tolerances.MEAN_MOTION_UNITS
    # One pose alone has no common growth; its own motion is the mean.
    alone = measure_pose_changes(remove_mean_motion(after[:1], before[:1]), before[:1])
    assert alone.degrees.max() < tolerances.MEAN_MOTION_DEGREES


def test_a_turn_about_a_line_of_cameras_is_found_by_the_cameras_own(rng):
    before = np.array([random_pose(rng) for _ in range(20)])
    before[:, :3, 3] = 0.0
    along = np.stack([np.linspace(-2, 2, 20), *rng.normal(0, 0.01, (2, 20))], axis=1)
    before[:, :3, 3] = -np.einsum("nij,nj->ni", before[:, :3, :3], along)
    noisy = np.array([disturb_pose(rng, pose, 0.02, 0.01) for pose in before])
    turned = noisy @ gsut.exp_pose([0, 0, 0, np.radians(2.0), 0, 0])
    found = measure_pose_changes(turn_onto(turned, before), before)
    assert np.median(found.degrees) < 0.03
    assert np.median(found.distances) < 0.02
    exact = before @ gsut.exp_pose([0.3, 0.1, 0.2, 0.01, -0.02, 0.01])
    found = measure_pose_changes(turn_onto(exact, before), before)
    assert found.degrees.max() < tolerances.MEAN_MOTION_DEGREES
    assert found.distances.max() < tolerances.MEAN_MOTION_UNITS


def test_own_motions_stay_when_the_mean_is_taken_out(rng):
    before = np.array([random_pose(rng) for _ in range(40)])
    after = np.array([disturb_pose(rng, pose, 1.0, 0.1) for pose in before])
    found = measure_pose_changes(remove_mean_motion(after, before), before)
    assert abs(np.median(found.degrees) - 1.0) < 0.2
    assert abs(np.median(found.distances) - 0.1) < 0.02


def test_disturbance_has_exactly_its_size(rng, scene):
    pose = random_pose(rng)
    change = measure_pose_changes(disturb_pose(rng, pose, 2.0, 0.08)[None], pose[None])
    np.testing.assert_allclose([change.degrees[0], change.distances[0]], [2.0, 0.08], rtol=1e-9)
    moved = jitter_points(scene, 0.02, 0)
    assert 0.01 < np.std(moved.points - scene.points) < 0.03
    lens = disturb_scene(scene, Disturbance("focal", focal=0.02), 0).file_cameras[0].params
    np.testing.assert_allclose(lens[:2] / scene.file_cameras[0].params[:2], 1.02)


@pytest.mark.parametrize(
    "camera", [fisheye(96, 80), pinhole(96, 80, focal=40.0)], ids=lambda camera: camera.model
)
def test_several_images_give_lens_and_poses_together(rng, camera):
    # Near enough that no two Gaussians change their order on the way: there the images jump.
    pose = random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 500, opacity=1.0)
    poses = [pose, *(disturb_pose(rng, pose, 8.0, 0.3) for _ in range(4))]
    params = np.array(camera.params)
    params[:2] *= 1.003
    params[4:] *= 1.05
    wrong = camera.with_params(params)
    valid = camera.rays()[1] & wrong.rays()[1]
    views = []
    for true in poses:
        image = gsut.render(g, camera, true).image.reshape(-1, 3)
        chosen = rng.permutation(np.flatnonzero(valid))[:3000].astype(np.uint32)
        start = disturb_pose(rng, true, 0.1, 0.005)
        views.append((0, start, chosen, np.ascontiguousarray(image[chosen])))
    found = _core.refine_photometric(
        g, [wrong], views, gsut.BlendRule(), (0.0, 0.0, 0.0), g.sh_degree, DEFAULT_UNSCENTED,
        {"lens_free": [[1] * len(params)], "max_iterations": 60, "function_tolerance": 1e-14},
    )  # fmt: skip
    change = measure_pose_changes(np.array(found["camera_from_world"]), np.array(poses))
    relative = np.abs(found["lens_params"][0] / camera.params - 1)[:2].max()
    rays = camera.with_params(found["lens_params"][0]).rays()[0]
    angle = np.nanmax(np.linalg.norm(rays - camera.rays()[0], axis=-1)[valid])
    print(f"{camera.model}: {change.degrees.max():.1e} deg, {change.distances.max():.1e} units, "
          f"focal {relative:.1e}, rays {angle:.1e}")  # fmt: skip
    assert change.degrees.max() < tolerances.REFINED_JOINT_DEGREES
    assert change.distances.max() < tolerances.REFINED_JOINT_UNITS
    assert relative < tolerances.REFINED_JOINT_FOCAL
    # The lens held: the poses alone cannot explain the images.
    held = _core.refine_photometric(
        g, [wrong], views, gsut.BlendRule(), (0.0, 0.0, 0.0), g.sh_degree, DEFAULT_UNSCENTED, {}
    )
    np.testing.assert_array_equal(held["lens_params"][0], params)
    assert held["rms_after"] > 5 * found["rms_after"]


def test_training_brings_disturbed_poses_back(scene):
    start = disturb_scene(scene, Disturbance("x", degrees=1.0, distance=0.05), 5)
    result = gsut.train(start, OPTIONS, progress=False)
    plain = gsut.train(start, dataclasses.replace(OPTIONS, refine_poses=False), progress=False)
    before = compare_poses(poses_of(start), poses_of(scene))
    after = compare_poses(poses_of(result.scene), poses_of(scene))
    medians = [np.median(e.rotation_degrees) for e in (before, after)]
    print(f"rotation {medians}, centres {before.ate} {after.ate}, {result.metrics['alignment']}")
    assert medians[1] < tolerances.REFINED_TRAINING_SHARE * medians[0]
    assert after.ate < tolerances.REFINED_TRAINING_SHARE * before.ate
    assert result.metrics["psnr"] > plain.metrics["psnr"] + 1.0
    alignment = result.metrics["alignment"]
    assert alignment["psnr_after"] == result.metrics["psnr"] > alignment["psnr_before"]
    assert len(alignment["views"]) == len(scene.test_indices)
    np.testing.assert_array_equal(poses_of(plain.scene), poses_of(start))
    # The gauge is held: the scene stays in the world of the poses it was given.
    drift = compare_poses(poses_of(result.scene), poses_of(start)).reference_from_world
    np.testing.assert_allclose(drift, np.eye(4), atol=tolerances.REFINED_DRIFT)


def test_lens_comes_back_with_the_poses(scene):
    start = disturb_scene(scene, Disturbance("x", focal=0.03), 5)
    options = dataclasses.replace(OPTIONS, steps=480, refine_lens=True)
    result = gsut.train(start, options, progress=False)
    true = scene.file_cameras[0].params[:2]
    error = np.abs(result.scene.file_cameras[0].params[:2] / true - 1).max()
    print(f"focal length: {error:.1e}")
    assert error < tolerances.REFINED_TRAINING_FOCAL
    assert result.metrics["refinement"]["lens_params"] == list(result.scene.file_cameras[0].params)


def test_resumed_run_has_the_same_bits_and_writes_its_poses(scene, tmp_path):
    start = disturb_scene(scene, Disturbance("x", degrees=0.5, distance=0.02, focal=0.01), 5)
    options = dataclasses.replace(OPTIONS, steps=60, refine_lens=True, checkpoint_every=30)

    class Killed(Exception):
        pass

    def kill(row):
        if row["step"] == 31:
            raise Killed

    whole = gsut.train(start, options, out=tmp_path / "whole", progress=False)
    with pytest.raises(Killed):
        gsut.train(start, options, out=tmp_path / "part", progress=kill)
    resumed = gsut.train(start, options, out=tmp_path / "part", resume=True, progress=False)
    np.testing.assert_array_equal(whole.gaussians.means, resumed.gaussians.means)
    np.testing.assert_array_equal(poses_of(whole.scene), poses_of(resumed.scene))
    for name in (RunFile.REFINED, RunFile.TRANSFORMS):
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "part" / name).read_bytes()

    # What reads the run sees these poses and this lens, and the file is a dataset of its own.
    run = RunFolder.open(tmp_path / "whole")
    _, seen, _ = read_trained(run, str(scene.path))
    np.testing.assert_allclose(poses_of(seen), poses_of(whole.scene), atol=1e-12)
    assert seen.file_cameras == whole.scene.file_cameras
    data = gsut.load_dataset(run.path / RunFile.TRANSFORMS)
    assert (len(data.train_indices), len(data.test_indices)) == (12, 2)
    shift = data.world_offset - whole.scene.world_offset
    for view, expected in zip(data.views, whole.scene.views, strict=True):
        np.testing.assert_allclose(view.camera_center + shift, expected.camera_center, atol=1e-9)
    np.testing.assert_allclose(data.cameras[0].params, whole.scene.file_cameras[0].params)
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert any("aligned" in note for note in metrics["notes"])
    assert "aligned with it by its own photograph" in (run.path / "report.html").read_text()


def test_threads_do_not_change_the_bits(scene):
    found = []
    for threads in (1, 2):
        options = dataclasses.replace(OPTIONS, steps=40, refine_lens=True, threads=threads)
        found.append(gsut.train(scene, options, progress=False))
    np.testing.assert_array_equal(poses_of(found[0].scene), poses_of(found[1].scene))
    np.testing.assert_array_equal(found[0].gaussians.means, found[1].gaussians.means)


def test_tracks_that_say_nothing_leave_the_poses(scene):
    result = refine_by_tracks(scene, OPTIONS)
    assert "no poses from tracks" in result.note
    assert result.scene is scene


def test_tracks_bring_poses_back_and_leave_those_that_are_as_good(tmp_path):
    # An eighth of the walk, on which photographs share enough.
    folder = write_box_room(tmp_path / "data", make_fisheye(160), plan_walk(9, 1 / 8))
    true = gsut.load_dataset(folder)
    options = TrainOptions(refine_poses=True, threads=2)
    kept = refine_by_tracks(true, options)
    print(kept.figures)
    assert "as good, were kept" in kept.note
    assert kept.tracked == []
    np.testing.assert_array_equal(poses_of(kept.scene), poses_of(true))
    start = disturb_scene(true, Disturbance("x", degrees=2.0, distance=0.08), 5)
    found = refine_by_tracks(start, options)
    assert len(found.tracked) == 9
    assert found.note == ""
    # Centres on so short a way leave a similarity's turn to chance.
    turns = [
        np.median(
            measure_pose_changes(turn_onto(poses_of(each), poses_of(true)), poses_of(true)).degrees
        )
        for each in (start, found.scene)
    ]
    centers = [compare_poses(poses_of(each), poses_of(true)).ate for each in (start, found.scene)]
    print(turns, centers, found.figures)
    assert turns[1] < tolerances.TRACKS_DEGREES_SHARE * turns[0]
    assert centers[1] < tolerances.TRACKS_CENTERS_SHARE * centers[0]


def test_what_cannot_be_refined_is_refused(scene):
    rolling = [dataclasses.replace(v, shutter=gsut.Shutter("top_to_bottom")) for v in scene.views]
    with pytest.raises(gsut.InputError, match="rolling shutter"):
        check_refinable(scene.replace(views=rolling), OPTIONS)
    two = scene.replace(cameras=scene.cameras * 2, file_cameras=scene.cameras * 2)
    with pytest.raises(gsut.InputError, match="refines one lens"):
        check_refinable(two, dataclasses.replace(OPTIONS, refine_lens=True))
