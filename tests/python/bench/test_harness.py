"""The benchmarks' frame: flags, choice of rows, repeats, versions by turns, tables."""

import json
import os
import re
import subprocess
from pathlib import Path

import pytest

import gsut
from gsut import _core
from tests.bench.__main__ import find_benchmarks, load_benchmark, main
from tests.bench.harness import (
    WRONG,
    Benchmark,
    Column,
    Option,
    Settings,
    choose_columns,
    format_markdown,
    format_table,
    measure_rows,
)

ROOT = Path(__file__).resolve().parents[3]
COLUMNS = (Column("name"), Column("time", "took", "ms", ".1f"), Column("error", form=".0e"))


def make_benchmark(measure, cases=({"name": "one"}, {"name": "two"})):
    return Benchmark(
        "of a test", COLUMNS, lambda settings: cases, measure, (Option("size", 3, "x"),)
    )


@pytest.fixture(autouse=True)
def _same_machine_after():
    threads, isa = _core.num_threads(), _core.active_isa()
    yield
    assert (_core.num_threads(), _core.active_isa()) == (threads, isa)


def test_repeats_give_the_least_time_and_the_last_values(tmp_path):
    times = iter([3.0, 1.0, 2.0])
    benchmark = make_benchmark(lambda case, settings: {"time": next(times), "error": 0.5})
    (row,) = measure_rows(benchmark, benchmark.settings(tmp_path), only="two", repeats=3)
    assert row == {"name": "two", "time": 1.0, "error": 0.5}


def test_wrong_results_have_no_time(tmp_path):
    benchmark = make_benchmark(lambda case, settings: {"time": 1.0, "error": 0.5, WRONG: "far off"})
    rows = measure_rows(benchmark, benchmark.settings(tmp_path))
    assert [(row["time"], row["error"]) for row in rows] == [(None, 0.5)] * 2
    assert format_table(rows, COLUMNS).splitlines()[2].split() == ["one", "-", "5e-01"]


def test_rows_of_missing_data_are_left_out_and_named(tmp_path, capsys):
    cases = ({"name": "a", "data": "absent"}, {"name": "b", "data": "here"})
    benchmark = make_benchmark(lambda case, settings: {"time": 1.0}, cases)
    (tmp_path / "here").mkdir()
    settings = Settings({}, data=tmp_path)
    assert [row["name"] for row in measure_rows(benchmark, settings)] == ["b"]
    assert "left out: absent is not in the folder" in capsys.readouterr().err
    with pytest.raises(gsut.InputError, match="no row's name contains 'c'"):
        measure_rows(benchmark, settings, only="c")


def test_against_measures_each_row_by_turns_in_another_checkout(tmp_path):
    python = tmp_path / ".venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(
        "#!/bin/sh\nfor word; do last=$word; done\n"
        'echo "$@" >> words\necho \'[{"name": "one", "time": 7.0}]\' > "$last"\n'
    )
    python.chmod(0o755)
    benchmark = make_benchmark(lambda case, settings: {"time": 8.0, "error": 0.0})
    rows = measure_rows(
        benchmark, benchmark.settings(tmp_path), only="one", repeats=2, against=tmp_path,
        words=["tests.bench", "this", "--size", "4"],
    )  # fmt: skip
    assert [(row["version"], row["time"]) for row in rows] == [("this", 8.0), (str(tmp_path), 7.0)]
    asked = (tmp_path / "words").read_text().splitlines()
    assert len(asked) == 2
    assert asked[0].startswith("-m tests.bench this --size 4 --only one --json ")
    assert choose_columns(benchmark, "time", rows)[-1].key == "version"


def test_tables_show_nothing_as_a_dash():
    rows = [{"name": "x", "time": 1.25}, {"name": "long|er", "time": None, "error": 1e-7}]
    assert format_table(rows, COLUMNS).splitlines() == [
        "name     took [ms]  error",
        "-------  ---------  -----",
        "x              1.2      -",
        "long|er          -  1e-07",
    ]
    assert format_markdown(rows, COLUMNS).splitlines() == [
        "| name | took [ms] | error |",
        "|---|---|---|",
        "| x | 1.2 | - |",
        "| long\\|er | - | 1e-07 |",
    ]


def test_options_take_the_type_of_their_default():
    assert Option("a", 1, "").parse("2") == 2
    assert Option("a", (0.5,), "").parse("1,2.5") == (1.0, 2.5)
    assert Option("a", (), "").parse("x,y") == ("x", "y")
    with pytest.raises(gsut.InputError, match="--max-steps must be of kind int, found 'two'"):
        Option("max_steps", 1, "").parse("two")


@pytest.mark.parametrize("name", find_benchmarks())
def test_each_benchmark_declares_columns_that_name_its_rows(name, tmp_path, monkeypatch):
    benchmark = load_benchmark(name)
    if benchmark is None:  # it watches a command
        return
    keys = [column.key for column in benchmark.columns]
    assert len(set(keys)) == len({column.heading for column in benchmark.columns}) == len(keys)
    assert {column.unit for column in benchmark.columns} - {""}, "error or quality without a unit"
    monkeypatch.setattr(Settings, "find", lambda self, data: None)
    cases = list(benchmark.cases(benchmark.settings(tmp_path)))
    names = [benchmark.name_row(case) for case in cases]
    shown = {key for case in cases for key in case if not key.startswith("_")}
    assert shown <= set(keys)
    assert cases and all(names)
    assert name == "formats" or len(set(names)) == len(names)


@pytest.mark.parametrize(
    "words, message",
    [
        (("nothing",), "render.*train"),
        (("render", "--scenes", "nothing"), "synthetic_100k_640x480"),
        (("render", "--runs", "two"), "--runs must be of kind int"),
        (("render", "--isa", "avx1024"), '"avx1024" is not available'),
        (("render", "--columns", "speed"), "no 'speed'; there are scene, isa"),
        (("render", "--json", "no_such_folder/rows.json"), "no such folder"),
        (("render", "--repeats", "0"), "--repeats must be at least 1"),
        (("train", "--sets", "absent"), "the data of all rows is missing"),
        (("compact", "--methods", "best"), "known: ghap"),
        (("compact", "--keep", "0"), "keep must be above 0"),
        (("refine", "--disturbances", "huge"), "takes small, large, lens"),
        (("walk", "--films", "slow"), "no film 'slow'"),
    ],
)
def test_wrong_words_are_refused_in_one_sentence(capsys, monkeypatch, words, message):
    monkeypatch.delenv("GSUT_DATA", raising=False)
    status = main(words)
    err = capsys.readouterr().err
    assert status == 2
    assert re.search(message, err.splitlines()[-1])


def test_benchmarks_need_no_package_of_the_tests():
    blocked = ("scipy", "pytest", "skimage", "trimesh", "rosbags", "ray")
    code = f"import sys\nfor name in {blocked}: sys.modules[name] = None\n"
    code += "from tests.bench.__main__ import main\nmain(['--help'])"
    environment = os.environ | {"PYTHONPATH": "tests"}
    command = [str(ROOT / ".venv/bin/python"), "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert done.returncode == 0 and all(name in done.stdout for name in find_benchmarks()), (
        done.stderr
    )


def test_rows_are_printed_as_json(capsys):
    words = ["view", "--scenes", "synthetic_1k_64x48", "--frames", "3", "--json", "-"]
    assert main(words) == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == 3
    assert all(row["frames_per_second"] > 0 and row["kilobytes"] > 0 for row in rows)
    assert rows[0]["psnr"] is None  # infinite: the whole frame is the renderer's
    assert rows[1]["psnr"] > 10
