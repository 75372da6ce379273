"""Structure from motion: pairs, matches, poses against truth, resume, outputs, bad input."""

import dataclasses
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.cli import main
from gsut.gaussians import measure_rotation_angles, quaternion_from_rotation
from gsut.sfm import connection
from gsut.sfm.lens import given
from gsut.sfm.lens.candidates import guess_lens
from gsut.sfm.lens.search import search_lens
from gsut.sfm.mapping.log import PosesLog
from gsut.sfm.matches import matching
from gsut.sfm.matches.matching import choose_pairs, has_growing_numbers
from gsut.sfm.matches.selection import choose_connected_pairs, keep_most_distinct
from gsut.sfm.photographs import Images
from gsut.sfm.photographs import features as core_features
from gsut.sfm.photographs.features import _PIXELS_EACH, detect_features, read_features
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.pipeline import find_poses
from gsut.sfm.solution import solver
from gsut.sfm.solution.result import similarity_from_points
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.world.comparison import compare_poses, find_centers
from synthetic_walk import Synthetic

_BESIDE = Path(__file__).resolve().parents[4] / "shared"
SPONZA = Path(os.environ.get("GSUT_SHARED", _BESIDE)) / "data" / "sponza_fisheye"
IMAGES = 12  # of sponza_fisheye, in a row: enough for a path, few enough for a test


# --- a synthetic scene: features through a lens of 200 degrees ------------------------------------


def test_estimate_poses_synthetic_walk_finds_all_poses_within_noise(rng):
    scene = Synthetic(rng)
    found = scene.solve()
    assert found["registered"].all()
    errors = compare_poses(found["camera_from_world"], np.array(scene.poses))
    assert errors.rotation_degrees.max() < tolerances.SFM_SYNTHETIC_DEGREES
    assert errors.ate_percent < tolerances.SFM_SYNTHETIC_ATE_PERCENT
    assert len(found["points"]) > 400
    behind = 0
    for point, image, _ in found["observations"]:
        pose = found["camera_from_world"][image]
        behind += (pose[:3, :3] @ found["points"][point] + pose[:3, 3])[2] < 0
    assert behind > 20  # observations behind the camera plane are used, not dropped


def test_estimate_poses_features_of_another_kind_are_weighed_by_their_own_noise(rng):
    inexact = np.arange(500) % 2 == 1
    scene = Synthetic(rng, noise=np.where(inexact, 1.0, 0.2)[:, None])
    of_points = []
    for pose, features in zip(scene.poses, scene.features, strict=True):
        pixels, _ = scene.camera.project(scene.points @ pose[:3, :3].T + pose[:3, 3])
        apart = np.linalg.norm(features.pixels[:, None] - pixels, axis=2)
        of_points.append(inexact[np.nanargmin(apart, axis=1)].tolist())
    alike, weighed = scene.solve(max_error=5.0), scene.solve(max_error=5.0, is_other=of_points)
    assert alike["other_noise"] == 1.0
    low, high = tolerances.SFM_OTHER_NOISE
    assert low < weighed["other_noise"] < high  # 5
    ate = [
        compare_poses(each["camera_from_world"], np.array(scene.poses)).ate_percent
        for each in (alike, weighed)
    ]
    assert ate[1] < tolerances.SFM_OTHER_NOISE_ATE_RATIO * ate[0]
    with pytest.raises(gsut.InputError, match="one flag a feature"):
        scene.solve(is_other=[row[:-1] for row in of_points])


def test_estimate_poses_thinned_finds_poses_as_well_as_by_all_tracks(rng):
    scene = Synthetic(rng, images=12, points=900)
    found = {thin_from: scene.solve(thin_from=thin_from) for thin_from in (6, 100)}
    thinned, whole = found[6], found[100]
    assert not np.array_equal(thinned["camera_from_world"], whole["camera_from_world"])
    errors = {
        key: compare_poses(each["camera_from_world"], np.array(scene.poses)).ate_percent
        for key, each in found.items()
    }
    assert errors[6] < tolerances.SFM_THINNED_ATE_RATIO * errors[100]
    assert len(thinned["points"]) > 0.99 * len(whole["points"])


