"""Lenses of every family in `gsut poses`, with a rig and without, and in localize."""

import json

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from disturbances import disturb_pose
from gsut.cli import main
from gsut.refine.localization import localize_image
from gsut.refine.motion import measure_pose_changes
from gsut.render.pictures import to_uint8
from gsut.sfm import compare_poses
from gsut.sfm.photographs import features as core_features
from gsut.sfm.report import output
from random_scenes import every_lens, gaussians_in_view, list_models, pinhole, small_camera
from synthetic_rig import pose_of
from synthetic_walk import observe, shuffled

WIDTH, NOISE_PX = 256, 0.1
FRAMES, POINTS = 5, 300
LENSES = [row for row in every_lens(WIDTH) if row[0].endswith("[0]")]  # a lens of each model
WITHOUT_CENTRE = ("cahvore", "orthographic")
# Right of the first camera, turned in: both see the same points.
RIGHT = pose_of([0.01, -0.03, 0.02], [0.3, 0.02, 0.01])


def test_lenses_without_one_centre_are_known():
    models = {camera.model for _, camera in LENSES}
    assert set(list_models()) <= models | set(WITHOUT_CENTRE)
    assert models | set(WITHOUT_CENTRE) <= set(gsut.lens.camera_models())


@pytest.fixture
def find_poses(rng, tmp_path, monkeypatch):
    """Runs `gsut poses` on features of a made walk, in blank images; scene found and truth."""

    def run(camera, folders, mounts, *words):
        pixels = rng.uniform(0, [camera.width, camera.height], (POINTS, 2))
        rays, valid = camera.unproject(pixels)
        points = rays[valid] * rng.uniform(2, 6, (valid.sum(), 1))
        identity = rng.random((len(points), 128)) ** 4
        blank, features, truth = np.zeros((camera.height, camera.width), np.uint8), [], {}
        for frame in range(FRAMES):
            at = frame - FRAMES // 2
            center = [0.25 * at, 0.1 * (frame % 2), 0.12 * (frame * frame % 5 - 2)]
            body = pose_of([0.02 * at, 0.03 * at**2 - 0.05 * frame, 0.05 * frame], center)
            for folder, mount in zip(folders, mounts, strict=True):
                path = tmp_path / "images" / folder / f"{frame:03d}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), blank)
                truth[path.resolve()] = mount @ body
                pose = mount @ body
                projected = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
                _, seen = observe(rng, camera, *projected, NOISE_PX, identity)
                features.append(shuffled(rng, seen))

        def found(photographs, chosen, options):
            assert [photographs.paths[i].resolve() for i in chosen] == list(truth)
            yield from enumerate(features)

        monkeypatch.setattr(core_features, "_read_all_features", found)
        monkeypatch.setattr(output, "write_report", lambda *_: None)  # half of the time
        out = tmp_path / "out"
        assert main(["poses", str(tmp_path / "images"), "-o", str(out), "--quiet", *words]) == 0
        scene = gsut.load_dataset(out, test_every=0)
        assert list(scene.cameras) == [camera]  # each parameter to the last bit
        assert len(scene.views) == len(truth)
        poses = np.array([view.camera_from_world for view in scene.views])
        right = np.array([truth[view.image_path.resolve()] for view in scene.views])
        return out, compare_poses(poses, right)

    return run


@pytest.mark.parametrize(("name", "camera"), LENSES, ids=[name for name, _ in LENSES])
def test_poses_through_every_lens_agree_with_truth(name, camera, find_poses, tmp_path):
    gsut.save_camera(camera, tmp_path / "lens.lens.json")
    words = ["--camera", str(tmp_path / "lens.lens.json")]
    out, errors = find_poses(camera, [""], [np.eye(4)], *words)
    assert errors.ate_percent < tolerances.SFM_EVERY_LENS_ATE_PERCENT
    assert errors.rotation_degrees.max() < tolerances.SFM_EVERY_LENS_DEGREES
    try:
        gsut.save_camera(camera, tmp_path / "cameras.txt")
    except gsut.InputError:  # COLMAP has no such lens: said, and the rest written
        notes = json.loads((out / "poses.json").read_text())["notes"]
        assert any("sparse/0 was not written" in note for note in notes)
        assert not (out / "sparse").exists()
    else:
        assert (out / "sparse" / "0" / "cameras.txt").is_file()


@pytest.mark.parametrize(("name", "camera"), LENSES, ids=[name for name, _ in LENSES])
def test_a_rig_of_every_lens_has_the_scale_of_its_file(name, camera, find_poses, tmp_path):
    gsut.save_camera(camera, tmp_path / "lens.lens.json")
    cameras = {
        folder: {"file": "lens.lens.json", "camera_from_reference": pose.tolist()}
        for folder, pose in (("left", np.eye(4)), ("right", RIGHT))
    }
    (tmp_path / "rig.json").write_text(json.dumps({"cameras": cameras}))
    words = ["--rig", str(tmp_path / "rig.json")]
    _, errors = find_poses(camera, ["left", "right"], [np.eye(4), RIGHT], *words)
    assert abs(errors.scale_error_percent) < tolerances.SFM_EVERY_LENS_SCALE_PERCENT
    assert errors.rotation_degrees.max() < tolerances.SFM_EVERY_LENS_DEGREES


@pytest.mark.parametrize(("name", "camera"), LENSES, ids=[name for name, _ in LENSES])
def test_localize_through_every_lens_finds_the_pose(name, camera, rng):
    camera = small_camera(camera.model, 0, 96)
    gaussians = gaussians_in_view(rng, camera, np.eye(4), 800, sizes=(0.03, 0.15), opacity=3.0)
    views = [(camera, disturb_pose(rng, np.eye(4), 1.0, 0.015)) for _ in range(2)]
    pixels = to_uint8(gsut.render(gaussians, camera, np.eye(4)).image)
    found = localize_image(gaussians, views, camera, pixels, np.ones(pixels.shape[:2], bool))
    change = measure_pose_changes(found.pose.camera_from_world[None], np.eye(4)[None])
    assert found.pose.converged
    assert change.degrees[0] < tolerances.LOCALIZE_EVERY_LENS_DEGREES
    assert change.distances[0] < tolerances.LOCALIZE_EVERY_LENS_UNITS


@pytest.mark.parametrize("model", WITHOUT_CENTRE)
def test_lenses_without_one_centre_are_refused_with_what_to_do(model, rng, tmp_path, capsys):
    _, params, width, height = gsut._core.camera_examples(model)[0]
    camera = gsut.Camera(model, params, width, height).resize(80, 60)
    gsut.save_camera(camera, tmp_path / "lens.lens.json")
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.zeros((60, 80), np.uint8))
    words = ["poses", str(tmp_path), "--camera", str(tmp_path / "lens.lens.json")]
    assert main([*words, "-o", str(tmp_path / "out")]) == 2
    assert f"those of {model} do not: fit a central one" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    gaussians = gaussians_in_view(rng, pinhole(), np.eye(4), 9)
    black, everywhere = np.zeros((60, 80, 3), np.uint8), np.ones((60, 80), bool)
    with pytest.raises(gsut.InputError, match=f"those of {model} do not: fit a central one"):
        localize_image(gaussians, [], camera, black, everywhere)
