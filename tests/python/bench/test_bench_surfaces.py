"""./run bench surfaces: its rows hold error beside time, and its balls are round."""

import json

from tests.bench import surfaces_bench
from tests.bench.__main__ import main


def test_surfaces_bench_measures_balls_and_fusion(tmp_path, capsys):
    path = tmp_path / "rows.json"
    flags = ["--steps", "0", "--views", "12", "--size", "64", "--across", "20"]
    assert main(["surfaces", *flags, "--json", str(path)]) == 0
    rows = json.loads(path.read_text())
    assert len(rows) == len(surfaces_bench.lenses()) + 1
    assert all(0 < row["voxels_off"] < 0.3 for row in rows[:-1])
    assert all(row["blocks"] > 0 and row["cpu_seconds"] >= 0 for row in rows)
    assert "farthest vertex" in capsys.readouterr().out