def test_solve_extends_tracks_to_images_that_no_match_told_of(rng, monkeypatch):
    scene = Synthetic(rng)
    # Neighbours only, and half of their matches: tracks in pieces.
    half = [
        dataclasses.replace(pair, matches=pair.matches[rng.random(len(pair.matches)) < 0.5])
        for pair in scene.verified()
        if pair.second - pair.first <= 2
    ]
    found = {}
    for rounds in (0, 2):
        monkeypatch.setattr(solver, "_EXTEND_ROUNDS", rounds)
        found[rounds] = solve_poses(scene.images(), half, PosesOptions())
    lengths = {rounds: len(s.observations) / len(s.points) for rounds, s in found.items()}
    assert lengths[2] > 1.4 * lengths[0]  # worst 1.58
    assert len({tuple(row) for row in found[2].observations[:, 1:]}) == len(found[2].observations)
    truth = np.array(scene.poses)
    errors = {k: compare_poses(s.camera_from_world, truth) for k, s in found.items()}
    assert errors[2].ate_percent < min(errors[0].ate_percent, tolerances.SFM_SYNTHETIC_ATE_PERCENT)
    assert errors[2].rotation_degrees.max() < tolerances.SFM_SYNTHETIC_DEGREES


def test_estimate_poses_covariances_hold_the_gauge_and_are_positive(rng):
    found = Synthetic(rng).solve()
    first, second = found["initial_pair"]
    covariances = found["covariances"]
    assert not covariances[first].any()
    assert (np.diagonal(covariances[second])[:3] == 0).sum() == 1
    free = [i for i in range(len(covariances)) if i not in (first, second)]
    assert len(free) == 6
    for i in free:
        assert np.linalg.eigvalsh(covariances[i]).min() > 0


def test_estimate_poses_stopped_by_progress_raises_its_exception(rng):
    scene = Synthetic(rng)

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _core.estimate_poses(
            [scene.camera], [0] * 8, [f.pixels for f in scene.features],
            [p.as_tuple() for p in scene.verified()], scene.settings(), stop,
        )  # fmt: skip


@pytest.mark.parametrize("thin_from", [6, 100])
def test_estimate_poses_is_the_same_on_any_number_of_threads(rng, thin_from):
    scene = Synthetic(rng, images=8, points=900, noise=0.3)
    before, found = _core.num_threads(), []
    try:
        for threads in (1, 2, 3):
            _core.set_num_threads(threads)
            free = [[1] * len(scene.camera.params)]
            found.append(scene.solve(lens_free=free, thin_from=thin_from))
    finally:
        _core.set_num_threads(before)
    for other in found[1:]:
        for key in ("camera_from_world", "points", "covariances"):
            assert np.array_equal(found[0][key], other[key]), key
    assert found[0]["registered"].all()


def test_match_pairs_of_floats_are_refused(rng):
    unit = [f.normalize_descriptors() for f in Synthetic(rng, images=2, points=50).features]
    with pytest.raises(gsut.InputError, match="uint8"):
        _core.match_pairs(unit, [[0, 1]], 0.8, 0.7)


def test_estimate_poses_unknown_setting_is_refused(rng):
    with pytest.raises(gsut.InputError, match="no setting speed"):
        _core.estimate_poses([], [], [], [], {"speed": 1}, None)


def test_relative_pose_agrees_with_opencv_on_a_narrow_lens(rng):
    camera = gsut.Camera("pinhole", [800, 800, 320, 240], 640, 480)
    points = rng.uniform([-2, -1.5, 4], [2, 1.5, 9], (300, 3))
    pose = _core.exp_pose([0.4, 0.05, 0.1, 0.05, -0.1, 0.02])
    first = camera.project(points)[0]
    second = camera.project(points @ pose[:3, :3].T + pose[:3, 3])[0]
    first += 0.2 * rng.standard_normal(first.shape)
    second += 0.2 * rng.standard_normal(second.shape)
    order = np.stack([np.arange(300)] * 2, axis=1).astype(np.int32)
    images = [_core.ImageBearings(camera, first), _core.ImageBearings(camera, second)]
    ((inliers, found, turned, _, ok),) = _core.verify_pairs(images, [[0, 1]], [order], 2.0, 0)
    assert ok and inliers.mean() > 0.95 and turned < 0.5 * inliers.sum()
    matrix = np.array([[800.0, 0, 319.5], [0, 800, 239.5], [0, 0, 1]])
    a, b = first - 0.5, second - 0.5
    essential, mask = cv2.findEssentialMat(a, b, matrix, threshold=1.0)
    rotation, shift = cv2.recoverPose(essential, a, b, matrix, mask=mask)[1:3]
    by_cv2 = np.degrees(measure_rotation_angles((rotation @ pose[:3, :3].T)[None]))[0]
    ours = np.degrees(measure_rotation_angles((found[:3, :3] @ pose[:3, :3].T)[None]))[0]
    assert ours < max(2 * by_cv2, 0.1)  # ours is refined on all inliers, cv2's is not
    direction = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    assert found[:3, 3] @ direction > min(float(shift.ravel() @ direction), 0.999)


