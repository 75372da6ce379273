"""The benchmarks: rows hold speed with error, files appear whole, wrong words are refused."""

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gsut
import rendered_dataset
import small_datasets
from gsut import _core
from gsut.cli import main as gsut_main
from gsut.cli._bench_train import seconds_to
from tests.bench import measure, render_bench, scale_bench, scenes
from tests.bench.__main__ import main
from tests.bench.knobs import knob_bench, knob_settings
from tests.bench.render_bench import RENDER_COLUMNS
from tests.bench.report_rows import table_text, write_csv
from tests.bench.train_bench import seconds_to_db

# What the rows of ./run bench render hold at least.
ROW_KEYS = (
    "name", "isa", "threads", "num_gaussians", "width", "height", "pairs_per_pixel", "forward_ms",
    "backward_ms", "step_ms", "scalar_forward_ms", "scalar_backward_ms", "forward_speedup",
    "backward_speedup", "image_rms_error", "gradient_relative_error",
)  # fmt: skip


@pytest.fixture(autouse=True)
def _same_machine_after():
    threads, isa = _core.num_threads(), _core.active_isa()
    yield
    assert (_core.num_threads(), _core.active_isa()) == (threads, isa)


# Rows.


def small_options(**changes):
    given = {
        "scenes": ["synthetic_2k_64x48"], "isa": _core.available_isas()[:1], "threads": (1, 2),
        "repeats": 6, "scalar_repeats": 1, "steps": 2, "tiles": 6,
    }  # fmt: skip
    return render_bench.RenderBenchOptions(**given | changes)


def test_render_bench_rows_hold_times_with_errors():
    words = []
    options = small_options()
    rows = render_bench.render_bench(options, words.append)
    assert [row["threads"] for row in rows] == [1, 2]
    assert len(words) == render_bench.num_measurements(options)
    for row in rows:
        assert [key for key in ROW_KEYS if row.get(key) is None] == []
        assert row["valid"]
        assert row["image_rms_error"] <= render_bench.IMAGE_RMS_BOUND
        assert row["forward_speedup"] == pytest.approx(row["scalar_forward_ms"] / row["forward_ms"])
        assert 0 < row["blend_ms"] < row["forward_ms"]
        assert row["step_ms"] > row["blend_ms"]
        assert set(row["stages"]) == {*measure.FORWARD_STAGES, *measure.BACKWARD_STAGES}
    assert rows[0]["image_rms_error"] == rows[1]["image_rms_error"]  # the same bits


def test_render_bench_of_a_wrong_result_prints_no_time(monkeypatch):
    monkeypatch.setattr(render_bench, "GRADIENT_RELATIVE_BOUND", 1e-12)
    (row,) = render_bench.render_bench(small_options(threads=(1,), scalar_repeats=0, steps=0))
    assert not row["valid"]
    assert row["gradient_relative_error"] > 1e-12
    times = [key for key, value in row.items() if key.endswith("_ms") and value is not None]
    assert times == []
    assert row["stages"] is None
    assert " - " in table_text([row], RENDER_COLUMNS)


def test_render_bench_with_an_unknown_instruction_set_lists_those_there():
    with pytest.raises(gsut.InputError, match=f'"avx1024" is not available.*{"scalar"}'):
        render_bench.render_bench(small_options(isa=["avx1024"]))


def test_knobs_turned_change_the_error_as_they_must():
    scene = scenes.make_scene("synthetic_2k_64x48")
    rows = knob_bench(scene, repeats=1, tiles=6, with_scalar=True)
    assert len(rows) == len(knob_settings()) + len(_core.available_isas()) - 1 + 2
    alpha = {row["value"]: row["rule_rms_error"] for row in rows if row["knob"] == "alpha_min"}
    assert alpha["0.25/255"] < rows[0]["rule_rms_error"] < alpha["4/255"]
    for row in rows:
        assert row["forward_backward_cpu_ms"] >= 0
        assert (row["image_rms_error"] is None) == (
            row["knob"] not in ("default", "isa", "tile bound")
        )


def test_scale_bench_measures_in_another_process():
    options = scale_bench.ScaleOptions(counts=(500,), megapixels=(0.005,), threads=1, steps=1)
    (row,) = scale_bench.scale_bench(options)
    assert row["note"] == ""
    assert (row["threads"], row["num_gaussians"]) == (1, 500)
    assert row["step_ms"] > row["forward_ms"] > 0
    assert row["peak_mb"] > 10
    assert row["tile_pairs"] >= row["contributing_tile_pairs"] > 0


def test_scale_bench_of_too_much_for_the_memory_is_left_out(monkeypatch):
    monkeypatch.setattr(scale_bench, "free_memory", lambda: 10**9)
    options = scale_bench.ScaleOptions(counts=(10**8,), megapixels=(1.0,))
    (row,) = scale_bench.scale_bench(options)
    assert row["step_ms"] is None
    assert row["note"].startswith("left out: may need")


