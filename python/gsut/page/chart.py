"""Charts of lines or bars as SVG text: matplotlib takes a second to import and draw some."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut.page.page import bytes_address
from gsut.page.plots import GRID, INK, LINE, MUTED

_WIDTH, _HEIGHT = 500, 288  # pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 490, 32, 240  # of the axes
_TICKS = 5  # about
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)  # between ticks, times a power of ten
_LOG_TICKS = (1, 2, 5)
_BAR = 0.62  # of the width that a bar has


class Chart:
    """A chart to which lines, bars and words are added.

    Args:
        title: above it.
        x_label: below it.
        x, y: the ends of the axes, in the data's units.
        log: the y axis is logarithmic; its ends are above 0.
        number: text of a value at a tick of the y axis.
    """

    def __init__(
        self,
        title: str,
        x_label: str,
        x: tuple[float, float],
        y: tuple[float, float],
        *,
        log: bool = False,
        number: Callable[[float], str] = "{:g}".format,
    ) -> None:
        self._x, self._y, self._log = _apart(x), y if log else _apart(y), log
        self._parts = [_text(_LEFT, 20, title, INK, 'font-size="15" font-weight="bold"')]
        middle = (_LEFT + _RIGHT) / 2
        self._parts.append(
            _text(middle, _HEIGHT - 12, x_label, MUTED, 'font-size="13" text-anchor="middle"')
        )
        for value in log_ticks(*y) if log else ticks(*self._y):
            at = self._down(np.array([value]))[0]
            self._parts.append(_straight(_LEFT, at, _RIGHT, at, GRID))
            self._parts.append(_text(_LEFT - 6, at + 4, number(value), MUTED, 'text-anchor="end"'))
        self._parts.append(_straight(_LEFT, _BOTTOM, _RIGHT, _BOTTOM, GRID))

    def _right(self, x: np.ndarray) -> np.ndarray:
        low, high = self._x
        return _LEFT + (x - low) / (high - low) * (_RIGHT - _LEFT)

    def _down(self, y: np.ndarray) -> np.ndarray:
        low, high = self._y
        if self._log:
            y, low, high = np.log(np.clip(y, low, high)), math.log(low), math.log(high)
        return _BOTTOM - (np.clip(y, low, high) - low) / (high - low) * (_BOTTOM - _TOP)

    def ticks_along(self) -> Chart:
        """Numbers below the x axis."""
        for value in ticks(*self._x):
            at = self._right(np.array([value]))[0]
            self._parts.append(_text(at, _BOTTOM + 17, f"{value:g}", MUTED, 'text-anchor="middle"'))
        return self

    def line(
        self,
        x: np.ndarray,
        y: np.ndarray,
        color: str = LINE,
        width: float = 2.0,
        dots: bool = False,
    ) -> None:
        """A line through points, the points shown or not."""
        points = list(zip(self._right(x), self._down(y), strict=True))
        path = " ".join(f"{right:.1f},{down:.1f}" for right, down in points)
        self._parts.append(
            f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="{width:g}" '
            'stroke-linejoin="round"/>'
        )
        if dots:
            self._parts += [
                f'<circle cx="{right:.1f}" cy="{down:.1f}" r="3" fill="{color}"/>'
                for right, down in points
            ]

    def bars(self, labels: Sequence[str], values: Sequence[float], places: int) -> None:
        """Bars at 0, 1, 2 ... with their values above and labels below."""
        width = _BAR / (self._x[1] - self._x[0]) * (_RIGHT - _LEFT)
        tops = self._down(np.array(values, float))
        for middle, top, label, value in zip(
            self._right(np.arange(len(values))), tops, labels, values, strict=True
        ):
            self._parts.append(
                f'<rect x="{middle - width / 2:.1f}" y="{top:.1f}" width="{width:.1f}" '
                f'height="{_BOTTOM - top:.1f}" fill="{LINE}"/>'
            )
            bold = 'font-weight="bold" text-anchor="middle"'
            self._parts.append(_text(middle, top - 5, f"{value:.{places}f}", INK, bold))
            self._parts.append(_text(middle, _BOTTOM + 17, label, MUTED, 'text-anchor="middle"'))

    def mark(self, x: float, text: str) -> None:
        """A thin line upwards with words at its top."""
        at = self._right(np.array([x]))[0]
        self._parts.append(_straight(at, _TOP, at, _BOTTOM, GRID))
        self._parts.append(_text(at + 4, _TOP + 9, text, MUTED, 'font-size="11"'))

    def value(self, x: float, y: float, text: str) -> None:
        """A number below a point."""
        right, down = self._right(np.array([x]))[0], self._down(np.array([y]))[0]
        self._parts.append(
            _text(right, down + 24, text, INK, 'font-weight="bold" text-anchor="end"')
        )

    def address(self) -> str:
        """A data address (as an image, so that two charts cannot share element names)."""
        body = "\n".join(self._parts)
        text = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
            f'width="{_WIDTH}" height="{_HEIGHT}" font-family="DejaVu Sans, sans-serif" '
            f'font-size="12">\n{body}\n</svg>\n'
        )
        return bytes_address(text.encode(), "image/svg+xml")


def ticks(low: float, high: float) -> list[float]:
    """Round numbers between two, about five."""
    rough = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(step * power for step in _STEPS if step * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(number * step, 12) for number in range(first, last + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times powers of ten between two numbers above 0."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [float(f"{digit}e{power}") for power in powers for digit in _LOG_TICKS]
    return [value for value in values if low <= value <= high]


def _apart(ends: tuple[float, float]) -> tuple[float, float]:
    low, high = ends
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _text(x: float, y: float, text: str, color: str, style: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" {style}>{html.escape(text)}</text>'


def _straight(x: float, y: float, to_x: float, to_y: float, color: str) -> str:
    return (
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{to_x:.1f}" y2="{to_y:.1f}" stroke="{color}" '
        'stroke-width="1"/>'
    )