# --- pairs, features, alignment -------------------------------------------------------------------


def test_choose_pairs_rules(rng, monkeypatch):
    scene = Synthetic(rng, images=5, points=100)
    names = [f"f{i:03d}.png" for i in range(5)]
    everything = choose_pairs(names, scene.features, PosesOptions())
    assert len(everything) == 10
    monkeypatch.setattr(matching, "WINDOW", 1)
    near = choose_pairs(names, scene.features, PosesOptions(pairs="sequential"))
    assert near.tolist() == [[0, 1], [0, 2], [0, 4], [1, 2], [1, 3], [2, 3], [2, 4], [3, 4]]
    monkeypatch.setattr(matching, "_MOST_PARTNERS", 2)
    alike = choose_pairs(names, scene.features, PosesOptions(pairs="similar"))
    assert 5 <= len(alike) <= 10 and (alike[:, 0] < alike[:, 1]).all()
    assert (
        has_growing_numbers(names)
        and not has_growing_numbers(["a1", "b2"])
        and not has_growing_numbers(["a2", "a1"])
    )


def test_find_features_puts_a_blob_at_its_pixel(tmp_path):
    y, x = np.mgrid[:200, :240] + 0.5
    image = np.zeros((200, 240))
    centers = [(60.25, 80.5), (150.75, 100.0), (190.0, 40.5)]
    for cx, cy in centers:
        image += np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 4.0**2))
    path = tmp_path / "blobs.png"
    cv2.imwrite(str(path), (255 * image).clip(0, 255).astype(np.uint8))
    found = read_features(path, None, PosesOptions())
    for center in centers:
        nearest = np.linalg.norm(found.pixels - center, axis=1).min()
        assert nearest < tolerances.SIFT_BLOB_PIXELS


def test_find_features_leaves_out_what_has_no_ray(tmp_path):
    rng = np.random.default_rng(3)
    path = tmp_path / "noise.png"
    cv2.imwrite(
        str(path), cv2.GaussianBlur(rng.integers(0, 255, (200, 200), np.uint8), (0, 0), 1.5)
    )
    camera = gsut.Camera(
        "kannala_brandt", [60, 60, 100, 100, 0, 0, 0, 0], 200, 200, valid_field_angle=1.0
    )
    found = read_features(path, camera, PosesOptions())
    assert len(found) > 50
    assert np.linalg.norm(found.pixels - 100, axis=1).max() < 60
    with pytest.raises(gsut.InputError, match="the lens is for 100 x 100"):
        read_features(path, camera.resize(100, 100), PosesOptions())


@pytest.mark.parametrize("most", [150, 100])  # of 200 x 200 pixels: described before, and after
def test_find_features_at_once_finds_those_of_detection_and_choice(tmp_path, most):
    texture(tmp_path / "a.png", 3, 200)
    image = cv2.imread(str(tmp_path / "a.png"))
    assert (image[..., 0].size < _PIXELS_EACH * most) == (most == 150)
    options = PosesOptions(max_features=most)
    at_once = detect_features(image, None, options)
    chosen = detect_features(image, np.ones(image.shape[:2], bool), options)
    assert (
        most <= len(at_once) <= most + 5 and len(chosen) == most
    )  # SIFT keeps those equal to the last
    own = {(*p, *d) for p, d in zip(at_once.pixels, at_once.descriptors, strict=True)}
    assert own >= {(*p, *d) for p, d in zip(chosen.pixels, chosen.descriptors, strict=True)}


def test_similarity_is_found_again(rng):
    source = rng.standard_normal((10, 3))
    rotation = _core.exp_pose([0, 0, 0, 0.3, -1.0, 2.0])[:3, :3]
    target = 2.5 * source @ rotation.T + [1, 2, 3]
    scale, found, shift = similarity_from_points(source, target)
    assert abs(scale - 2.5) < 1e-12 and np.abs(found - rotation).max() < 1e-12
    assert np.abs(shift - [1, 2, 3]).max() < 1e-12


