"""Each benchmark on small data: its rows hold time with error, quality or truth."""

import json

import numpy as np
import pytest

import gsut
import rendered_dataset
from demo_hall import write_hall
from tests.bench import render_bench
from tests.bench.__main__ import load_benchmark, main
from tests.bench.harness import HALL, measure_rows


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """A work folder that holds a small hall."""
    folder = tmp_path_factory.mktemp("bench")
    write_hall(folder / HALL, views=10, test_views=2, size=64)
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


def test_stages_of_a_step_add_up(tmp_path):
    (row,) = run_bench("steps", tmp_path, scenes=("synthetic_1k_64x48",), steps=2).values()
    stages = [row[key] for key in ("loss", "adam", "project", "forward", "backward", "gradients")]
    assert all(each >= 0 for each in stages) and row["step"] > 0


def test_train_measures_whole_commands(hall):
    (row,) = run_bench("train", hall, flags=("--steps 12 --max-gaussians 300",)).values()
    assert row["steps"] == 12 and row["psnr"] > 5
    assert row["seconds"] > row["train_seconds"] > 0 and row["cpu_seconds"] > 0


@pytest.mark.slow
def test_compact_measures_the_whole_model_methods_and_rivals(hall):
    options = {"keep": (0.5,), "finetune": 5, "steps": 20, "cap": 200, "scale": 1.0}
    rows = run_bench("compact", hall, **options)
    whole = rows["hall, whole model"]
    for name in ("hall, ghap, 0.5", "hall, trained that small, 0.5"):
        assert rows[name]["num_gaussians"] == round(0.5 * whole["num_gaussians"])
        assert 5 < rows[name]["psnr"] < 60 and rows[name]["render_ms"] > 0
        assert rows[name]["cpu_seconds"] > 0
    assert rows["hall, ghap, 0.5"]["cpu_seconds"] > whole["cpu_seconds"]


@pytest.mark.slow
def test_refine_measures_what_is_left_of_a_disturbance(hall):
    options = {"steps": 20, "max_gaussians": 300, "disturbances": ("small", "lens")}
    rows = run_bench("refine", hall, **options)
    small = "hall, 0.5 degrees, 2 cm"
    assert rows["hall, nothing, plain"]["rotation_degrees"] < 1e-6
    assert rows[f"{small}, plain"]["rotation_degrees"] > 0.05
    assert rows[f"{small}, refined"]["psnr"] > 5
    assert rows["hall, focal 2 %, k1 20 %, plain"]["focal_percent"] == pytest.approx(2.0)


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
