"""`gsut calibrate --from-dataset`: a disturbed lens and poses come back; bad input is named."""

import json
import re

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.cli import main
from gsut.lens import find_refinable_params
from gsut.sfm.lens.covariance import estimate_lens_covariances
from gsut.sfm.lens.refinement import _describe_held
from gsut.sfm.photographs import features as core_features
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.solution import Adjustment
from gsut.sfm.solution.solver import adjust_poses
from gsut.sfm.world.comparison import compare_poses
from small_datasets import OPENGL_FROM_OPENCV, transforms, write_nerfstudio
from synthetic_walk import Synthetic

IMAGES, NOISE_PX = 8, 0.2
# Focal length 2 % off, centre 3 and 2 px, k1 by 20 %.
OFF = np.array([1.02, 1.02, 1, 1, 1.2, 1, 1, 1])


def disturbed_lens(lens: gsut.Camera) -> gsut.Camera:
    params = lens.params * OFF + [0, 0, 3, -2, 0, 0, 0, 0]
    return gsut.Camera(lens.model, params, lens.width, lens.height)


def disturbed_poses(scene: Synthetic, rng) -> list[np.ndarray]:
    """By 0.2 degrees and 1 cm of a walk of 2 m."""
    return [_core.exp_pose(rng.normal(0, [0.01] * 3 + [0.0035] * 3)) @ p for p in scene.poses]


def write_disturbed(folder, scene, rng):
    """A data set with empty images; returns its lens and (N, 4, 4) camera_from_world."""
    (folder / "images").mkdir(parents=True)
    lens, poses = disturbed_lens(scene.camera), disturbed_poses(scene, rng)
    names = [f"images/{i}.png" for i in range(len(poses))]
    for name in names:
        cv2.imwrite(str(folder / name), np.zeros((lens.height, lens.width, 3), np.uint8))
    keys = ["fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4"]
    values = {
        "camera_model": "OPENCV_FISHEYE", "w": lens.width, "h": lens.height,
        **dict(zip(keys, lens.params.tolist(), strict=True)),
        "frames": [
            {"file_path": n, "transform_matrix": (np.linalg.inv(p) @ OPENGL_FROM_OPENCV).tolist()}
            for n, p in zip(names, poses, strict=True)
        ],
        "train_filenames": names[1:], "test_filenames": names[:1],
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(values))
    return lens, np.array(poses)


