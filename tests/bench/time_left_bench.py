"""`./run bench time_left`: how well the time left that commands show is right.

The command runs here, on one thread, so that its processor time is its clock: a busy machine does
not change it.
"""

from __future__ import annotations

import argparse
import importlib
import json
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest import mock

from gsut._core import InputError
from gsut.cli import main
from gsut.files import write_file
from gsut.training import TrainingTime
from tests.bench.harness import Column, format_table
from tests.bench.time_left import RecordedLog, WatchedProgress, right_percent

HELP = "time left that poses, train and scene show: share of the way that it is right within 1.5"
COLUMNS = (
    Column("command"),
    Column("input"),
    Column("seconds", "time", "CPU-s", ".1f"),
    Column("right", unit="%", form=".0f"),
    Column("right_of_all", "of all the time", "%", ".0f"),
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("command", choices=("poses", "scene", "train"), help="to watch")
    parser.add_argument("inputs", metavar="INPUT", nargs="+", help="of one run each")
    parser.add_argument(
        "--words", default="", help="more words for the command, such as '--preset fast'"
    )
    parser.add_argument("--json", metavar="FILE", help="write rows and what was shown here")
    parser.add_argument(
        "--record", metavar="FILE", help="write here what the poses told, for tests to tell again"
    )


def run(arguments: argparse.Namespace) -> int:
    rows, records = [], []
    for given in arguments.inputs:
        with tempfile.TemporaryDirectory(prefix="gsut-time-left-") as folder:
            words = [arguments.command, given, "-o", str(Path(folder) / "out"), "--threads", "1"]
            row, logs = measure([*words, *arguments.words.split()])
        rows.append(row)
        lens = "known" if logs and logs[0].work["known"] else "unknown"
        records += [log.record(f"{Path(given).name}, lens {lens}") for log in logs]
    print(format_table(rows, COLUMNS))
    if arguments.record:
        write_file(Path(arguments.record), records_text(records))
    if arguments.json:
        write_file(Path(arguments.json), json.dumps(rows) + "\n")
    return 0


def records_text(records: list[dict[str, Any]]) -> str:
    """JSON, a record a line."""
    return "[\n" + ",\n".join(json.dumps(record) for record in records) + "\n]\n"


def measure(words: list[str]) -> tuple[dict[str, Any], list[RecordedLog]]:
    """The row of one run, and what its poses told.

    Raises:
        InputError: the command fails.
    """
    shown: list[tuple[float, float]] = [(time.process_time(), 0.0)]

    logs: list[RecordedLog] = []

    class Log(RecordedLog):
        def __init__(self, *told: Any) -> None:
            super().__init__(*told)
            logs.append(self)

    class Bars(WatchedProgress):
        def __init__(self, *values: Any, **_: Any) -> None:
            super().__init__(*values)
            shown[:] = [(time.process_time(), 0.0)]

        def show(self, share: float, text: str = "", left: float | None = None) -> None:
            super().show(share, text, left)
            shown.append(self.shown[-1])

    class Training(TrainingTime):
        def __init__(self, *values: Any, **more: Any) -> None:
            super().__init__(*values, **more, clock=time.process_time)

        def left(self, step: int) -> float:
            found = super().left(step)
            if words[0] == "train":
                shown.append((time.process_time(), found))
            return found

    with (
        mock.patch.object(importlib.import_module("gsut.scene"), "StagedProgress", Bars),
        mock.patch("gsut.cli.poses.StagedProgress", Bars),
        mock.patch("gsut.sfm.pipeline.PosesLog", Log),
        mock.patch("gsut.training.record.training_record.TrainingTime", Training),
    ):
        if main([*words, "--quiet"]):
            raise InputError(f"gsut {' '.join(words)} fails")
    shown.append((time.process_time(), 0.0))
    row = {
        "command": words[0],
        "input": Path(words[1]).name,
        "seconds": shown[-1][0] - shown[0][0],
        "right": right_percent(shown),
        "right_of_all": right_percent(shown, 0.0),
        "shown": shown,
    }
    return row, logs
