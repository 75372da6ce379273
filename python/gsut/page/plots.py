"""Plots residuals and maps over the image of a lens."""

from __future__ import annotations

import math

import numpy as np

from gsut.page.chart import AREA, LEFT, TOP, Chart, Style
from gsut.page.page import paint_values

_TALLEST = 520.0  # the most height of an area that shows an image
_SCALE = (130, 9)  # width and height of the colours below a map
_ARROW_SHARE = 0.05  # of the image's width: length of the line of a 99-percentile residual
RING_DEGREES = 5.0  # width of the rings of field angle in which residuals are summarized


class ImageChart(Chart):
    """A chart whose area is an image, y downwards.

    Args:
        title: with the unit.
        size: width and height of the image in pixels.
    """

    def __init__(self, title: str, size: tuple[int, int]) -> None:
        width, height = size
        scale = min(AREA[0] / width, _TALLEST / height)
        area = (scale * width, scale * height)
        super().__init__(title, "", (0.0, width), (height, 0.0), area=area)

    def draw_map(
        self,
        values: np.ndarray,
        colormap: int,
        label: str,
        limits: tuple[float, float] | None = None,
        *,
        log: bool = False,
    ) -> None:
        """Draws values (rows, columns) over the whole area, and the scale of colours below it.

        Args:
            values: NaN stays open.
            colormap: such as cv2.COLORMAP_INFERNO.
            label: of the values, with the unit.
            limits: of the colours; None: up to the 99th percentile.
            log: the colours are logarithmic.
        """
        known = np.isfinite(values)
        if limits is None:
            limits = tuple(np.percentile(values[known], (0, 99))) if known.any() else (0.0, 1.0)
        low, high = float(limits[0]), max(float(limits[1]), float(limits[0]) + 1e-12)
        level = np.clip(np.where(known, values, low), low, high)
        level = np.log(level / low) / math.log(high / low) if log else (level - low) / (high - low)
        painted = paint_values(level, colormap)[..., ::-1]
        picture = np.dstack([painted, np.where(known, 255, 0).astype(np.uint8)])
        self.place_picture(picture, LEFT, TOP, self.right - LEFT, self.bottom - TOP)
        self.draw_scale(colormap, label, (low, high))

    def draw_scale(self, colormap: int, label: str, limits: tuple[float, float]) -> None:
        """Draws the scale of the colours of a map or of points below the area."""
        width, height = _SCALE
        row = paint_values(np.linspace(0.0, 1.0, 256)[None], colormap)[..., ::-1]
        left, base = LEFT + 44, self.height - 10
        self.place_picture(row, left, base - height, width, height)
        self.write(left - 6, base, f"{limits[0]:.3g}", Style.MUTED, 12, "end")
        self.write(
            left + width + 6, base, f"{limits[1]:.3g}   {label}", Style.MUTED, 12, "start"
        )  # fmt: skip

    def draw_border(self, above: np.ndarray, known: np.ndarray, color: str) -> None:
        """Draws the border between the cells of a map (rows, columns) that are `above` and those
        that are not, where both are known."""
        rows, columns = above.shape
        wide, tall = (self.right - LEFT) / columns, (self.bottom - TOP) / rows
        level = np.where(known, above, np.nan)
        below, beside = (np.argwhere(np.abs(np.diff(level, axis=axis)) == 1.0) for axis in (0, 1))
        path = [
            *(f"M{LEFT + wide * x:.1f} {TOP + tall * (y + 1):.1f}h{wide:.1f}" for y, x in below),
            *(f"M{LEFT + wide * (x + 1):.1f} {TOP + tall * y:.1f}v{tall:.1f}" for y, x in beside),
        ]
        self._parts.append(
            f'<path d="{"".join(path)}" stroke="{color}" stroke-width="1.6" '
            'stroke-linecap="square" fill="none"/>'
        )


def plot_residuals(
    title: str, size: tuple[int, int], pixels: np.ndarray, residuals: np.ndarray
) -> ImageChart:
    """Plots residuals (N, 2) as lines that leave their pixels (N, 2), which are dots.

    The factor by which all are enlarged is added to the title.
    """
    length = float(np.percentile(np.linalg.norm(residuals, axis=1), 99))
    factor = _ARROW_SHARE * size[0] / max(length, 1e-12)
    chart = ImageChart(f"{title}, enlarged {factor:.0f} times", size)
    ends = pixels + factor * residuals
    for tips, width in ((ends, 0.7), (pixels, 1.8)):
        x, y = np.stack([pixels, tips], axis=2).swapaxes(0, 1)
        chart.draw_segments(x, y, width=width)
    return chart


def plot_map(
    title: str,
    size: tuple[int, int],
    values: np.ndarray,
    colors: str,
    label: str = "",
    logarithmic: tuple[float, float] | None = None,
) -> ImageChart:
    """Plots values (rows, columns) over an image, with a scale of colours; NaN stays white.

    Args:
        title: of the plot. size: (width, height) pixels of the image. values: on an even grid.
        colors: name of a colour map. label: of the scale.
        logarithmic: ends of a logarithmic scale; None: linear, up to the 99th percentile.
    """
    import cv2

    chart = ImageChart(title, size)
    colormap = getattr(cv2, f"COLORMAP_{colors.upper()}")
    chart.draw_map(values, colormap, label, logarithmic, log=logarithmic is not None)
    return chart
