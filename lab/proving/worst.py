"""Shows the worst captures of a run: pictures, places from above, what was said and is true."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gsut.capture.photographs import find_photograph_files
from gsut.data.images import decode_image
from gsut.page import build_table, embed_picture, render_template
from gsut.sfm.solution import similarity_from_points
from lab.proving.misfires import find_misfires
from lab.proving.writing import GIVEN, TRUTH, find_cache

_MOST = 10  # captures
_PICTURES = 2  # of each, side by side
_TALL, _WIDE = 112, 420  # pixels of that strip and the plan beside it
_CAPTION = 20  # pixels above it
_TRUE, _FOUND = (150, 150, 150), (200, 30, 30)  # colours of places
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
        {"seed": row["seed"], "title": _name(row), "strip": strip if strip is None else
         embed_picture(strip, _WIDE), "table": build_table(_describe(row), texts=(0, 1))}
        for row in list_worst(rows) for strip in [_join_pictures(row)]
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
        said.append(("poses", f"AUC@5 {100 * row['auc_5']:.0f} %, {row['verdict']} as was said"))
    return said


def draw_sheet(rows: Sequence[Row]) -> np.ndarray:
    """Draws captures in two columns, uint8 RGB: their places, and pictures.

    Places are seen from above: true ones grey, and from there a red line to the one that was found,
    in the scale, turn and shift that suit most of them.
    """
    count = len(rows) + len(rows) % 2
    tiles = np.full((count, _CAPTION + _TALL, _WIDE, 3), 255, np.uint8)
    for tile, row in zip(tiles, rows, strict=False):
        said = f"said {row['verdict']}, is {row['true_class']}" if "verdict" in row else "refused"
        cv2.putText(tile, f"{_name(row)}: {said}", (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45,
                    (0, 0, 0), 1, cv2.LINE_AA)  # fmt: skip
        strip = _join_pictures(row)
        if strip is not None:
            tile[_CAPTION:, : strip.shape[1]] = strip[:, :_WIDE]
    return np.hstack([np.vstack(tiles[::2]), np.vstack(tiles[1::2])])


def draw_places(centers: Sequence[Sequence[Sequence[float] | None]]) -> np.ndarray:
    """Draws true places (x, y, z), and those found or None, from above, see `draw_sheet`."""
    plan = np.full((_TALL, _TALL, 3), 255, np.uint8)
    true = np.array([pair[0] for pair in centers], np.float64)
    kept = [pair[1] is not None for pair in centers]
    middle, size = (true.max(axis=0) + true.min(axis=0)) / 2, np.ptp(true[:, :2], axis=0).max()

    def place(points: np.ndarray) -> np.ndarray:
        flat = (points - middle)[:, :2] * [1, -1] * 0.7 * _TALL / max(size, 1e-9)
        return np.clip(np.rint(flat + _TALL / 2), -(2**14), 2**14).astype(np.int32)

    cv2.polylines(plan, [place(true)], False, (225, 225, 225), 1, cv2.LINE_AA)
    for point in place(true).tolist():
        cv2.circle(plan, point, 2, _TRUE, -1, cv2.LINE_AA)
    if sum(kept) >= 3:
        moved = _align(np.array([pair[1] for pair in centers if pair[1] is not None]), true[kept])
        for start, end in zip(place(true[kept]).tolist(), place(moved).tolist(), strict=True):
            cv2.line(plan, start, end, _FOUND, 1, cv2.LINE_AA)
            cv2.circle(plan, end, 2, _FOUND, 1, cv2.LINE_AA)
    return plan


def _align(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Moves places (N, 3) to the true ones by the similarity that suits most of them."""
    rows, moved = np.arange(len(found)), found
    for _ in range(10):
        scale, rotation, shift = similarity_from_points(found[rows], true[rows])
        moved = scale * found @ rotation.T + shift
        rows = np.argsort(np.linalg.norm(moved - true, axis=1))[: max(3, 6 * len(found) // 10)]
    return moved


def _join_pictures(row: Row) -> np.ndarray | None:
    """Joins the plan of a capture's places and pictures of it side by side, RGB."""
    home = GIVEN if row.get("kind") == "photographs" else TRUTH
    folder = find_cache() / f"{row['seed']:07d}" / home
    if not folder.is_dir():
        return None
    paths = list(find_photograph_files([folder]).values())
    chosen = np.unique(np.linspace(0, len(paths) - 1, _PICTURES).round()).astype(int)
    parts = [_shrink(paths[number]) for number in chosen]
    return np.hstack([draw_places(row["centers"]), *parts] if "centers" in row else parts)


def _shrink(path: Path) -> np.ndarray:
    image = decode_image(path)[0]
    size = round(image.shape[1] * _TALL / image.shape[0]), _TALL
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