@pytest.fixture(scope="module")
def refined(tmp_path_factory):
    """Scene, disturbed lens and poses, and the folder of what the command wrote."""
    rng = np.random.default_rng(5)
    scene = Synthetic(rng, images=IMAGES, points=700, noise=NOISE_PX)
    folder = tmp_path_factory.mktemp("refined")
    lens, poses = write_disturbed(folder / "data", scene, rng)

    def found(photographs, chosen, options):
        return ((i, scene.features[i]) for i in chosen)

    words = ["calibrate", "--from-dataset", str(folder / "data"), "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_features, "_read_all_features", found)
        assert main([*words, "-o", str(folder / "lens.cameramodel")]) == 0
    return scene, lens, poses, folder


def test_from_dataset_lens_comes_back_within_its_own_uncertainty(refined):
    scene, lens, _, folder = refined
    report = json.loads((folder / "report.json").read_text())
    after = gsut.load_camera(folder / "lens.yaml").params
    sigma = np.array([row["sigma"] for row in report["params"]])
    assert [row["after"] for row in report["params"]] == pytest.approx(after, rel=1e-12)
    assert [row["before"] for row in report["params"]] == pytest.approx(lens.params, rel=1e-12)
    assert (sigma > 0).all()
    assert np.abs((after - scene.camera.params) / sigma).max() < tolerances.REFINED_LENS_SIGMAS
    assert (sigma[:4] < 0.2).all()  # pixels: says something, too
    assert report["noise_px"] == pytest.approx(NOISE_PX, rel=tolerances.REFINED_NOISE_RELATIVE)


def test_refine_of_a_splined_lens_holds_its_surface(rng):
    _, params, width, height = gsut._core.camera_examples("splined_stereographic")[0]
    lens = gsut.Camera("splined_stereographic", params, width, height)
    scene = Synthetic(rng, images=8, points=700, noise=NOISE_PX, camera=lens)
    start = lens.params.copy()
    start[4:8] += [2.0, 2.5, 2.0, -1.0]  # fx fy cx cy
    free = find_refinable_params(lens)
    assert np.flatnonzero(free).tolist() == [4, 5, 6, 7]
    found = adjust_poses(
        scene.images(lens.with_params(start)), scene.verified(), scene.poses, PosesOptions(),
        adjustment=Adjustment(free),
    )  # fmt: skip
    after = found.cameras[0].params
    assert np.array_equal(after[~free], lens.params[~free])
    sigmas = estimate_lens_covariances(found, free, PosesOptions().loss_scale)[0].sigmas
    errors = (after - lens.params)[free] / sigmas[free]
    assert np.abs(errors).max() < tolerances.REFINED_LENS_SIGMAS
    assert _describe_held(lens, free).startswith(
        "of the splined_stereographic lens fx, fy, cx, cy are"
    )


def distant_errors(found: gsut.Camera, truth: gsut.Camera, seen: np.ndarray, pixels: np.ndarray):
    """(N, 2) where `found` puts the directions that `truth` sees at `pixels`, less those; turned
    so that both lenses agree best at the pixels `seen`."""
    ours, theirs = (camera.unproject(seen)[0] for camera in (found, truth))
    good = np.isfinite(ours).all(axis=1) & np.isfinite(theirs).all(axis=1)
    left, _, right = np.linalg.svd(ours[good].T @ theirs[good])
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return found.project(truth.unproject(pixels)[0] @ turn.T)[0] - pixels


def test_lens_covariance_is_that_of_many_draws():
    z, lengths = [], []
    for seed in range(100, 116):
        rng = np.random.default_rng(seed)
        scene = Synthetic(rng, images=IMAGES, points=700, noise=NOISE_PX)
        found = adjust_poses(
            scene.images(disturbed_lens(scene.camera)), scene.verified(),
            disturbed_poses(scene, rng), PosesOptions(), adjustment=Adjustment(np.ones(8, bool)),
        )  # fmt: skip
        (covariance,) = estimate_lens_covariances(
            found, np.ones(8, bool), PosesOptions().loss_scale
        )
        z.append((found.cameras[0].params - scene.camera.params) / covariance.sigmas)
        seen = np.concatenate([features.pixels for features in scene.features])
        grid = seen[:: len(seen) // 50]
        sigma = covariance.estimate_projection_sigma(found.cameras[0], grid)
        error = distant_errors(found.cameras[0], scene.camera, seen, grid)
        lengths.append(np.linalg.norm(error, axis=1) / sigma)
        assert np.median(sigma) < 1.0  # pixels: says something, too
    low, high = tolerances.REFINED_SIGMA_RATIO
    assert low < np.sqrt(np.mean(np.square(z))) < high
    # sigma is that of the worst direction: between one and two such squares a length squared.
    # (Observed: 1.29.)
    assert low < np.sqrt(np.mean(np.square(lengths))) < high * np.sqrt(2)


def test_from_dataset_held_out_observations_fall_to_the_noise(refined):
    report = json.loads((refined[3] / "report.json").read_text())
    assert report["held_out_observations"] > 50
    assert report["held_out_before_px"] > 5 * report["held_out_after_px"]
    # The median length of two normal coordinates is 1.18 sigma; the points add to it.
    assert report["held_out_after_px"] < 1.5 * 1.18 * NOISE_PX


def test_from_dataset_page_shows_the_lens_before_and_after(refined):
    _, lens, _, folder = refined
    page = (folder / "report.html").read_text()
    assert page.count("<svg") == 4
    assert not re.search(r"(src|href)=\"http", page)  # self-contained
    assert f">fx</td><td>{lens.params[0]:.8g}</td>" in page
    rows = re.findall(r">\d, \d</td><td>([\d,]+)</td><td>([\d.]+)</td><td>([\d.]+)</td>", page)
    assert len(rows) == 9  # regions, each with observations
    for _, before, after in rows:
        assert float(after) < 2 * np.sqrt(2) * NOISE_PX < float(before)


def test_from_dataset_poses_come_back_with_the_split(refined):
    scene, _, poses, folder = refined
    dataset = gsut.load_dataset(folder / "lens-dataset", test_every=0)
    found = np.array([v.camera_from_world for v in sorted(dataset.views, key=lambda v: v.name)])
    after, before = (compare_poses(p, np.array(scene.poses)) for p in (found, poses))
    assert after.rotation_degrees.max() < before.rotation_degrees.max() / 4
    assert after.rotation_degrees.max() < 2 * tolerances.SFM_SYNTHETIC_DEGREES
    assert after.ate_percent < before.ate_percent / 10
    values = json.loads((folder / "lens-dataset" / "transforms.json").read_text())
    assert len(values["train_filenames"]) == IMAGES - 1 and len(values["test_filenames"]) == 1


def test_from_dataset_fisheye_goes_to_mrcal_as_the_nearest_splined(refined):
    folder = refined[3]
    exact = gsut.load_camera(folder / "lens.yaml")
    splined = gsut.load_camera(folder / "lens.cameramodel")
    pixels = np.stack(np.meshgrid([200.0, 400, 600, 800], [200.0, 400, 600, 800]), -1)
    rays, valid = exact.unproject(pixels.reshape(-1, 2))
    assert valid.all()
    off = splined.project(rays)[0] - pixels.reshape(-1, 2)
    assert np.abs(off).max() < tolerances.CALIB_SPLINE_LIKE_PX


def test_refine_from_poses_of_other_images_says_that_they_disagree(rng):
    scene = Synthetic(rng, images=4, points=200)
    poses = [_core.exp_pose(rng.normal(0, 1, 6)) for _ in scene.poses]
    with pytest.raises(_core.SolveError, match="points agree with the poses"):
        adjust_poses(
            scene.images(), scene.verified(), poses, PosesOptions(),
            adjustment=Adjustment(np.ones(8, bool)),
        )  # fmt: skip


def test_refine_structure_needs_one_pose_an_image(rng):
    scene = Synthetic(rng, images=2, points=50)
    pixels = [f.pixels for f in scene.features]
    with pytest.raises(gsut.InputError, match="found 1 poses of 2 images"):
        _core.refine_structure([scene.camera], [0, 0], pixels, [], scene.poses[:1], {}, None)
    with pytest.raises(gsut.InputError, match="names camera 1 of 1"):
        _core.refine_structure([scene.camera], [0, 1], pixels, [], scene.poses, {}, None)


# --- bad input ------------------------------------------------------------------------------------


def few_images() -> dict:
    values = transforms()
    return {**values, "frames": values["frames"][:2]}


def two_lenses() -> dict:
    values = transforms()
    values["frames"][3]["fl_x"] = 50.0
    return values


@pytest.mark.parametrize(
    ("values", "words", "sentence"),
    [
        (few_images, [], "has 2 images with a pose; refining a lens needs at least 3"),
        (two_lenses, [], "has 2 lenses; --from-dataset refines one"),
        (transforms, ["--board", "9x6"], "--from-dataset needs no board; leave out --board"),
        (transforms, ["-o", "lens.dat"], "lens.dat: the lens' file name must end in"),
        (transforms, ["-o", "absent/lens.dat"], "lens.dat: the lens' file name must end in"),
    ],
)
def test_from_dataset_bad_input_gets_one_clear_sentence(
    values, words, sentence, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    data = write_nerfstudio(tmp_path / "data", values())
    out = ["-o", str(tmp_path / "lens.yaml")]
    assert main(["calibrate", "--from-dataset", str(data), *out, "--quiet", *words]) == 2
    message = capsys.readouterr().err
    assert message.startswith("gsut: error: ") and message.count("\n") == 1
    assert sentence in message
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_calibrate_without_board_or_dataset_says_what_to_give(capsys):
    assert main(["calibrate", "x.png", "--spacing", "0.03", "-o", "lens.yaml"]) == 2
    assert "--board missing" in capsys.readouterr().err
    assert main(["calibrate", "-o", "lens.yaml"]) == 2
    assert "or --from-dataset DATA" in capsys.readouterr().err
