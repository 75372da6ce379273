"""Shows the worst captures of a run as pictures, beside what was said and what is true."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gsut.capture.photographs import find_photograph_files
from gsut.data.images import decode_image
from gsut.page import build_table, embed_picture, format_number, render_template
from lab.proving.misfires import find_misfires
from lab.proving.writing import GIVEN, TRUTH, find_cache

_MOST = 10  # captures
_PICTURES = 4  # of each, side by side
_TALL, _WIDE = 84, 480  # pixels of that strip, at most
# Kinds of misfires, the worst first; then the others, then none, each by AUC.
_ORDER = (
    ("said good, is poor", "scene said good, is poor"),
    ("traceback",),
    ("doctor refuses exact data",),
    ("said poor, is good", "scene said poor, is good"),
)
_TEMPLATE = """<h2>The worst {{ captures|length }} captures</h2>
<p class="muted">Said good but poor, tracebacks, exact data refused, said poor but good, then other
misfires by AUC@5, and captures without poses.</p>
<div class="pictures">{% for each in captures %}<figure>
<h3>{{ each.title }}</h3>
{%- if each.strip %}<img src="{{ each.strip }}" alt="pictures of capture {{ each.seed }}">
{%- else %}<p class="muted">its pictures are not in the cache</p>{% endif %}
{{ each.table }}
</figure>{% endfor %}</div>"""
Row = dict[str, Any]


def build_worst(rows: Sequence[Row]) -> list[str]:
    """Builds the part of a page that shows the worst captures; nothing if none went wrong."""
    captures = [
        {"seed": row["seed"], "title": _name(row), "strip": _join_pictures(row),
         "table": build_table(_describe(row), texts=(0, 1))}
        for row in list_worst(rows)
    ]  # fmt: skip
    return [render_template(_TEMPLATE, captures=captures)] if captures else []


def list_worst(rows: Sequence[Row]) -> list[Row]:
    """Lists the worst captures with a misfire or without poses, the worst first."""

    def rank(row: Row) -> tuple[int, float]:
        kinds = {misfire.kind for misfire in find_misfires(row)}
        others = len(_ORDER) + (not kinds)
        return next((k for k, own in enumerate(_ORDER) if kinds & set(own)), others), area(row)

    def area(row: Row) -> float:
        return row.get("auc_5", 0.0 if "poses_status" in row else 1.0)

    wrong = [row for row in rows if any(True for _ in find_misfires(row)) or area(row) == 0]
    return sorted(wrong, key=rank)[:_MOST]


def _name(row: Row) -> str:
    facts = (row.get(key) for key in ("family", "kind", "motion"))
    return ", ".join([str(row["seed"]), *(str(fact) for fact in facts if fact)])


def _describe(row: Row) -> list[tuple[str, str]]:
    """Describes what was said of a capture, and what is true."""
    said = [(misfire.kind, misfire.text) for misfire in find_misfires(row)]
    if row.get("poses_refused"):
        said.append(("poses refused", row["poses_refused"]))
    if "lens" in row:
        said.append((
            "true",
            f"{row['frames']} pictures, lens {row['lens']} of {row['field_degrees']:.0f} degrees, "
            f"told: {row['told']}{' (wrong)' * bool(row['told_wrong'])}, readout "
            f"{row['readout_px']:.1f} px, mistake planted: {row['mistake'] or 'none'}",
        ))  # fmt: skip
    if "auc_5" in row and row["verdict"] == row["true_class"]:
        area = format_number(100 * row["auc_5"], 0)
        said.append(("poses", f"AUC@5 {area} %, {row['verdict']} as was said"))
    return said


def _join_pictures(row: Row) -> str | None:
    """Joins pictures of a capture side by side, as the data address of a JPEG."""
    home = GIVEN if row.get("kind") == "photographs" else TRUTH
    folder = find_cache() / f"{row['seed']:07d}" / home
    if not folder.is_dir():
        return None
    paths = list(find_photograph_files([folder]).values())
    chosen = np.unique(np.linspace(0, len(paths) - 1, _PICTURES).round()).astype(int)
    return embed_picture(np.hstack([_shrink(paths[number]) for number in chosen]), _WIDE)


def _shrink(path: Path) -> np.ndarray:
    image = decode_image(path)[0]
    size = round(image.shape[1] * _TALL / image.shape[0]), _TALL
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
