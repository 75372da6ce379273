"""Each benchmark of lab/ on small data: its rows hold time with error, quality or truth."""

import pytest

import tolerances
from gsut import _core
from lab.bench.__main__ import PACKAGES
from lab.demo_tracer import make_demo_scene
from tests.bench.__main__ import load_benchmark
from tests.bench.harness import HALL, measure_rows


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """A work folder that holds a small hall."""
    folder = tmp_path_factory.mktemp("bench")
    make_demo_scene(folder / HALL, views=10, test_views=2, size=64, progress=False)
    return folder


def run_bench(name, folder, only="", **options):
    benchmark = load_benchmark(name, PACKAGES)
    settings = benchmark.settings(folder, **options)
    settings.sets = (HALL,)
    rows = measure_rows(benchmark, settings, only=only)
    return {benchmark.name_row(row): row for row in rows}


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


def test_surfaces_measure_balls_and_fusion(tmp_path):
    benchmark = load_benchmark("surfaces", PACKAGES)
    settings = benchmark.settings(tmp_path, steps=0, views=12, size=64, across=(20,), frames=0)
    rows = measure_rows(benchmark, settings)
    assert [row["what"].split(",")[0] for row in rows] == ["ball"] * 3 + ["fusion"]
    assert all(0 < row["voxels_off"] < 0.3 for row in rows[:-1])
    assert all(row["blocks"] > 0 and row["cpu_seconds"] >= 0 for row in rows)


def test_surfaces_measure_stereo_by_ring(tmp_path):
    benchmark = load_benchmark("surfaces", PACKAGES)
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


def test_localize_compares_errors_with_the_stated_ones(tmp_path):
    make_demo_scene(tmp_path / HALL, views=14, test_views=2, size=96, progress=False)
    rows = run_bench("localize", tmp_path, only="good lens", views=1, steps=60)
    (row,) = rows.values()
    assert row["found"] in ("0 of 1", "1 of 1")


def test_isa_compares_every_instruction_set_with_the_first(tmp_path):
    rows = run_bench("isa", tmp_path, steps=5)
    assert [row["isa"] for row in rows.values()] == list(_core.available_isas())
    assert next(iter(rows.values()))["apart"] == 0.0
