"""Builds self-contained HTML pages: one frame, numbers, tables and embedded pictures."""

from __future__ import annotations

import base64
import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from gsut.files import format_json, read_package_file

_JPEG_QUALITY = 88  # of embedded pictures: artefacts stay below what renders lack
_SECTIONS = """{% extends "page.html.j2" %}{% block content %}<h1>{{ title }}</h1>
{%- for note in notes %}<p class="note">{{ note }}</p>{% endfor %}
{%- for part in parts %}
{{ part }}
{%- endfor %}{% endblock %}"""
_TABLE = """{% macro line(cells, tag) %}<tr>{% for cell in cells %}<{{ tag }}
{%- if loop.index0 in texts %} class="t"{% endif %}>{{ cell }}</{{ tag }}>{% endfor %}</tr>
{%- endmacro -%}
<div class="scroll"><table class="numbers">
{%- if heading %}{{ line(heading, "th") }}{% endif %}
{%- for row in rows %}{{ line(row, "th" if loop.index0 == bold else "td") }}{% endfor -%}
</table></div>"""


def render_template(source: str, **values: Any) -> str:
    """Renders a Jinja template: a page that extends "page.html.j2" or a part of one.

    Text is escaped, except what this function returned: everything that a page shows goes through
    here. The filters `number` and `duration` are `format_number` and `format_duration`, the
    function `table` is `build_table`; "viewer.html.j2" holds macros to compare and enlarge
    pictures. The blocks of "page.html.j2" are style, content and after.
    """
    environment = _make_environment()
    return mark_safe(environment.from_string(source).render(**values))


def mark_safe(html: str) -> str:
    """Marks HTML that escaped its text itself, so that templates leave it as it is."""
    return _make_environment().call_filter("safe", html)


@functools.cache
def _make_environment() -> Any:
    import jinja2

    names = ("page.html.j2", "viewer.html.j2")
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        loader=jinja2.DictLoader(
            {name: read_package_file("gsut.page", name).decode() for name in names}
        ),
    )
    environment.filters["tojson"] = lambda value: mark_safe(embed_json(value))
    environment.filters.update(number=format_number, duration=format_duration)
    environment.globals.update(table=build_table)
    return environment


def build_page(title: str, notes: Sequence[str], parts: Sequence[str]) -> str:
    """Builds a page from a title, notes, and parts by `render_template`, tables and plots.

    A part that is any other string is shown as text.
    """
    return str(render_template(_SECTIONS, title=title, notes=notes, parts=parts))


def build_table(
    rows: Iterable[Sequence[object]],
    heading: Sequence[str] = (),
    texts: Sequence[int] = (0,),
    bold: int | None = None,
) -> str:
    """Builds a table of figures that scrolls sideways on narrow screens.

    Args:
        rows: cells. heading: of the columns; empty: none.
        texts: columns that are text and therefore aligned to the left; the others are numbers.
        bold: index of a row to emphasize.
    """
    return render_template(_TABLE, rows=map(tuple, rows), heading=heading, texts=texts, bold=bold)


def format_number(value: float | None, digits: int = 2) -> str:
    """Formats a number with `digits` decimals and thin spaces for thousands; None is a dash."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:,.{digits}f}".replace(",", "\u2009")


def format_duration(seconds: float | None) -> str:
    """Formats seconds as 12.3 s, 4 min 05 s or 1 h 02 min; None is a dash."""
    if seconds is None:
        return "–"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def embed_json(value: Any) -> str:
    """Returns JSON for a script element, of which no text in it can end or change anything."""
    return format_json(value).replace("<", "\\u003c")


def embed_bytes(data: bytes, kind: str) -> str:
    """Returns the data address of a file of the media type `kind`, such as "image/png"."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def embed_picture(image: np.ndarray, most_wide: int) -> str:
    """Returns an RGB or grey uint8 picture as the data address of a JPEG.

    Pictures wider than `most_wide` pixels are shrunk to that.
    """
    import cv2

    height, width = image.shape[:2]
    pixels: np.ndarray = np.ascontiguousarray(image)
    if image.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    if width > most_wide:
        size = (most_wide, max(1, round(height * most_wide / width)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return embed_bytes(data.tobytes(), "image/jpeg")


def paint_values(values: np.ndarray, colormap: int, valid: np.ndarray | None = None) -> np.ndarray:
    """Paints values in [0, 1] by a colour map of OpenCV.

    Args:
        values: (H, W). colormap: such as cv2.COLORMAP_TURBO.
        valid: (H, W) bool, others become black; None: all.

    Returns:
        (H, W, 3) RGB uint8.
    """
    import cv2

    levels = np.rint(np.clip(values, 0.0, 1.0) * 255).astype(np.uint8)
    colors = cv2.cvtColor(cv2.applyColorMap(levels, colormap), cv2.COLOR_BGR2RGB)
    return colors if valid is None else np.where(valid[..., None], colors, np.uint8(0))
