"""Shows the rows of a run as one page: rates, tables of confusion, misfires by factor."""

from __future__ import annotations

import collections
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut.files import write_file
from gsut.page import build_page, build_table, format_number
from lab.proving.causes import CAUSES, find_wrong_cause
from lab.proving.misfires import find_misfires
from lab.proving.worst import build_worst

_LEVELS = ("good", "usable", "poor")
_FACTORS = ("family", "kind", "lens", "motion", "told")
Row = dict[str, Any]


def write_page(rows: Sequence[Row], path: Path, title: str) -> None:
    """Writes the page of a run."""
    write_file(path, build_page(title, [f"{len(rows)} captures"], build_parts(rows)))


def build_parts(rows: Sequence[Row]) -> list[str]:
    """Builds the tables of a page."""
    misfires = [(row, misfire) for row in rows for misfire in find_misfires(row)]
    counts = collections.Counter(misfire.kind for _, misfire in misfires)
    return [
        build_table(sorted(counts.items(), key=lambda item: -item[1]), ("misfire", "captures")),
        build_table(list_figures(rows), ("figure", "value", "captures")),
        _build_confusion(rows, "poses", "true_class", "verdict"),
        _build_confusion(rows, "scene", "scene_class", "scene_verdict"),
        _build_doctor(rows),
        *build_worst(rows),
        *_build_causes(rows),
        *_build_mistakes(rows),
        *(_build_factor(rows, factor) for factor in _FACTORS),
        build_table(
            [(row["seed"], row.get("family", ""), row.get("motion", ""), *misfire)
             for row, misfire in misfires],
            ("seed", "family", "motion", "misfire", ""), texts=(1, 2, 3, 4),
        ),
        build_table([_describe(row) for row in rows],
                    ("seed", "family", "kind", "motion", "lens", "frames", "AUC@1", "AUC@5",
                     "registered", "verdict", "true", "lens px", "PSNR", "CPU-s"),
                    texts=(1, 2, 3, 4, 9, 10)),
    ]  # fmt: skip


def list_figures(rows: Sequence[Row]) -> list[tuple[str, str, int]]:
    """Lists means over the captures that have a figure."""

    def take(name: str, pick: Callable[[Row], Any], digits: int = 2) -> tuple[str, str, int]:
        values = [pick(row) for row in rows]
        known = [float(value) for value in values if value is not None]
        mean = float(np.mean(known)) if known else None
        return name, format_number(mean, digits), len(known)

    def scale(key: str) -> Callable[[Row], Any]:
        # A refused capture has no poses: all its pairs are lost.
        return lambda row: 100 * row[key] if key in row else 0 if "poses_status" in row else None

    def cover(row: Row) -> Any:
        sigma = row.get("focal_sigma_percent")
        return 100.0 * (abs(row["focal_error"]) <= sigma / 100) if sigma else None

    return [
        *(take(f"AUC@{t}, %", scale(f"auc_{t}"), 1) for t in ("0.5", "1", "5", "10")),
        take("registered, %", scale("registered"), 1),
        take("estimated lens, px rms", lambda row: row.get("lens_px") or None),
        take("focal length within its sigma, %", cover, 0),
        take("held-out PSNR, dB", lambda row: row.get("psnr")),
        take("the same against the truth without noise, dB", lambda row: row.get("psnr_clean")),
        *(take(f"{part}, CPU-s", lambda row, part=part: row.get(f"{part}_seconds"), 1)
          for part in ("render", "doctor", "poses", "train", "scene")),
    ]  # fmt: skip


def _build_confusion(rows: Sequence[Row], what: str, is_key: str, said_key: str) -> str:
    counts = collections.Counter((row[is_key], row[said_key]) for row in rows if said_key in row)
    table = [(f"is {true}", *(counts[true, said] for said in _LEVELS)) for true in _LEVELS]
    return build_table(table, (what, *(f"said {said}" for said in _LEVELS)))


def _build_doctor(rows: Sequence[Row]) -> str:
    counts: dict[str, list[int]] = collections.defaultdict(lambda: [0, 0])
    for row in rows:
        if "planted" in row:
            right = row["doctor_named"] if row["planted"] != "none" else not row["doctor_says"]
            counts[row["planted"]][0] += 1
            counts[row["planted"]][1] += bool(right)
    table = [(name, *counts[name]) for name in sorted(counts)]
    return build_table(table, ("planted mistake", "captures", "named, or nothing said of none"))


def _build_mistakes(rows: Sequence[Row]) -> list[str]:
    """Builds the table of planted mistakes, a column a capture."""
    judged = [row for row in rows if row.get("mistakes")]
    names = dict.fromkeys(name for row in judged for name in row["mistakes"])
    table = [(name, *(row["mistakes"].get(name, "") for row in judged)) for name in names]
    columns = [f"{row['seed']}: {row['family']}, {row['motion']}" for row in judged]
    texts = tuple(range(len(judged) + 1))
    return [build_table(table, ("planted mistake", *columns), texts=texts)] if judged else []


def count_causes(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    """Counts what verdicts named of each cause that was planted: cause, said, captures, right."""
    said = collections.Counter(
        (name, row[f"cause_{name}"]) for row in rows for name in CAUSES if f"cause_{name}" in row
    )
    order = {name: number for number, name in enumerate(CAUSES)}
    rows_of_table = sorted(said.items(), key=lambda item: (order[item[0][0]], -item[1]))
    return [
        (name, cause, count, find_wrong_cause({f"cause_{name}": cause}, name) is None)
        for (name, cause), count in rows_of_table
    ]


def _build_causes(rows: Sequence[Row]) -> list[str]:
    table = count_causes(rows)
    heading = ("planted cause", "verdict names", "captures", "right")
    return [build_table(table, heading, texts=(0, 1, 3))] if table else []


def _build_factor(rows: Sequence[Row], factor: str) -> str:
    groups: dict[str, list[Row]] = collections.defaultdict(list)
    for row in rows:
        groups[str(row.get(factor))].append(row)
    table = [
        (name, len(own), sum(any(True for _ in find_misfires(row)) for row in own),
         format_number(100 * float(np.mean([row.get("auc_5", 0.0) for row in own])), 0))
        for name, own in sorted(groups.items())
    ]  # fmt: skip
    return build_table(table, (factor, "captures", "with a misfire", "AUC@5, %"))


def _describe(row: Row) -> tuple[object, ...]:
    def show(key: str, factor: float = 1.0, digits: int = 1) -> str:
        return format_number(None if row.get(key) is None else factor * row[key], digits)

    seconds = sum(
        row.get(f"{part}_seconds") or 0.0 for part in ("doctor", "poses", "train", "scene")
    )
    return (
        row["seed"], row.get("family"), row.get("kind"), row.get("motion"), row.get("lens"),
        row.get("frames"), show("auc_1", 100, 0), show("auc_5", 100, 0), show("registered", 100, 0),
        row.get("verdict", row.get("poses_refused", "")), row.get("true_class", ""),
        show("lens_px", 1, 2), show("psnr"), format_number(seconds, 0),
    )  # fmt: skip