def test_linear_fit_of_linear_times_is_exact():
    rows = [
        {"num_gaussians": n, "width": w, "height": 10, "step_cpu_ms": 2e-4 * n + 3e-3 * w * 10}
        for n in (1000, 50_000)
        for w in (64, 640)
    ]
    assert scale_bench.add_linear_fit(rows) == pytest.approx((2e-4, 3e-3))
    assert len(rows) == 4
    for row in rows:
        assert row["step_over_linear"] == pytest.approx(1.0)


def test_seconds_to_db_interpolates_the_curve():
    curve = [{"seconds": s, "psnr": p} for s, p in ((1.0, 20.5), (2.0, 22.5), (4.0, 22.0))]
    assert seconds_to_db(curve) == {"21": 1.25, "22": 1.75}


# Files.


def test_table_aligns_and_shows_null_as_a_dash():
    rows = [{"a": "x", "b": 1.25}, {"a": "long", "b": None}]
    text = table_text(rows, (("name", "a", ""), ("time", "b", ".1f")))
    assert text.splitlines() == ["name  time", "----  ----", "x      1.2", "long     -"]


def test_csv_flattens_dicts_and_leaves_null_empty(tmp_path):
    path = tmp_path / "rows.csv"
    write_csv(path, [{"a": 1, "b": {"c": 2.5, "d": None}}, {"a": 3, "b": None, "e": "x"}])
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0] == {"a": "1", "b.c": "2.5", "b.d": "", "b": "", "e": ""}
    assert rows[1]["e"] == "x"


# The command line.


def run_bench(capsys, *words):
    status = main(words)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_bench_render_writes_json_csv_and_plot(tmp_path, capsys):
    files = {kind: tmp_path / f"rows.{kind}" for kind in ("json", "csv", "svg")}
    status, out, _ = run_bench(
        capsys, "render", "--scenes", "peer_500_32x32", "--isa", _core.available_isas()[0],
        "--repeats", "1", "--scalar-repeats", "1", "--steps", "1", "--tiles", "2",
        "--json", str(files["json"]), "--csv", str(files["csv"]), "--plot", str(files["svg"]),
    )  # fmt: skip
    assert status == 0
    assert re.search(r"peer_500_32x32 +\S+", out)
    (row,) = json.loads(files["json"].read_text())
    assert [key for key in ROW_KEYS if key not in row] == []
    assert files["csv"].read_text().startswith("name,isa,threads,num_gaussians")
    assert "</svg>" in files["svg"].read_text()


def test_bench_train_writes_curves(tmp_path, capsys):
    data = small_datasets.write_nerfstudio(tmp_path / "data")
    files = {kind: tmp_path / f"rows.{kind}" for kind in ("json", "csv", "svg")}
    status, out, _ = run_bench(
        capsys, "train", str(data), "--preset", "fast", "--steps", "12", "--measurements", "3",
        "--json", str(files["json"]), "--csv", str(files["csv"]), "--plot", str(files["svg"]),
    )  # fmt: skip
    assert status == 0
    (row,) = json.loads(files["json"].read_text())
    assert row["steps"] == 12
    assert [point["step"] for point in row["curve"]][-1] == 12
    assert len(row["curve"]) == 3
    stages = sum(stage["wall_ms"] for stage in row["stages"].values())
    assert stages == pytest.approx(row["step_ms"])
    assert row["seconds"] > row["load_seconds"] > 0
    assert "adam" in out
    assert "</svg>" in files["svg"].read_text()


@pytest.mark.parametrize(
    "words, message",
    [
        (("nothing",), "render.*train"),
        (("render", "--scenes", "nothing"), "synthetic_100k_640x480"),
        (("render", "--threads", "two"), "--threads must be a whole number"),
        (("scale", "--counts", "none"), "number of Gaussians is like"),
        (("render", "--plot", "rows.bmp"), "must end in .svg, .png, .pdf"),
        (("render", "--json", "no_such_folder/rows.json"), "no such folder"),
        (("render", "--repeats", "0"), "--repeats must be >= 1"),
        (("train", "no_such_data", "--preset", "slow"), "fast, balanced, best"),
    ],
)
def test_bench_refuses_in_one_sentence(capsys, words, message):
    status, _, err = run_bench(capsys, *words)
    assert status == 2
    assert err.count("\n") == 1
    assert re.search(message, err)