def test_quaternion_of_any_rotation(rng):
    turns = [*rng.standard_normal((50, 3)), [np.pi, 0, 0], [0, np.pi, 0], [0, 0, 0]]
    for turn in turns:
        rotation = _core.exp_pose([0, 0, 0, *turn])[:3, :3]
        w, x, y, z = quaternion_from_rotation(rotation)
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        assert np.abs(np.eye(3) + 2 * w * skew + 2 * skew @ skew - rotation).max() < 1e-12


def test_guess_lens_has_the_field_of_view():
    for fov in (50.0, 90.0, 150.0):
        camera = guess_lens(640, 480, fov)
        edge = camera.unproject(np.array([[640.0, 240.0]]))[0][0]
        assert abs(np.degrees(np.arctan2(edge[0], edge[2])) - fov / 2) < 1e-6
    with pytest.raises(gsut.InputError, match="--fov"):
        PosesOptions(fov=1.0)


# --- real images ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def some_sponza(tmp_path_factory):
    """A folder with a few images of sponza_fisheye, their lens and their mask; and the truth."""
    if not SPONZA.is_dir():
        pytest.skip("shared data is absent")
    folder = tmp_path_factory.mktemp("sponza")
    (folder / "images").mkdir()
    scene = gsut.load_dataset(SPONZA, test_every=0)
    views = [v for v in scene.views if "train" in v.name][:IMAGES]
    for view in views:
        (folder / "images" / Path(view.name).name).symlink_to(view.image_path)
    (folder / "mask.png").symlink_to(SPONZA / "mask.png")
    gsut.save_camera(scene.cameras[0], folder / "lens.yaml")
    truth = {Path(v.name).name: v.camera_from_world for v in views}
    return folder, truth, scene.cameras[0]


@pytest.fixture(scope="module")
def solved_sponza(some_sponza, tmp_path_factory):
    """The same, solved by the command line."""
    out = tmp_path_factory.mktemp("solved") / "data"
    assert main(["poses", str(some_sponza[0]), "-o", str(out), "--quiet"]) == 0
    return out


def test_poses_command_sponza_poses_agree_with_truth(some_sponza, solved_sponza):
    truth = some_sponza[1]
    scene = gsut.load_dataset(solved_sponza, test_every=0)
    assert len(scene.views) == IMAGES
    found = np.array([view.camera_from_world for view in scene.views])
    reference = np.array([truth[Path(view.name).name] for view in scene.views])
    errors = compare_poses(found, reference)
    assert np.median(errors.rotation_degrees) < tolerances.SFM_SPONZA_DEGREES
    assert errors.ate_percent < tolerances.SFM_SPONZA_ATE_PERCENT
    assert scene.views[0].mask_path is not None


def test_poses_command_writes_figures_report_and_colmap(some_sponza, solved_sponza):
    figures = json.loads((solved_sponza / "poses.json").read_text())
    assert figures["registered"] == figures["images"] == IMAGES
    assert set(figures["seconds"]) == {"features", "matching", "mapping", "writing", "total"}
    assert 0 < figures["reprojection_error_px"]["median"] < 0.5
    assert len(figures["views"]) == IMAGES
    assert np.array(figures["views"][-1]["covariance"]).shape == (6, 6)
    page = (solved_sponza / "report.html").read_text()
    assert page.count("data:image/svg+xml") == 3 and "12 of 12 images" in page
    assert not (solved_sponza / "stages").exists()
    # The COLMAP model says the same as transforms.json.
    scene = gsut.load_dataset(solved_sponza, test_every=0)
    from gsut.data.layouts.colmap import read_colmap

    colmap = solved_sponza / "sparse" / "0"
    (solved_sponza / "images").symlink_to(some_sponza[0] / "images")
    frames = {f.name: f for f in read_colmap(solved_sponza).frames}
    (solved_sponza / "images").unlink()
    assert colmap.is_dir() and len(frames) == IMAGES
    for view in scene.views:
        frame = frames[Path(view.name).name]
        assert frame.camera == some_sponza[2].with_valid_field_angle(None)
        own = np.linalg.inv(frame.world_from_camera)[:3, :3]
        assert np.abs(own - view.camera_from_world[:3, :3]).max() < 1e-9


