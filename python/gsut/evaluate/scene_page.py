"""Writes the page of a scene: its verdict, a held-out view, the pictures chosen, the time taken."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut.data import STRIP
from gsut.page import build_page, build_table, embed_bytes, format_duration
from gsut.run import RENDERS, REPORT, RunFolder, Verdict


def write_scene_page(
    folder: RunFolder,
    name: str,
    figures: dict[str, Any],
    metrics: dict[str, Any],
    captured: Path,
    poses: str,
    notes: Sequence[str],
) -> None:
    """Writes the page that `gsut scene` ends with.

    Args:
        folder: of the run.
        name: file to write in it.
        figures: the content of scene.json, with "verdict", "seconds" and "renders".
        metrics: of metrics.json; its "views" name the pictures of held-out views.
        captured: folder with the strip of the pictures chosen.
        poses: folder with the report of the poses, relative to the run's.
        notes: what the choice of pictures had to say.
    """
    strip = embed_bytes((captured / STRIP).read_bytes(), "image/jpeg")
    rows = [(stage, format_duration(seconds)) for stage, seconds in figures["seconds"].items()]
    parts = [
        f"<p><b>{Verdict.from_dict(figures['verdict'])}</b></p>",
        f'<p><a href="{REPORT}">Report of the training</a>: held-out views beside photographs. '
        f'<a href="{poses}/report.html">Report of the poses</a>: where the camera went, and its '
        "lens.</p>",
        *_list_result_parts(folder, figures, metrics),
        "<h2>Pictures</h2>",
        f'<img src="{strip}" alt="the pictures chosen" style="width: 100%">',
        "<h2>Time taken</h2>",
        build_table(rows),
    ]
    folder.write_text(name, build_page(folder.path.name, notes, parts))


def _list_result_parts(
    folder: RunFolder, figures: dict[str, Any], metrics: dict[str, Any]
) -> list[str]:
    """Returns the parts that show the held-out view of median quality beside its photograph."""
    views = [row for row in metrics.get("views", []) if row.get("render") and row.get("truth")]
    views = [row for row in views if row.get("psnr") is not None]
    words = figures["renders"]
    if not views or not words:
        return []
    said = "" if words == figures["verdict"]["what"] else f"{words[:1].upper()}{words[1:]}. "
    middle = sorted(views, key=lambda row: row["psnr"])[len(views) // 2]
    pictures = "".join(
        f'<figure style="flex: 1; margin: 0"><img src="{RENDERS}/{middle[key]}" alt="{name}" '
        f'style="width: 100%"><figcaption>{name}</figcaption></figure>'
        for key, name in (("truth", "photograph"), ("render", "the scene from the same place"))
    )
    return [
        "<h2>Scene</h2>",
        f'<div style="display: flex; gap: 1em">{pictures}</div>',
        f"<p>A photograph that the training did not use, of median quality. {said}Look around: "
        f"<code>gsut view {html.escape(str(folder.path))}</code></p>",
    ]