def test_bench_projection_writes_rows_and_a_plot_a_lens(tmp_path, capsys):
    from tests.bench.projection_bench import BENCH_METHODS, RINGS, SIZES

    files = ["--json", str(tmp_path / "p.json"), "--csv", str(tmp_path / "p.csv")]
    arguments = ["projection", "--lenses", "kannala_brandt", "--samples", "2"]
    assert main([*arguments, "--no-million", *files, "--plots", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "p.json").read_text())
    assert len(rows) == len(BENCH_METHODS) * len(SIZES) * len(RINGS)
    assert (tmp_path / "projection_kannala_brandt.svg").stat().st_size > 10_000
    assert "ns" in capsys.readouterr().out
    for row in rows:
        assert row["ns_per_gaussian"] > 0
        if row["method"] == "silhouette":
            assert row["alpha_missed"] in (None, 0.0)
    small = [r for r in rows if r["size"] == "small" and r["center_error_px"] is not None]
    assert len(small) > 20
    assert max(r["center_error_px"] for r in small if r["method"] == "gauss_hermite") < 1e-3
    for bad in (["--lenses", "nonesuch"], ["--samples", "0"], ["--plots", "/nonesuch"]):
        assert main(["projection", *bad]) != 0


# The two of the product.


def test_gsut_bench_tells_times_with_errors(tmp_path, capsys):
    data = rendered_dataset.write_dataset(tmp_path / "data", np.random.default_rng(3))
    run = ["train", str(data), "-o", str(tmp_path / "run"), "--steps", "20", "--quiet"]
    assert gsut_main(run) == 0
    assert gsut_main(["bench", "render", str(tmp_path / "run"), "--repeats", "1", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["image_rms_error"] <= render_bench.IMAGE_RMS_BOUND
    assert row["gradient_relative_error"] <= render_bench.GRADIENT_RELATIVE_BOUND
    assert row["forward_ms"] > 0 and row["backward_ms"] > 0


# Another version of gsut, as far as the benchmark knows it: figures by the number of steps.
OTHER_GSUT = """
import json, pathlib, sys
run, steps = pathlib.Path(sys.argv[sys.argv.index("-o") + 1]), int(sys.argv[-1])
run.mkdir()
metrics = {"psnr": steps / 2, "ssim": 0.5, "num_gaussians": 7, "steps": steps, "train_seconds": 1}
(run / "metrics.json").write_text(json.dumps(metrics | {"test_views": ["a"]}))
rows = [{"step": 1, "seconds": 0.1}, {"step": 2, "seconds": 0.5, "psnr": 20.0}]
(run / "history.jsonl").write_text("\\n".join(map(json.dumps, rows)))
"""


def test_gsut_bench_train_times_whole_commands_of_several_versions(tmp_path, capsys):
    data = rendered_dataset.write_dataset(tmp_path / "data", np.random.default_rng(3))
    (tmp_path / "other.py").write_text(OTHER_GSUT)
    other = f"{sys.executable} {tmp_path / 'other.py'}"
    words = ["bench", "train", str(data), "--against", other, "--run=--steps 12", "--level", "5"]
    assert gsut_main([*words, "--flags=--threads 1 --steps 12", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    own, older = told["runs"]
    assert own["steps"] == older["steps"] == 12 and own["psnr"] > 5 and older["psnr"] == 6
    assert own["seconds"] > own["train_seconds"] and own["cpu_seconds"] > 0
    assert own["curve"][-1]["cpu_seconds"] > 0
    assert older["curve"] == [{"step": 2, "seconds": 0.5, "psnr": 20.0}]
    assert told["reached"]["this"] == {"5.0": [own["seconds"], own["cpu_seconds"]]}
    assert gsut_main([*words[:3], "--run=--steps none"]) == 2
    assert "failed: --steps must be a whole number" in capsys.readouterr().err


def test_seconds_to_a_level_lie_between_those_of_two_runs():
    runs = ((30.0, 4.0), (20.0, 1.0), (20.5, 2.0), (25.0, 9.0))
    rows = [
        {"version": "this", "psnr": psnr, "seconds": s, "cpu_seconds": 2 * s} for psnr, s in runs
    ]
    assert seconds_to(25.25, rows, "this") == pytest.approx((2 * 2**0.5, 4 * 2**0.5))
    assert seconds_to(20.0, rows, "this") == (1.0, 2.0)
    assert seconds_to(30.1, rows, "this") is None


def test_bench_view_measures_frames_over_the_wire(capsys):
    words = ["view", "--scenes", "synthetic_1k_64x48", "--frames", "3", "--json"]
    assert main(words) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["scale"], row["share"]) for row in rows] == [(1.0, 1.0), (0.5, 1.0), (0.5, 0.5)]
    assert all(row["frames_per_second"] > 0 and row["kilobytes"] > 0 for row in rows)
    assert rows[0]["psnr"] is None  # infinite: the whole frame is the renderer's
    assert rows[1]["psnr"] > 10


def test_run_bench_lists_the_benchmarks():
    run = Path(__file__).resolve().parents[3] / "run"
    if not (run.parent / ".venv/bin/python").exists():
        pytest.skip("./run setup was not run here")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([run, "bench", "--help"], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert "render" in done.stdout
