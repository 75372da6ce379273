"""`./run bench complexity`: a row a training, the choice marked, and rows that stay."""

import json

import numpy as np
import pytest

from gsut.run import PRESETS
from rendered_dataset import write_dataset
from tests.bench.__main__ import main


def test_bench_complexity_marks_the_choice_and_resumes(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(PRESETS["balanced"], "max_gaussians", 300)
    data = write_dataset(tmp_path / "data", np.random.default_rng(20260821))
    files = [tmp_path / "rows.json", tmp_path / "plot.svg"]
    words = ["complexity", str(data), "--steps", "20", "--counts", "300,100", "--resume"]
    words += ["--json", str(files[0]), "--plot", str(files[1])]
    assert main(words) == 0
    rows = json.loads(files[0].read_text())
    assert [row["max_gaussians"] for row in rows] == [300, 100]
    (chosen,) = [row for row in rows if row.get("chosen")]
    assert chosen["choice"]["max_gaussians"] == chosen["max_gaussians"]
    assert min(row["below"] for row in rows) == 0.0
    best = max(row["psnr"] for row in rows)
    assert [row["below"] for row in rows] == pytest.approx([best - row["psnr"] for row in rows])
    assert files[1].read_text().startswith("<?xml")
    # Again, with one view less: what was measured stays as it is.
    fewer = len(list((data / "images").iterdir())) // 2
    assert main([*words, "--views", f"0,{fewer}"]) == 0
    more = json.loads(files[0].read_text())
    assert more[:2] == rows
    assert [row["views"] for row in more[2:]] == [fewer, fewer]
    assert main(["complexity", str(data), "--views", "500"]) == 2
    assert "--views 500" in capsys.readouterr().err
