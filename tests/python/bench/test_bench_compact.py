"""`./run bench compact`: rows, files and refusals on a small scene."""

import json

import numpy as np
import pytest

import gsut
from gsut import InputError, TrainOptions
from rendered_dataset import write_dataset
from tests.bench.__main__ import main
from tests.bench.compact_bench import CompactBenchOptions, compact_bench, num_parts


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    scene = gsut.load_dataset(write_dataset(folder / "data", np.random.default_rng(20260821)))
    options = TrainOptions(steps=60, max_gaussians=200, checkpoint_every=0)
    gsut.train(scene, options, out=folder / "run", progress=False)
    return folder / "run"


def test_bench_compact_has_a_row_a_method_and_the_rival_in_each(run, tmp_path, capsys):
    files = [tmp_path / name for name in ("rows.json", "rows.csv", "plot.svg")]
    words = ["--json", str(files[0]), "--csv", str(files[1]), "--plot", str(files[2])]
    words += ["--keep", "0.5,0.25", "--methods", "ghap,lightgaussian", "--finetune", "5"]
    assert main(["compact", str(run), *words]) == 0
    rows = json.loads(files[0].read_text())
    assert [row["method"] for row in rows] == ["whole", *["ghap", "lightgaussian"] * 2]
    for row in rows[1:]:
        assert row["num_gaussians"] == round(200 * row["keep"]) == row["rival"]["num_gaussians"]
        assert row["total_seconds"] > 0 and row["rival"]["total_seconds"] > 0
        for kind in ("free", "tuned", "rival", "source"):
            assert 5 < row[kind]["psnr"] < 60
            assert row[kind]["render_ms"] > 0
    assert files[1].is_file() and files[2].stat().st_size > 1000
    assert "rival dB" in capsys.readouterr().out


def test_bench_compact_tells_what_begins(run):
    options = CompactBenchOptions([str(run)], ["ghap"], [0.5], finetune=2, rival=False)
    told = []
    rows = compact_bench(options, told.append)
    assert len(told) == num_parts(options) == 2
    assert told[-1].endswith("ghap 0.5")
    assert "rival" not in rows[-1]


def test_bench_compact_refuses_wrong_options():
    with pytest.raises(InputError, match="known: ghap"):
        CompactBenchOptions(["run"], ["best"])
    with pytest.raises(InputError, match="keep must be above 0"):
        CompactBenchOptions(["run"], keep=[0.0])
    with pytest.raises(InputError, match="--finetune must be >= 1"):
        CompactBenchOptions(["run"], finetune=0)


def test_bench_compact_goes_on_where_it_stopped(run, tmp_path):
    options = CompactBenchOptions([str(run)], ["ghap", "field"], [0.5], finetune=2, rival=False)
    written = []
    rows = compact_bench(options, on_row=lambda rows: written.append([dict(row) for row in rows]))
    again = compact_bench(options, on_row=lambda rows: written.append(rows), done=written[1])
    assert [row["method"] for row in again] == ["whole", "ghap", "field"]
    assert again[:2] == rows[:2]  # with their seconds, so they were not made again
    assert again[2]["tuned"]["psnr"] == rows[2]["tuned"]["psnr"]


def test_bench_compact_makes_rows_of_other_settings_again_and_keeps_other_runs_rows(run):
    options = CompactBenchOptions([str(run)], ["ghap", "field"], [0.5], finetune=2, rival=False)
    rows = compact_bench(options)
    other = {**rows[1], "run": "elsewhere"}
    old = {**rows[2], "settings": "old", "tuned": {"psnr": 99.0}}
    again = compact_bench(options, done=[other, rows[0], rows[1], old])
    assert again[:3] == [other, rows[0], rows[1]]
    assert len(again) == 4 and again[3]["tuned"] == {**rows[2]["tuned"], **_ms(again[3])}
    longer = CompactBenchOptions([str(run)], ["ghap"], [0.5], finetune=3, rival=False)
    (made,) = (row for row in compact_bench(longer, done=rows) if row["method"] == "ghap")
    assert made["finetune_steps"] == 3 and made["settings"] != rows[1]["settings"]


def _ms(row):
    return {"render_ms": row["tuned"]["render_ms"]}


def test_bench_compact_trains_its_starts_once(run, tmp_path, capsys):
    data = run.parent / "data"
    words = [str(data), "--start", "mcmc,adc,lean", "--folder", str(tmp_path), "--cap", "150"]
    words += ["--start-steps", "40", "--lean", "60", "--methods", "ghap", "--keep", "0.5"]
    words += ["--finetune", "2", "--no-rival", "--json", str(tmp_path / "rows.json"), "--resume"]
    assert main(["compact", *words]) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())
    assert [(row["start"], row["method"]) for row in rows] == [
        (start, method) for start in ("mcmc", "adc", "lean") for method in ("whole", "ghap")
    ]
    counts = {row["start"]: row["num_gaussians"] for row in rows if row["method"] == "whole"}
    assert (counts["mcmc"], counts["lean"]) == (150, 60)
    trained = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/scene.ply")}
    assert len(trained) == 3
    assert main(["compact", *words]) == 0
    assert trained == {path: path.stat().st_mtime_ns for path in trained}
    assert json.loads((tmp_path / "rows.json").read_text()) == rows
    capsys.readouterr()
    assert main(["compact", *words, "--start-steps", "50"]) != 0
    assert "other options" in capsys.readouterr().err


def test_bench_compact_refuses_starts_without_a_folder():
    with pytest.raises(InputError, match="--start and --folder go together"):
        CompactBenchOptions(["data"], start=["mcmc"])
    with pytest.raises(InputError, match="known: mcmc, adc, lean"):
        CompactBenchOptions(["data"], start=["best"], folder="runs")
