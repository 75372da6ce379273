"""The usual mistakes are named by the photographs, before time is spent; good data are let pass."""

import numpy as np
import pytest

import gsut
from changed_copy import copy_of, write
from demo_hall import write_hall
from gsut.check import check_scene, doctor
from gsut.cli import main
from gsut.data.poses import invert_pose
from gsut.judge import measure_angular_errors


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("check")
    return write_hall(folder / "hall", views=20, test_views=2, size=160)


def test_train_stops_at_a_contradiction_and_force_goes_on(hall, tmp_path, capsys):
    values = copy_of(hall, tmp_path / "data")
    for frame in values["frames"]:
        frame["transform_matrix"] = np.linalg.inv(frame["transform_matrix"]).tolist()
    data = str(write(values, tmp_path / "data", with_points=True))
    words = ["--steps", "5", "--max-gaussians", "500", "--quiet"]
    assert main(["train", data, "-o", str(tmp_path / "run"), *words]) == 2
    said = capsys.readouterr().err
    assert "these poses read as world-to-camera" in said and "inv(M)" in said and "--force" in said
    assert not (tmp_path / "run").exists()
    assert main(["train", data, "-o", str(tmp_path / "run"), *words, "--force"]) == 0
    assert main(["eval", str(tmp_path / "run")]) == 0


def test_doctor_judges_a_scene_of_arrays_as_it_does_files(hall):
    recorded = gsut.load_dataset(hall)
    images, masks = zip(*((recorded.image(i), recorded.mask(i)) for i in range(20)), strict=True)
    poses, lens = recorded.poses(range(20)), recorded.cameras[0]
    good = doctor(gsut.scene_from_arrays(images, lens, poses, masks=masks), progress=False)
    assert [str(f) for f in good if f.severity == "error"] == []
    assert any("the photographs agree with poses and lens" in f.what for f in good)
    wrong = doctor(
        gsut.scene_from_arrays(images, lens, np.linalg.inv(poses), masks=masks), progress=False
    )
    said = next(f for f in wrong if f.severity == "error")
    assert "read as world-to-camera" in said.what and said.where == "arrays in memory"


def test_doctor_says_that_the_photographs_agree(hall):
    found = doctor(hall, progress=False)
    assert [str(f) for f in found if f.severity == "error"] == []
    assert any("the photographs agree with poses and lens" in f.what for f in found)


def test_poses_of_another_scale_than_the_points_are_named(hall, tmp_path):
    values = copy_of(hall, tmp_path / "data")
    for frame in values["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] *= 1e4
        frame["transform_matrix"] = matrix.tolist()
    found = check_scene(gsut.load_dataset(write(values, tmp_path / "data", with_points=True)))
    said = [str(each) for each in found if each.severity == "error"]
    assert len(said) == 1 and "multiply the points by 1e+04" in said[0], found


def test_photographs_without_features_say_nothing(tmp_path, rng):
    from rendered_dataset import write_dataset

    found = check_scene(gsut.load_dataset(write_dataset(tmp_path / "data", rng)))
    assert [f.severity for f in found if "few features" in f.what] == ["info"]
    assert not any("contradict" in f.what for f in found)


def test_angular_error_is_the_distance_from_the_epipolar_plane_or_from_in_front(rng):
    points = rng.normal(size=(50, 3)) + np.array([0.0, 0.0, 5.0])
    poses = np.stack([np.eye(4), gsut.exp_pose([0.5, 0.1, -0.2, 0.1, -0.2, 0.3])])
    seen = np.stack([points @ p[:3, :3].T + p[:3, 3] for p in poses])
    rays = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
    places = np.stack([np.tile(invert_pose(pose), (50, 1, 1)) for pose in poses])
    assert measure_angular_errors(rays, places).max() < 1e-9
    behind = measure_angular_errors(-rays, places)
    assert behind.min() > 1e-3  # the rays meet, but behind both cameras
    turned = places.copy()
    turned[1, :, :3, :3] = turned[1, :, :3, :3] @ gsut.exp_pose([0, 0, 0, 0.01, 0, 0])[:3, :3]
    off = measure_angular_errors(rays, turned)
    assert 0 < np.median(off) < 0.01
    still = np.stack([places[0], places[0]])
    expected = np.arccos(np.clip(np.sum(rays[0] * rays[1], axis=1), -1, 1)) / np.sqrt(2)
    np.testing.assert_allclose(measure_angular_errors(rays, still), expected, atol=1e-7)
