"""`gsut bench render` and `gsut bench train`: times beside errors, and beside other versions."""

import json
import sys

import numpy as np
import pytest

import rendered_dataset
from gsut.cli import main as gsut_main
from gsut.cli._bench_train import find_seconds_to
from tests.bench import render_bench


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
    # Interpolated by logarithms, which round.
    assert told["reached"]["this"]["5.0"] == pytest.approx([own["seconds"], own["cpu_seconds"]])
    assert gsut_main([*words[:3], "--run=--steps none"]) == 2
    assert "failed: --steps must be a whole number" in capsys.readouterr().err


def test_seconds_to_a_level_lie_between_those_of_two_runs():
    runs = ((30.0, 4.0), (20.0, 1.0), (20.5, 2.0), (25.0, 9.0))
    rows = [
        {"version": "this", "psnr": psnr, "seconds": s, "cpu_seconds": 2 * s} for psnr, s in runs
    ]
    assert find_seconds_to(25.25, rows, "this") == pytest.approx((2 * 2**0.5, 4 * 2**0.5))
    assert find_seconds_to(20.0, rows, "this") == (1.0, 2.0)
    assert find_seconds_to(30.1, rows, "this") is None
