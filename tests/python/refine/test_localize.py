"""`gsut localize`: the pose of a photograph in the scene of a run, from the command line."""

import dataclasses
import json

import cv2
import numpy as np
import pytest

import gsut
import gsut.training
import tolerances
from disturbances import disturb_pose
from gsut import TrainOptions
from gsut.cli import main
from gsut.refine import localization
from gsut.refine.localization import localize_image
from gsut.refine.motion import measure_pose_changes
from gsut.refine.secants import _Problem, place_lines
from gsut.render.pictures import to_uint8, write_png
from gsut.run.folder import RunFile
from random_scenes import fisheye, gaussians_in_view, pinhole
from rendered_dataset import poses, truth, write_dataset


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run whose Gaussians are the truth, and the truth in the dataset's coordinates."""
    folder = tmp_path_factory.mktemp("localize")
    rng = np.random.default_rng(20260821)
    scene = gsut.load_dataset(write_dataset(folder / "data", rng))
    options = TrainOptions(steps=20, max_gaussians=100, checkpoint_every=20)
    gsut.train(scene, options, out=folder / "run", progress=False)
    g = truth(np.random.default_rng(20260821)).to_dtype(np.float32)
    moved = gsut.Gaussians(
        (g.means - scene.world_offset).astype(np.float32),
        *(getattr(g, name) for name in ("quats", "log_scales", "opacity_logits", "sh")),
    )
    (folder / "run" / RunFile.SCENE).unlink()
    gsut.formats.save_ply(folder / "run" / RunFile.SCENE, moved)
    return folder / "run", g


def photograph(path, g, pose, width=96):
    write_png(path, to_uint8(gsut.render(g, pinhole(width), pose).image))
    return path


