"""Plots in the style of the page, as SVG or PNG."""

from __future__ import annotations

import io
from typing import Any

from gsut.page.page import bytes_address

# Colours of the page (see page.html.j2); plots stand on white in its dark mode, too.
INK, MUTED, GRID, LINE = "#1d2733", "#6b7785", "#e3e8ee", "#1668b8"
SERIES = (LINE, "#c8442f", "#2a8f5a", "#8a4fb0", "#b07a12", "#3a8fa0")  # in turn
_PNG_DPI = 110
TITLE: dict[str, Any] = {"loc": "left", "color": INK, "fontsize": 11, "fontweight": "bold"}


def plot_figure(title: str, width: float, height: float, columns: int = 1) -> tuple[Any, Any]:
    """A figure of so many inches, and its axes (a list if there are several columns).

    Args:
        title: above the first axes; may be empty.
        width, height: inches.
        columns: axes side by side.
    """
    from matplotlib.figure import Figure  # without pyplot: no state, no display

    figure = Figure(figsize=(width, height), layout="constrained")
    every = list(figure.subplots(1, columns, squeeze=False)[0])
    for axes in every:
        axes.tick_params(colors=MUTED, labelsize=9, length=0, which="both")
        axes.grid(axis="both", color=GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        for spine in axes.spines.values():
            spine.set_color(GRID)
    if title:
        every[0].set_title(title, **TITLE)
    return figure, every if columns > 1 else every[0]


def svg_text(figure: Any) -> str:
    """The figure as an SVG element; the same text for the same figure."""
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "gsut"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def png_address(figure: Any) -> str:
    """A PNG as a data address, for plots of many points."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_PNG_DPI)
    return bytes_address(buffer.getvalue(), "image/png")