def test_poses_command_killed_goes_on_from_its_last_stage(some_sponza, tmp_path, monkeypatch):
    out = tmp_path / "data"
    calls = {"features": 0}
    original = core_features._read_all_features

    def counted(photographs, chosen, *rest):
        calls["features"] += len(chosen)
        return original(photographs, chosen, *rest)

    def killed(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(core_features, "_read_all_features", counted)
    with monkeypatch.context() as patch:
        patch.setattr("gsut.sfm.mapping.state.solve_poses", killed)
        with pytest.raises(KeyboardInterrupt):
            find_poses(some_sponza[0], out)
    assert calls["features"] == IMAGES
    with monkeypatch.context() as patch:  # features and matches are not made again
        patch.setattr(matching, "choose_pairs", killed)
        result = find_poses(some_sponza[0], out)
    assert calls["features"] == IMAGES
    assert result.solution.num_registered == IMAGES


def test_poses_command_corrupt_image_is_named_and_the_rest_kept(some_sponza, tmp_path):
    folder = tmp_path / "in"
    (folder / "images").mkdir(parents=True)
    for i, path in enumerate(sorted((some_sponza[0] / "images").iterdir())):
        target = folder / "images" / path.name
        if i == 3:
            target.write_bytes(path.read_bytes()[:5000])
        elif i < 8:
            target.symlink_to(path.resolve())
    notes: list[str] = []
    result = find_poses(
        folder,
        tmp_path / "out",
        camera=some_sponza[0] / "lens.yaml",
        log=PosesLog(on_note=notes.append),
    )
    assert result.solution.num_registered == 7
    name = result.solution.unregistered_names[0]
    assert any(name in note and "truncated" in note for note in notes)
    assert any("7 of 8 images were registered" in note for note in notes)


# --- bad input ------------------------------------------------------------------------------------


def texture(path: Path, seed: int, size: int = 160) -> None:
    """A picture with many features."""
    noise = np.random.default_rng(seed).integers(0, 255, (size, size, 3), np.uint8)
    cv2.imwrite(str(path), cv2.GaussianBlur(noise, (0, 0), 1.5))


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("absent", "is not a folder"),
        ("one", "in holds 1 image"),
        ("same", "all images are the same"),
        ("apart", "matches that agree"),
        ("flat", "almost no features"),
    ],
)
def test_poses_command_bad_images_get_one_clear_sentence(case, words, tmp_path, capsys):
    folder = tmp_path / "in"
    if case != "absent":
        folder.mkdir()
    counts = {"absent": 0, "one": 1}
    for i in range(counts.get(case, 4)):
        path = folder / f"{i}.png"
        if case == "flat":
            cv2.imwrite(str(path), np.full((160, 160, 3), 90, np.uint8))
        else:
            texture(path, 0 if case == "same" else i)
    assert main(["poses", str(folder), "-o", str(tmp_path / "out"), "--quiet", "--fov", "60"]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert not (tmp_path / "out" / "transforms.json").exists()


def test_poses_command_wrong_lens_is_doubted(some_sponza, solved_sponza, tmp_path, monkeypatch):
    monkeypatch.setattr(connection, "add_learned_features", lambda *_: None)  # no better through it
    monkeypatch.setattr(given, "adjust_without_groups", lambda *_: None)  # which would say it first
    gsut.save_camera(gsut.Camera("pinhole", [240, 240, 240, 240], 480, 480), tmp_path / "lens.yaml")
    result = find_poses(some_sponza[0], tmp_path / "out", camera=tmp_path / "lens.yaml")
    verdict = result.figures["verdict"]
    assert verdict["level"] == "poor" and "--unknown-lens" in verdict["advice"]
    assert result.figures["matches_in_points"] < 0.5  # observed 0.36 on 8 of these images
    assert any("images agree through the given one" in n for n in result.figures["notes"])
    right = json.loads((solved_sponza / "poses.json").read_text())
    assert right["matches_in_points"] > 0.85  # observed 0.92
    assert not any("lens" in note for note in right["notes"])


def test_poses_command_covariances_are_as_large_as_the_errors(some_sponza, solved_sponza):
    figures = json.loads((solved_sponza / "poses.json").read_text())
    views = figures["views"]
    found = np.array([view["camera_from_world"] for view in views])
    truth = np.array([some_sponza[1][Path(view["name"]).name] for view in views])
    names = [view["name"] for view in views]
    first, second = (names.index(name) for name in figures["initial_pair"])
    squares = normalised_squares(
        found, truth, np.array([view["covariance"] for view in views]), first, second
    )
    # Six degrees of freedom; 12 images of one path are nearly one draw.
    assert 6 / tolerances.SFM_COVARIANCE < np.mean(squares) < 6 * tolerances.SFM_COVARIANCE


def normalised_squares(found, truth, covariances, first, second):
    """Squared errors of poses by their covariances, in the gauge of the initial pair."""
    turn = found[first, :3, :3].T @ truth[first, :3, :3]
    own, true = find_centers(found), find_centers(truth)
    shift = (true - true[first]) @ turn.T
    axis = np.abs(own[second] - own[first]).argmax()
    true = own[first] + (own[second] - own[first])[axis] / shift[second, axis] * shift
    squares = []
    for i in set(range(len(found))) - {first, second}:
        a, b = np.eye(4), np.eye(4)
        a[:3, :3], b[:3, :3] = truth[i, :3, :3] @ turn.T, found[i, :3, :3]
        error = np.concatenate([own[i] - true[i], _core.velocity_between(a, b)[3:]])
        squares.append(error @ np.linalg.solve(covariances[i], error))
    return squares


def test_poses_command_camera_that_only_turns_gets_one_clear_sentence(tmp_path, capsys):
    folder = tmp_path / "in"
    folder.mkdir()
    texture(tmp_path / "wide.png", 1, 700)
    wide = cv2.imread(str(tmp_path / "wide.png"))
    matrix = np.array([[300.0, 0, 120], [0, 300, 120], [0, 0, 1]])
    for i in range(4):
        turn = _core.exp_pose([0, 0, 0, 0.05 * (i % 2), 0.12 * i - 0.18, 0.03 * i])[:3, :3]
        wide_matrix = np.array([[300.0, 0, 350], [0, 300, 350], [0, 0, 1]])
        view = matrix @ turn @ np.linalg.inv(wide_matrix)
        cv2.imwrite(str(folder / f"{i}.png"), cv2.warpPerspective(wide, view, (240, 240)))
    gsut.save_camera(
        gsut.Camera("pinhole", [300, 300, 120.5, 120.5], 240, 240), folder / "lens.yaml"
    )
    assert main(["poses", str(folder), "-o", str(tmp_path / "out"), "--quiet"]) == 2
    message = capsys.readouterr().err
    assert "the camera turned but did not move" in message and message.count("\n") == 1
    assert not (tmp_path / "out" / "transforms.json").exists()


def test_poses_options_are_checked():
    with pytest.raises(gsut.InputError, match="--pairs must be one of"):
        PosesOptions(pairs="some")
    with pytest.raises(gsut.InputError, match="max_error must"):
        PosesOptions(max_error=0.0)


# --- unknown lens and benchmark -------------------------------------------------------------------


def test_search_lens_finds_the_fisheye_of_a_synthetic_walk(rng):
    fisheye = gsut.Camera(
        "kannala_brandt", [300, 300, 500, 505, 0.02, -0.01, 0.002, -0.0003], 1000, 1010
    )
    scene = Synthetic(rng, images=8, points=700, noise=0.1, camera=fisheye)
    options = PosesOptions(max_error=6.0, fov=180.0)
    found = scene.mapping(options, camera=guess_lens(1000, 1010, 180.0))
    found = search_lens(found)
    assert found.solved.registered.all()
    lens = found.solved.cameras[0]
    assert lens.model == "kannala_brandt"
    assert abs(lens.params[0] / scene.camera.params[0] - 1) < tolerances.SFM_FOCAL


def test_keep_most_distinct_keeps_the_most_distinct_matches(rng):
    (pair, *_) = Synthetic(rng, images=2).verified()
    (few,) = keep_most_distinct([pair], 10)
    assert np.array_equal(few.matches, pair.matches[:10])
    assert few.rotation_matches == round(pair.rotation_matches * 10 / len(pair.matches))
    assert keep_most_distinct([pair], len(pair.matches))[0] is pair


def test_connected_images_are_as_many_as_asked_for(rng):
    verified = Synthetic(rng, images=8).verified()
    few = choose_connected_pairs(verified, 4)
    assert len({i for pair in few for i in (pair.first, pair.second)}) == 4
    assert choose_connected_pairs(verified, 20) == verified


def test_poses_that_hold_no_image_are_an_error():
    found = {"failure": "", "registered": np.zeros(3, bool)}
    with pytest.raises(_core.SolveError, match="no image keeps its points"):
        solver._make_solution(Images(["a", "b", "c"], [], []), found, False)
