"""Writes the page of a scene: its verdict, a held-out view, the pictures chosen, the time taken."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut.data import STRIP
from gsut.files import read_bytes
from gsut.page import build_page, embed_bytes, render_template
from gsut.run import RunFile, RunFolder, Verdict

_PARTS = """<p><b>{{ verdict }}</b></p>
<p><a href="{{ report }}">Report of the training</a>: held-out views beside photographs.
<a href="{{ poses | urlencode }}/report.html">Report of the poses</a>: where the camera went, and
its lens.</p>
{%- if scene %}
<h2>Scene</h2>
<div style="display: flex; gap: 1em">
{%- for address, caption in scene.pictures.items() %}<figure style="flex: 1; margin: 0">
<img src="{{ address | urlencode }}" alt="{{ caption }}" style="width: 100%">
<figcaption>{{ caption }}</figcaption></figure>{% endfor %}</div>
<p>A photograph that the training did not use, of median quality. {{ scene.said }}Look around:
<code>gsut view {{ folder }}</code></p>
{%- endif %}
<h2>Pictures</h2>
<img src="{{ strip }}" alt="the pictures chosen" style="width: 100%">
<h2>Time taken</h2>
<div class="scroll"><table class="numbers">
{%- for stage, taken in seconds.items() %}<tr><td class="t">{{ stage }}</td>
<td>{{ taken | duration }}</td></tr>{% endfor %}</table></div>"""


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
    parts = render_template(
        _PARTS,
        verdict=Verdict.from_dict(figures["verdict"]),
        report=RunFile.REPORT,
        poses=poses,
        scene=_choose_view(figures, metrics),
        folder=folder.path,
        strip=embed_bytes(read_bytes(captured / STRIP), "image/jpeg"),
        seconds=figures["seconds"],
    )
    folder.write_text(name, build_page(folder.path.name, notes, [parts]))


def _choose_view(figures: dict[str, Any], metrics: dict[str, Any]) -> dict[str, Any] | None:
    """Chooses the held-out view of median quality: its pictures and a sentence on them."""
    views = [row for row in metrics.get("views", []) if row.get("render") and row.get("truth")]
    views = [row for row in views if row.get("psnr") is not None]
    words = figures["renders"]
    if not views or not words:
        return None
    middle = sorted(views, key=lambda row: row["psnr"])[len(views) // 2]
    captions = {"truth": "photograph", "render": "the scene from the same place"}
    return {
        "pictures": {f"{RunFile.RENDERS}/{middle[key]}": text for key, text in captions.items()},
        "said": "" if words == figures["verdict"]["what"] else f"{words[:1].upper()}{words[1:]}. ",
    }
