"""Each benchmark on small data: its rows hold time with error, quality or truth."""

import json
import shutil

import numpy as np
import pytest

import gsut
import rendered_dataset
import tolerances
from gsut import _core
from gsut.demo import make_demo_scene
from rendered_dataset import truth
from tests.bench import accuracy, render_bench, scenes
from tests.bench.__main__ import load_benchmark, main
from tests.bench.formats_bench import split_gaussians
from tests.bench.harness import HALL, measure_rows


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """A work folder that holds a small hall."""
    folder = tmp_path_factory.mktemp("bench")
    make_demo_scene(folder / HALL, views=10, test_views=2, size=64, progress=False)
    return folder


def run_bench(name, folder, only="", **options):
    benchmark = load_benchmark(name)
    settings = benchmark.settings(folder, **options)
    settings.sets = (HALL,)
    rows = measure_rows(benchmark, settings, only=only)
    return {benchmark.name_row(row): row for row in rows}


def test_render_rows_hold_times_with_errors(tmp_path, capsys):
    words = ["render", "--scenes", "synthetic_2k_64x48", "--runs", "2", "--steps", "2"]
    words += ["--tiles", "6", "--folder", str(tmp_path), "--json", str(tmp_path / "rows.json")]
    assert main([*words, "--threads", "2"]) == 0
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert row["image_rms_error"] <= render_bench.IMAGE_RMS_BOUND
    assert row["blend_ms"] > 0 and row["step_ms"] > row["blend_ms"]
    assert row["blend_speedup"] > 0 and row["threads"] == 2
    assert "image rms error" in capsys.readouterr().out


