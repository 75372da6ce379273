"""The tables of docs: each names a benchmark and its columns, and is renewed row by row."""

import re

import pytest

import gsut
from lab.bench import figures
from lab.bench.figures import (
    ORIGIN,
    Table,
    describe_command,
    find_tables,
    measure_table,
    read_rows,
    renew_table,
)

# Three ways, four lenses, two numbers of Gaussians; six sets of photographs, with points and
# without, two seeds; else 8.
OLD = """| scene | drawn | a frame [kB] | Origin |
|---|---|---|---|
| one | whole | 5 | a |
| two | half | 7 | b |

`./run bench view`; a: commit 1a2b3c4d, 2026-11-22, 2 cores of X; b: commit 5e6f7a8b, 2026-11-23, Y.
"""


def label(table):
    return f"{table.page.name}-{table.begin}"


@pytest.mark.parametrize("table", list(find_tables()), ids=label)
def test_tables_of_the_pages_show_columns_of_their_benchmark_with_their_origin(table):
    rows = read_rows(table.text)
    assert 1 <= len(rows) <= 8
    for row in rows:
        assert list(row) == [*(column.heading for column in table.columns), ORIGIN]
        assert re.match(r"commit [0-9a-f]{7,}.*, 20\d\d-\d\d-\d\d, .+", row[ORIGIN]), row
    assert f"`{describe_command(table)}`" in table.text


def test_pages_have_marked_tables_only():
    tables = list(find_tables())
    assert {table.page.name for table in tables} >= {"results.md", "performance.md"}
    for page in {table.page for table in tables}:
        text = page.read_text()
        assert text.count("<!-- table:") == text.count("<!-- end -->")


def make_table(text=OLD):
    flags = ["--columns", "scene,drawn,kilobytes", "--frames", "3"]
    return Table(figures.ROOT / "docs" / "results.md", 0, 0, "view", flags, text)


def test_rows_that_are_not_measured_keep_their_figures_and_origin():
    rows = [{"scene": "two", "drawn": "half", "kilobytes": 9.0}, {"scene": "three", "drawn": "all"}]
    text = renew_table(make_table(), rows, "commit 99999999, 2026-11-24, 2 cores of Z")
    found = read_rows(text)
    assert [row["scene"] for row in found] == ["two", "three", "one"]
    assert [row["a frame [kB]"] for row in found] == ["9", "-", "5"]
    assert [row[ORIGIN].split()[1] for row in found] == ["99999999,", "99999999,", "1a2b3c4d,"]
    assert "`./run bench view --frames 3`" in text
    assert read_rows(renew_table(make_table(text), [], "none")) == found


def test_a_table_is_measured_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", f"{figures.ROOT}/tests")
    flags = ["--scenes", "synthetic_1k_64x48", "--frames", "2", "--columns", "scene,drawn"]
    table = make_table()._replace(flags=flags)
    rows = measure_table(table, [])
    assert [row["scene"] for row in rows] == ["synthetic_1k_64x48"] * 3
    with pytest.raises(gsut.InputError, match="ended with 2"):
        measure_table(table._replace(flags=["--scenes", "none"]), [])