def test_localize_finds_a_pose_between_the_training_views(run, tmp_path, capsys):
    folder, g = run
    pose = gsut.exp_pose([0.1, -0.05, 0.1, 0.03, -0.05, 0.02]) @ poses()[4]
    image = photograph(tmp_path / "photo.png", g, pose, 48)
    assert main(["localize", str(image), "--run", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    center = -pose[:3, :3].T @ pose[:3, 3]
    error = np.linalg.norm(np.array(found["center"]) - center)
    print(f"{error:.2e} units, std {found['center_std']}")
    assert error < tolerances.LOCALIZED_UNITS
    np.testing.assert_allclose(found["camera_from_world"], pose, atol=tolerances.LOCALIZED_UNITS)
    assert np.linalg.eigvalsh(found["covariance"]).min() > 0
    assert main(["localize", str(image), "--run", str(folder)]) == 0
    assert "centre:" in capsys.readouterr().out


@pytest.mark.parametrize("known_by", ["dataset", "picture"])
def test_localize_poses_the_lines_of_a_rolling_shutter(
    run, tmp_path, capsys, monkeypatch, known_by
):
    folder, g = run
    pose = poses()[4]
    motion = np.array([0.1, -0.05, 0.05, 0.02, -0.06, 0.03])
    shutter = gsut.Shutter("top_to_bottom")
    image = tmp_path / "photo.png"
    write_png(
        image, to_uint8(gsut.render(g, pinhole(48), place_lines(pose, motion, shutter)).image)
    )
    read = gsut.training.read_trained

    def read_with_shutter(*arguments):
        options, scene, gaussians = read(*arguments)
        views = [dataclasses.replace(view, shutter=shutter) for view in scene.views]
        return options, dataclasses.replace(scene, views=views), gaussians

    if known_by == "dataset":
        monkeypatch.setattr("gsut.training.read_trained", read_with_shutter)
    words = ["localize", str(image), "--run", str(folder), "--json"]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    error = np.array(found["center"]) + pose[:3, :3].T @ pose[:3, 3]
    print(known_by, error, found["center_std"], found["motion"])
    assert found["shutter"] == "top_to_bottom"
    assert found["shutter_source"] == ("picture" if known_by == "picture" else "given")
    assert np.linalg.norm(error) < tolerances.LOCALIZED_UNITS
    assert (np.abs(error) < 3 * np.array(found["center_std"])).all()
    assert np.abs(np.array(found["motion"]) - motion).max() < tolerances.LOCALIZED_MOTION
    assert main(words[:4]) == 0
    assert "from first to last line the centre moves by" in capsys.readouterr().out


def test_photograph_far_from_every_view_is_found_by_matches(rng):
    camera = fisheye(160)
    middle = np.eye(4)
    g = gaussians_in_view(rng, camera, middle, 3000, sizes=(0.01, 0.06), opacity=3.0)
    views = [(camera, disturb_pose(rng, middle, 15.0, 0.25)) for _ in range(5)]
    pose = disturb_pose(rng, middle, 25.0, 0.2)
    pixels = to_uint8(gsut.render(g, camera, pose).image)
    told = []
    found = localize_image(
        g, views, camera, pixels, np.ones((160, 160), bool),
        on_progress=lambda what, done, total: told.append(what),
    )  # fmt: skip
    change = measure_pose_changes(found.pose.camera_from_world[None], pose[None])
    near = measure_pose_changes(np.array([view for _, view in views]), np.repeat(pose[None], 5, 0))
    print(f"{found.matches} matches, {change.degrees[0]:.1e} degrees, {change.distances[0]:.1e} "
          f"units; nearest view {near.degrees.min():.0f} degrees off")  # fmt: skip
    assert near.degrees.min() > 8
    assert found.start == "matches" and found.matches >= 12
    assert found.pose.converged
    assert change.degrees[0] < tolerances.MATCHED_DEGREES
    assert change.distances[0] < tolerances.MATCHED_UNITS
    assert set(told) == {"looking", "matching", "refining"}


def test_nearest_view_of_a_thinned_scene_ranks_first(rng, monkeypatch):
    camera = fisheye(160)
    g = gaussians_in_view(rng, camera, np.eye(4), 3000, sizes=(0.01, 0.06), opacity=3.0)
    views = [(camera, disturb_pose(rng, np.eye(4), angle, 0.05)) for angle in (60, 3, 40, 20)]
    pixels = to_uint8(gsut.render(g, camera, np.eye(4)).image)
    ranked = []
    for most in (3000, 1000):
        monkeypatch.setattr(localization, "_THUMBNAIL_GAUSSIANS", most)
        seen = np.ones((160, 160), bool)
        ranked.append(
            localization._rank_views(
                g, views, camera, pixels, seen, (0.0, 0.0, 0.0), lambda *shown: None
            )
        )
    assert len(localization._thin_out(g)) == 1000
    assert ranked[0][0] == ranked[1][0] == 1


def test_localize_shrinks_a_larger_photograph(run, tmp_path, capsys):
    folder, g = run
    image = photograph(tmp_path / "large.png", g, poses()[3], 144)
    assert main(["localize", str(image), "--run", str(folder), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(
        found["camera_from_world"], poses()[3], atol=tolerances.LOCALIZED_SHRUNK_UNITS
    )


@pytest.mark.parametrize(
    ("size", "grey", "said"),
    [
        ((40, 90), 0, "90 x 40"), ((5, 5), 80, "5 x 5 pixels"),
        ((48, 48), 255, "does not determine its pose"),  # fits a gain of zero exactly
    ],
)  # fmt: skip
def test_localize_plain_photograph_is_refused_in_one_sentence(
    run, tmp_path, capsys, size, grey, said
):
    write_png(tmp_path / "plain.png", np.full((*size, 3), grey, np.uint8))
    assert main(["localize", str(tmp_path / "plain.png"), "--run", str(run[0])]) == 2
    assert said in capsys.readouterr().err


def test_photograph_of_another_place_is_refused_with_the_evidence(run, tmp_path, capsys):
    folder, _ = run
    elsewhere = np.random.default_rng(5).integers(0, 256, (12, 12, 3), dtype=np.uint8)
    image = tmp_path / "photo.png"
    write_png(image, cv2.resize(elsewhere, (48, 48), interpolation=cv2.INTER_CUBIC))
    assert main(["localize", str(image), "--run", str(folder)]) == 2
    said = capsys.readouterr().err
    assert (
        "was not found in the scene" in said
        and "of its parts lie where the scene shows them" in said
        and "features agree" in said
    )


@pytest.mark.parametrize("change", ["mirrored", "upside down", "other Gaussians"])
def test_photograph_that_only_looks_alike_is_refused(run, tmp_path, capsys, change):
    """Its colours correlate with those of the best pose: a ball before a dark wall."""
    folder, g = run
    if change == "other Gaussians":
        g = truth(np.random.default_rng(7)).to_dtype(np.float32)
    image = photograph(tmp_path / "photo.png", g, poses()[4], 48)
    pixels = cv2.imread(str(image))
    turned = {"mirrored": pixels[:, ::-1], "upside down": pixels[::-1]}
    cv2.imwrite(str(image), turned.get(change, pixels))
    assert main(["localize", str(image), "--run", str(folder)]) == 2
    assert "was not found in the scene" in capsys.readouterr().err


def test_localize_photograph_through_half_the_focal_length_is_refused(run, tmp_path, capsys):
    folder, g = run
    image = photograph(tmp_path / "photo.png", g, poses()[4], 48)
    params = np.array(pinhole(48).params)
    params[:2] *= 0.4
    gsut.save_camera(pinhole(48).with_params(params), tmp_path / "lens.json")
    words = ["localize", str(image), "--run", str(folder), "--camera", str(tmp_path / "lens.json")]
    assert main(words) == 2
    assert "was not found in the scene" in capsys.readouterr().err


@pytest.mark.parametrize("factor", [1.0, 0.99, 1.03, 0.9, 1.1])
def test_stated_uncertainty_covers_the_error_also_of_a_wrong_focal_length(
    run, tmp_path, capsys, factor
):
    folder, g = run
    pose = gsut.exp_pose([0.1, -0.05, 0.1, 0.03, -0.05, 0.02]) @ poses()[4]
    image = photograph(tmp_path / "photo.png", g, pose, 48)
    params = np.array(pinhole(48).params)
    params[:2] *= factor
    lens = tmp_path / "lens.json"
    gsut.save_camera(pinhole(48).with_params(params), lens)
    assert (
        main(["localize", str(image), "--run", str(folder), "--camera", str(lens), "--json"]) == 0
    )
    told = capsys.readouterr()
    found = json.loads(told.out)
    error = np.abs(np.array(found["center"]) + pose[:3, :3].T @ pose[:3, 3])
    print(factor, found["focal_scale"], error, found["center_std"])
    assert (error < 3 * np.array(found["center_std"])).all()
    assert abs(found["focal_scale"] * factor - 1) < tolerances.LOCALIZED_FOCAL
    capsys.readouterr()
    assert main(["localize", str(image), "--run", str(folder), "--camera", str(lens)]) == 0
    assert ("focal length times" in capsys.readouterr().err) == (abs(factor - 1) > 0.02)


def test_step_that_is_not_finite_leaves_the_pose_undetermined():
    with pytest.raises(gsut.SolveError, match="does not determine its pose"):
        _Problem.find_lower(None, np.zeros(8), np.full(8, np.nan))