def test_render_of_a_wrong_result_prints_no_time(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(render_bench, "GRADIENT_RELATIVE_BOUND", 1e-12)
    words = ["render", "--scenes", "peer_500_32x32", "--runs", "1", "--steps", "1", "--tiles", "2"]
    assert main([*words, "--json", str(tmp_path / "rows.json")]) == 1
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert row["gradient_error"] > 1e-12
    assert [key for key in row if key.endswith("_ms") and row[key] is not None] == []
    assert "out of bounds" in capsys.readouterr().err


def test_sure_rows_hold_errors_of_the_scores_and_what_the_pass_takes(hall):
    rows = run_bench("sure", hall, steps=20, cap=800, side=64)
    (row,) = rows.values()
    assert abs(row["color_random"] - 1) < 0.2 and 0 < row["color_sigma"] < 1
    assert 0 < row["depth_sigma"] < 1.5 and 0 < row["depth_held"] <= 100
    assert row["least"] <= row["held"] <= row["most"] and row["held_95"] > row["held"]
    assert row["pass_seconds"] > 0 and row["cpu_seconds"] > 0


def test_approximations_hold_errors_swaps_depths_and_times(hall):
    film = hall / "orders.gif"
    options = {"counts": (200,), "responses": ("maximum",), "views": 1, "patches": 4}
    options |= {"integrals": 2, "flags": "--steps 5 --quiet", "film": str(film), "frames": 1}
    rows = run_bench("approximations", hall, **options)
    z, distance, ray, integral, ewa, unscented = rows.values()
    assert film.stat().st_size > 0
    for row in (z, distance, ray):
        assert row["psnr"] > 5 and row["error_db"] > 5
        assert row["frame_ms"] > row["blend_ms"] > 0 and row["backward_ms"] > 0
        assert row["mean_off"] >= abs(row["mean_bias"])
    assert integral["mean_off"] >= 0 and distance["median_off"] >= 0
    assert ewa["error_db"] > 5 and unscented["error_db"] > 5
    # What each order cannot do.
    swaps = (z["step"], distance["turn"], ray["turn"], ray["step"])
    assert max(swaps) < tolerances.RENDER_DOUBLE


def test_ways_miss_nothing_and_state_error_beside_time(tmp_path):
    options = {"counts": ("2k",), "runs": 1, "tiles": 2, "pixels": 48 * 48}
    rows = run_bench("ways", tmp_path, only="demo's fisheye, 2k, native", **options)
    rows |= run_bench("ways", tmp_path, only="splined, 2k, WebAssembly", **options)
    assert len(rows) == 1 + bool(shutil.which("node"))
    for row in rows.values():
        assert row["ms"] > 0 and row["cpu_ms"] > 0 and row["missed"] == 0
        assert row["image_rms_error"] <= render_bench.IMAGE_RMS_BOUND


def test_a_gaussian_that_is_left_out_is_counted_as_missed():
    scene = scenes.scene_from_arrays("synthetic_2k_64x48")
    truth = accuracy.make_truth(scene, _core.BlendRule(), tiles=4, with_gradients=False)
    whole = gsut.render(scene.gaussians, scene.camera, scene.camera_from_world)
    assert accuracy.count_missed(truth, whole.alpha, 1 / 255) == 0
    some = gsut.render(scene.gaussians[::2], scene.camera, scene.camera_from_world)
    assert accuracy.count_missed(truth, some.alpha, 1 / 255) > 100


def test_stages_of_a_step_add_up(tmp_path):
    (row,) = run_bench("steps", tmp_path, scenes=("synthetic_1k_64x48",), steps=2).values()
    stages = [row[key] for key in ("loss", "adam", "project", "forward", "backward", "gradients")]
    assert all(each >= 0 for each in stages) and row["step"] > 0


def test_train_measures_whole_commands(hall):
    (row,) = run_bench("train", hall, flags=("--steps 12 --max-gaussians 300",)).values()
    assert row["steps"] == 12 and row["psnr"] > 5
    assert row["seconds"] > row["train_seconds"] > 0 and row["cpu_seconds"] > 0


def test_compact_measures_the_whole_model_methods_and_rivals(hall):
    options = {"keep": (0.5,), "finetune": 5, "steps": 20, "cap": 200, "scale": 1.0}
    rows = run_bench("compact", hall, **options)
    whole = rows["hall, whole model"]
    for name in ("hall, ghap, 0.5", "hall, trained that small, 0.5"):
        assert rows[name]["num_gaussians"] == round(0.5 * whole["num_gaussians"])
        assert 5 < rows[name]["psnr"] < 60 and rows[name]["render_ms"] > 0
        assert rows[name]["cpu_seconds"] > 0
    assert rows["hall, ghap, 0.5"]["cpu_seconds"] > whole["cpu_seconds"]


def test_refine_measures_what_is_left_of_a_disturbance(hall):
    options = {"steps": 20, "max_gaussians": 300, "disturbances": ("small", "lens")}
    rows = run_bench("refine", hall, **options)
    small = "hall, 0.5 degrees, 2 cm"
    assert rows["hall, nothing, plain"]["rotation_degrees"] < 1e-6
    assert rows[f"{small}, plain"]["rotation_degrees"] > 0.05
    assert rows[f"{small}, refined"]["psnr"] > 5
    assert rows["hall, focal 2 %, k1 20 %, plain"]["focal_percent"] == pytest.approx(2.0)


def test_blocks_are_compared_with_one_training_of_as_many_steps(hall, monkeypatch):
    options = {"steps": 10, "flags": "--max-gaussians 400 --threads 2", "size": 48, "blocks": 2}
    rows = run_bench("blocks", hall, **options)
    assert rows["hall, one, as many steps"]["below"] == 0.0
    assert rows["hall, one, as many steps"]["steps"] == rows["hall, blocks"]["steps"] > 10
    assert rows["hall, blocks, two workers"]["bits"] == "same"
    assert 0 <= rows["hall, blocks"]["seam_percent"] <= 100


def test_formats_hold_bytes_and_psnr(hall):
    rows = run_bench("formats", hall, steps=20)
    assert rows["hall, PLY"]["psnr"] == rows["hall, glTF"]["psnr"] == 99.9
    assert rows["hall, SPZ 3"]["bytes_each"] < rows["hall, PLY"]["bytes_each"]
    for name in ("SPZ 3", "SOG", "compressed PLY"):
        assert 30 < rows[f"hall, {name}"]["psnr"] < 99.9
    assert "psnr" not in rows["hall, HTML"] and rows["hall, HTML"]["write_cpu_s"] > 0


def test_split_gaussians_fill_the_same_space_with_more(rng):
    g = truth(rng, 200)
    more = split_gaussians(g, 10)
    assert len(more) == 2000 and split_gaussians(g, 1) is g
    moved = np.linalg.norm(more.means - np.repeat(g.means, 10, axis=0), axis=1)
    assert 0 < np.median(moved) < np.exp(g.log_scales).max()
    volume = np.exp(np.mean(more.log_scales.sum(axis=1) - np.repeat(g.log_scales, 10, 0).sum(1)))
    np.testing.assert_allclose(volume, 0.1, rtol=tolerances.BENCH_SPLIT_SHARE)


def test_surfaces_measure_balls_and_fusion(tmp_path):
    benchmark = load_benchmark("surfaces")
    settings = benchmark.settings(tmp_path, steps=0, views=12, size=64, across=(20,), frames=0)
    rows = measure_rows(benchmark, settings)
    assert [row["what"].split(",")[0] for row in rows] == ["ball"] * 3 + ["fusion"]
    assert all(0 < row["voxels_off"] < 0.3 for row in rows[:-1])
    assert all(row["blocks"] > 0 and row["cpu_seconds"] >= 0 for row in rows)


def test_surfaces_measure_stereo_by_ring(tmp_path):
    benchmark = load_benchmark("surfaces")
    settings = benchmark.settings(tmp_path, steps=0, frames=2)
    (row,) = measure_rows(benchmark, settings, only="stereo, splined")
    assert 0 < row["off_0"] < 20 and 10 < row["known_0"] < 100


def test_surfaces_measure_meshes_with_and_without_refine(hall, monkeypatch):
    monkeypatch.setattr("gsut.surface.worth._SAMPLES", 2000)
    options = {"steps": 60, "seeds": (0,), "lenses": ("fisheye",)}
    (row,) = run_bench("surfaces", hall, only="plain", **options).values()
    assert 0 < row["median"] < 50 and row["psnr"] > 10
    for prefix in ("", "refined_"):
        assert 0 < row[f"{prefix}f1"] < row[f"{prefix}f2"] < row[f"{prefix}f5"] < 1
        assert 0.3 < row[f"{prefix}normals"] < 1 and row[f"{prefix}mesh_seconds"] > 0


def test_light_is_compared_with_the_truth(hall):
    options = {"steps": 20, "max_gaussians": 200, "views": 8, "size": 48}
    rows = run_bench("light", hall, only="falloff + noise", **options)
    assert [row["flags"] for row in rows.values()] == ["--exposure off", "--exposure auto"]
    assert all(row["psnr_truth"] > 3 for row in rows.values())


def test_localize_compares_errors_with_the_stated_ones(tmp_path):
    make_demo_scene(tmp_path / HALL, views=14, test_views=2, size=96, progress=False)
    rows = run_bench("localize", tmp_path, only="good lens", views=1, steps=60)
    (row,) = rows.values()
    assert row["found"] in ("0 of 1", "1 of 1")


def test_isa_compares_every_instruction_set_with_the_first(tmp_path):
    rows = run_bench("isa", tmp_path, steps=5)
    assert [row["isa"] for row in rows.values()] == list(_core.available_isas())
    assert next(iter(rows.values()))["apart"] == 0.0


def test_lens_is_judged_by_where_its_rays_go(tmp_path, rng):
    from disturbances import Disturbance, disturb_scene
    from gsut.refine.trust import measure_lens_distance

    data = rendered_dataset.write_dataset(tmp_path / "data", rng)
    scene = gsut.load_dataset(data)
    (true,) = scene.file_cameras
    (longer,) = disturb_scene(scene, Disturbance("focal", focal=0.01), 0).file_cameras
    assert measure_lens_distance(true, true) == 0.0
    rays, valid = true.rays()
    pixels, _ = true.project(rays[valid])
    expected = 0.01 * np.sqrt(np.mean(np.sum((pixels - true.params[2:4]) ** 2, axis=1)))
    np.testing.assert_allclose(measure_lens_distance(longer, true), expected, rtol=1e-9)
