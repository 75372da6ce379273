"""Draws plots in the style of the page, as SVG."""

from __future__ import annotations

import io
from typing import Any, ClassVar

import numpy as np

from gsut.page.page import mark_safe

_ARROW_SHARE = 0.05  # of the image's width: length of the arrow of a 99-percentile residual


class Style:
    """Colours of the page's plots (see page.html.j2), on white in its dark mode, too.

    Attributes:
        INK: of titles and values. MUTED: of labels. GRID: of grid and frame.
        LINE: of the first line. SERIES: of several lines. TITLE: settings of a title.
    """

    INK = "#1d2733"
    MUTED = "#6b7785"
    GRID = "#e3e8ee"
    LINE = "#1668b8"
    SERIES = (LINE, "#c8442f", "#2a8f5a", "#8a4fb0", "#b07a12", "#3a8fa0")
    TITLE: ClassVar[dict[str, Any]] = {
        "loc": "left", "color": INK, "fontsize": 11, "fontweight": "bold",
    }  # fmt: skip


def make_figure(title: str, width: float, height: float, columns: int = 1) -> tuple[Any, Any]:
    """Makes a figure in the style of the page, and its axes (a list if there are several columns).

    Args:
        title: above the first axes; may be empty.
        width, height: inches.
        columns: axes side by side.
    """
    from matplotlib.figure import Figure  # without pyplot: no state, no display

    figure = Figure(figsize=(width, height), layout="constrained")
    every = list(figure.subplots(1, columns, squeeze=False)[0])
    for axes in every:
        axes.tick_params(colors=Style.MUTED, labelsize=9, length=0, which="both")
        axes.grid(axis="both", color=Style.GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        for spine in axes.spines.values():
            spine.set_color(Style.GRID)
    if title:
        every[0].set_title(title, **Style.TITLE)
    return figure, every if columns > 1 else every[0]


def make_image_figure(title: str, size: tuple[int, int]) -> tuple[Any, Any]:
    """Makes a figure whose axes are an image of `size` (width, height) pixels, y downwards."""
    figure, axes = make_figure(title, 6.0, 6.0 * size[1] / size[0] + 0.5)
    axes.set(xlim=(0, size[0]), ylim=(size[1], 0), aspect="equal")
    axes.grid(False)
    return figure, axes


def plot_residuals(
    title: str, size: tuple[int, int], pixels: np.ndarray, residuals: np.ndarray
) -> tuple[Any, Any]:
    """Plots residuals (N, 2) as arrows at their pixels (N, 2), enlarged alike.

    The factor is added to the title. Arrows are rasterized within an SVG.
    """
    length = float(np.percentile(np.linalg.norm(residuals, axis=1), 99))
    factor = _ARROW_SHARE * size[0] / max(length, 1e-12)
    figure, axes = make_image_figure(f"{title}, enlarged {factor:.0f} times", size)
    axes.quiver(
        *pixels.T, *(residuals * factor).T, angles="xy", scale_units="xy", scale=1, width=0.0016,
        color=Style.LINE, rasterized=True,
    )  # fmt: skip
    return figure, axes


def plot_map(
    title: str,
    size: tuple[int, int],
    values: np.ndarray,
    colors: str,
    label: str = "",
    logarithmic: tuple[float, float] | None = None,
) -> tuple[Any, Any]:
    """Plots values (rows, columns) over an image, with a colour bar; NaN stays white.

    Args:
        title: of the plot. size: (width, height) pixels of the image. values: on an even grid.
        colors: name of a colour map. label: of the colour bar.
        logarithmic: ends of a logarithmic scale; None: linear, up to the 99th percentile.
    """
    from matplotlib.colors import LogNorm, Normalize

    figure, axes = make_image_figure(title, size)
    if np.isfinite(values).any():
        if logarithmic is not None:
            norm: Normalize = LogNorm(*logarithmic)
            values = np.clip(values, *logarithmic)
        else:
            low, high = np.nanpercentile(values, (0, 99))
            norm = Normalize(low, max(high, low + 1e-12))
        shown = axes.imshow(
            np.ma.masked_invalid(values), cmap=colors, norm=norm,
            extent=(0, size[0], size[1], 0), interpolation="nearest",
        )  # fmt: skip
        figure.colorbar(shown, ax=axes, shrink=0.75, label=label)
    return figure, axes


def render_svg(figure: Any) -> str:
    """Renders a figure as an SVG element; equal figures give equal text."""
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "gsut"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    return mark_safe(text[text.index("<svg") :])
