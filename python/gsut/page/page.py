"""A self-contained HTML page: one template, numbers, tables and embedded pictures."""

from __future__ import annotations

import base64
import html
import importlib.resources
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

_JPEG_QUALITY = 88
_SECTIONS = """{% extends "page.html.j2" %}{% block content %}<h1>{{ title }}</h1>
{%- for note in notes %}<p class="note">{{ note }}</p>{% endfor %}
{%- for part in parts %}
{{ part | safe }}
{%- endfor %}{% endblock %}"""


def render_page(source: str, **values: Any) -> str:
    """The page of a Jinja template that extends "page.html.j2" (its blocks: style, content, after).

    Text is escaped; the filters `number` and `duration` are `number_text` and `duration_text`.
    """
    import jinja2

    base = importlib.resources.files("gsut.page").joinpath("page.html.j2").read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        loader=jinja2.DictLoader({"page.html.j2": base}),
    )
    environment.filters.update(number=number_text, duration=duration_text)
    return environment.from_string(source).render(**values)


def sections_page(title: str, notes: Sequence[str], parts: Sequence[str]) -> str:
    """A page of a title, notes, and parts that are HTML: headings, tables, plots."""
    return render_page(_SECTIONS, title=title, notes=notes, parts=parts)


def html_table(rows: Iterable[Sequence[object]], heading: Sequence[str] = ()) -> str:
    """A table of figures; the first column is text."""
    lines = ["".join(f"<td>{html.escape(str(cell))}" for cell in row) for row in rows]
    if heading:
        lines.insert(0, "".join(f"<th>{html.escape(cell)}" for cell in heading))
    return '<table class="numbers">' + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def number_text(value: float | None, digits: int = 2) -> str:
    """A number with `digits` decimals and thousands apart by thin spaces; a dash for none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:,.{digits}f}".replace(",", "\u2009")


def duration_text(seconds: float | None) -> str:
    """Seconds as 12.3 s, 4 min 05 s or 1 h 02 min; a dash for None."""
    if seconds is None:
        return "–"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def bytes_address(data: bytes, kind: str) -> str:
    """A data address of a file of the kind "image/..."."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def picture_address(image: np.ndarray, most_wide: int) -> str:
    """An RGB or grey uint8 picture as the data address of a JPEG, at most so many pixels wide."""
    import cv2

    height, width = image.shape[:2]
    pixels: np.ndarray = np.ascontiguousarray(image)
    if image.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    if width > most_wide:
        size = (most_wide, max(1, round(height * most_wide / width)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return bytes_address(data.tobytes(), "image/jpeg")
