"""Tests `gsut align`: two captures of one place in one frame, and what has changed between them."""

import dataclasses
import json

import numpy as np
import pytest

import gsut
from gsut.cli import main
from gsut.refine.captures import align_captures, find_changes
from gsut.render.pictures import to_uint8
from gsut.run.folder import RunFile
from random_scenes import pinhole
from rendered_dataset import poses, truth, write_dataset

SCALE, SHIFT = 2.5, np.array([3.0, -1.0, 2.0])  # of A's coordinates from B's
ROTATION = gsut.exp_pose([0, 0, 0, 0.3, -0.8, 0.5])[:3, :3]


def to_other(pose: np.ndarray) -> np.ndarray:
    """Returns a pose of A in B's coordinates."""
    moved = np.eye(4)
    moved[:3, :3] = pose[:3, :3] @ ROTATION
    center = ROTATION.T @ (-pose[:3, :3].T @ pose[:3, 3] - SHIFT) / SCALE
    moved[:3, 3] = -moved[:3, :3] @ center
    return moved


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("captures")
    return gsut.load_dataset(write_dataset(folder / "data", np.random.default_rng(20260821)))


@pytest.fixture(scope="module")
def gaussians():
    return truth(np.random.default_rng(20260821)).to_dtype(np.float32)


@pytest.fixture(scope="module")
def other(gaussians):
    """Another capture, of poses that the scene does not have, in B's coordinates."""
    lens = pinhole(96)
    moved = [gsut.exp_pose([0.05, -0.05, 0.1, 0.02, -0.04, 0.01]) @ pose for pose in poses()[::2]]
    images = [to_uint8(gsut.render(gaussians, lens, pose).image) for pose in moved]
    return gsut.scene_from_arrays(images, lens, [to_other(pose) for pose in moved])


def test_second_capture_is_placed_within_its_standard_deviations(scene, gaussians, other):
    found = align_captures(scene, gaussians, other)
    assert len(found.names) >= 4 and not found.rejected
    turned = np.degrees(np.arccos((np.trace(found.rotation.T @ ROTATION) - 1) / 2))
    middle = np.mean([view.camera_center for view in other.views], axis=0)
    truth_of_middle = SCALE * ROTATION @ middle + SHIFT
    off = np.linalg.norm(found.scale * found.rotation @ middle + found.shift - truth_of_middle)
    print(found.scale / SCALE - 1, found.scale_sigma, turned, found.rotation_sigma, off,
          found.position_sigma)  # fmt: skip
    assert abs(found.scale / SCALE - 1) < 3 * found.scale_sigma < 0.01
    assert turned < 3 * found.rotation_sigma < 0.3
    assert off < 3 * found.position_sigma < 0.03


def test_photograph_of_another_pose_is_left_out(scene, gaussians, other):
    views = list(other.views)
    wrong = to_other(gsut.exp_pose([0.5, 0.4, 0, 0.1, 0.2, 0]) @ poses()[0])
    views[other.train_indices[1]] = dataclasses.replace(
        views[other.train_indices[1]], camera_from_world=wrong
    )
    found = align_captures(scene, gaussians, other.replace(views=tuple(views)))
    assert found.rejected == (views[other.train_indices[1]].name,)
    assert abs(found.scale / SCALE - 1) < 3 * found.scale_sigma


def test_captures_of_two_places_are_refused(scene, gaussians, other):
    rng, lens = np.random.default_rng(1), other.cameras[0]
    noise = [rng.integers(90, 160, (lens.height, lens.width, 3), np.uint8) for _ in other.views]
    elsewhere = gsut.scene_from_arrays(noise, lens, [v.camera_from_world for v in other.views])
    with pytest.raises(gsut.SolveError, match="do both captures show the same place"):
        align_captures(scene, gaussians, elsewhere)


def test_only_what_was_changed_is_marked(gaussians):
    pose, lens = poses()[0], pinhole(96)
    changed, _ = find_changes(gaussians, gaussians, lens, pose)
    assert not changed.any()
    front = int(np.argmax(gaussians.opacity_logits))
    near = np.linalg.norm(gaussians.means - gaussians.means[front], axis=1) < 0.3
    other = dataclasses.replace(gaussians, sh=np.where(near[:, None, None], -1, 1) * gaussians.sh)
    changed, picture = find_changes(gaussians, other.to_dtype(np.float32), lens, pose)
    truly = np.abs(
        gsut.render(gaussians, lens, pose).image - gsut.render(other, lens, pose).image
    ).max(axis=2)
    assert changed.any() and truly[changed].max() > 0.05
    assert np.all(truly[changed] > 0) and picture.shape == (*changed.shape, 3)


def test_command_writes_the_scene_in_the_other_frame_and_pictures(
    scene, gaussians, tmp_path, capsys
):
    options = gsut.TrainOptions(steps=20, max_gaussians=100, checkpoint_every=20)
    gsut.train(scene, options, out=tmp_path / "run", progress=False)
    (tmp_path / "run" / RunFile.SCENE).unlink()
    gsut.formats.save_ply(tmp_path / "run" / RunFile.SCENE, gaussians)
    run, out, changes = (str(tmp_path / name) for name in ("run", "out.ply", "changes"))
    assert main(["align", run, run, "-o", out, "--changes", changes, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert abs(figures["scale"] - 1) < 3 * figures["scale_sigma_percent"] / 100
    written = gsut.load_gaussians(out)
    places = written.means + written.origin
    assert np.abs(places - gaussians.means - gaussians.origin).max() < 0.02
    assert len(list((tmp_path / "changes").iterdir())) == len(figures["changed"]) >= 4
    assert max(figures["changed"].values()) < 0.02
