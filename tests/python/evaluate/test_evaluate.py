"""Evaluation: figures, rings, pictures; all against numbers worked out by hand."""

import math

import cv2
import numpy as np
import pytest

import gsut
import small_run
import tolerances
from gsut.evaluate.evaluation import compute_field_angles, evaluate, run_metrics
from gsut.metrics import RING_EDGES_DEGREES
from gsut.render.pictures import name_pictures, to_uint8
from gsut.run import TrainOptions

ERROR = 0.1  # of every colour value that the fake renderer shows


@pytest.fixture
def scene(tmp_path, monkeypatch):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene, ERROR)
    return scene


def test_evaluate_of_a_constant_error_gives_its_psnr_everywhere(scene):
    figures = evaluate(small_run.GAUSSIANS, scene, scene.test_indices)
    expected = -20 * math.log10(ERROR)
    close = {"abs": tolerances.PSNR_OF_CONSTANT_ERROR_DB}
    assert figures["psnr"] == pytest.approx(expected, **close)
    assert figures["psnr_min"] == pytest.approx(expected, **close)
    rings = figures["rings"]
    assert [ring["from_degrees"] for ring in rings] == list(RING_EDGES_DEGREES[:-1])
    for ring in rings:
        assert ring["psnr"] == pytest.approx(expected, **close)
    pixels_of_view = int(scene.mask(0).sum())
    assert sum(ring["pixels"] for ring in rings) == 2 * pixels_of_view
    assert [row["name"] for row in figures["views"]] == ["images/0.png", "images/3.png"]
    assert all(row["pixels"] == pixels_of_view for row in figures["views"])
    assert figures["render_ms"] > 0


def test_evaluate_figures_of_a_view_are_those_of_its_pictures(scene):
    for row, index in zip(
        evaluate(small_run.GAUSSIANS, scene, scene.test_indices)["views"],
        scene.test_indices,
        strict=True,
    ):
        truth, mask = scene.image(index).astype(np.float32) / np.float32(255), scene.mask(index)
        image = np.clip(truth + np.where(truth > 0.5, -ERROR, ERROR).astype(np.float32), 0, 1)
        assert row["ssim"] == pytest.approx(
            gsut.ssim(image, truth, mask), abs=tolerances.SSIM_IN_FLOAT
        )
        for name, figure in (
            ("psnr", gsut.psnr),
            ("psnr_color_corrected", gsut.metrics.color_corrected_psnr),
        ):
            assert row[name] == pytest.approx(
                figure(image, truth, mask), abs=tolerances.FIGURE_ROUNDING
            )


def test_evaluate_with_one_bad_view_names_it(tmp_path, monkeypatch):
    size = small_run.SIZE
    every_pixel = gsut.Camera("pinhole", [size, size, size / 2, size / 2], size, size)
    scene = small_run.scene_from_arrays(tmp_path / "data", every_pixel, inverted=3)
    small_run.install(monkeypatch, scene, ERROR)
    figures = evaluate(small_run.GAUSSIANS, scene, scene.test_indices)
    assert figures["worst_view"] == "images/3.png"
    good, bad = (row["psnr"] for row in figures["views"])
    assert figures["psnr"] == pytest.approx((good + bad) / 2)
    assert figures["psnr_min"] == bad < good


def test_evaluate_of_no_views_has_no_figures(scene):
    figures = evaluate(small_run.GAUSSIANS, scene, [])
    assert figures["psnr"] is None
    assert figures["worst_view"] is None
    assert figures["views"] == []


def test_evaluate_with_a_folder_writes_pictures_that_tell_color_and_distance(scene, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    figures = evaluate(small_run.GAUSSIANS, scene, scene.test_indices, render_folder=out)
    for row, index in zip(figures["views"], scene.test_indices, strict=True):
        mask = scene.mask(index)
        truth = cv2.imread(str(out / row["truth"]))[..., ::-1]
        assert np.array_equal(truth[mask], scene.image(index)[mask])
        assert not truth[~mask].any()
        depth = cv2.imread(str(out / row["depth"]), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        distance = depth * row["depth_unit"]
        np.testing.assert_allclose(distance[mask], small_run.DISTANCE, rtol=1 / 65535)
        assert not distance[~mask].any()
    assert len(list(out.iterdir())) == 6


def test_run_metrics_hold_every_promised_key(scene):
    figures = evaluate(small_run.GAUSSIANS, scene, scene.test_indices)
    options = TrainOptions(steps=50, seed=9)
    metrics = run_metrics(figures, small_run.GAUSSIANS, scene, options, steps=50, train_seconds=5.0)
    promised = [
        "psnr",
        "ssim",
        "num_gaussians",
        "steps",
        "train_seconds",
        "seconds_per_step",
        "render_ms",
        "peak_rss_mb",
        "camera_model",
        "threads",
        "isa",
        "seed",
        "version",
        "rings",
        "psnr_color_corrected",
        "views",
        "dataset",
        "test_views",
    ]
    assert [key for key in promised if metrics.get(key) is None] == []
    assert metrics["seconds_per_step"] == 0.1
    assert metrics["num_gaussians"] == 1234
    assert metrics["seed"] == 9
    assert metrics["camera_model"] == "kannala_brandt"
    assert metrics["world_offset"] == [10.0, 20.0, 30.0]


def test_field_angles_grow_from_the_axis_to_the_rim():
    angles = np.degrees(compute_field_angles(small_run.FISHEYE.resize(64, 64)))
    assert np.nanmin(angles) < 3
    assert 90 < np.nanmax(angles) < small_run.HALF_FIELD_DEGREES
    assert np.isnan(angles[0, 0])


def test_picture_stems_of_any_names_are_unique_file_names():
    names = ["a/0.png", "b/0.png", "a_0.jpg", "../x.png", "c.d.png"]
    assert name_pictures(names) == ["a_0", "b_0", "a_0-2", "x", "c.d"]


def test_to_uint8_rounds_clips_and_takes_nan_for_black():
    values = np.array([-1.0, 0.0, 0.5 / 255 + 1e-6, 1.0, 7.0, np.nan])
    assert to_uint8(values).tolist() == [0, 0, 1, 255, 255, 0]
