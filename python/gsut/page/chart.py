"""Draws charts of lines, bars and points as SVG text."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence

import numpy as np

from gsut.page.page import embed_bytes

_WIDTH = 520  # of the chart, in its pixels
LEFT = 58  # edge of the axes' area; leaves room for the values of y
TOP = 34  # edge of the area, below the title
_BELOW = 48  # room below the area, for the values of x and a label
AREA = (452.0, 218.0)  # width and height of the area
_TICKS = 8  # the most on an axis; more would crowd it
_FONT = "Helvetica, Arial, 'DejaVu Sans', sans-serif"
_MARGIN = 0.04  # of the values' range, added above and below it
_FINER = 2  # pixels of a picture of points for one of the chart, each way


class Style:
    """Colours of the page's plots (see page.html.j2), on white in its dark mode, too.

    Attributes:
        INK: of titles and values. MUTED: of labels. GRID: of grid and frame.
        LINE: of the first line. SERIES: of several lines.
    """

    INK = "#1d2733"
    MUTED = "#6b7785"
    GRID = "#e3e8ee"
    LINE = "#1668b8"
    SERIES = (LINE, "#c8442f", "#2a8f5a", "#8a4fb0", "#b07a12", "#3a8fa0")


class Chart:
    """One area with axes.

    Args:
        title: with the unit.
        x_label: below the axis.
        x_limits, y_limits: ends of the axes; they must differ.
        log: the y axis is logarithmic.
        y_text: formats the value of a tick.
        x_ticks: False if `draw_bars` writes labels instead.
        area: width and height of the axes' area.

    Attributes:
        right, bottom: edges of the area, in the chart's pixels. height: of the chart.
    """

    def __init__(
        self,
        title: str,
        x_label: str,
        x_limits: tuple[float, float],
        y_limits: tuple[float, float],
        *,
        log: bool = False,
        y_text: Callable[[float], str] = "{:g}".format,
        x_ticks: bool = True,
        area: tuple[float, float] = AREA,
    ) -> None:
        self._log, self._x_limits, self._y_limits = log, x_limits, y_limits
        self.right, self.bottom = LEFT + round(area[0]), TOP + round(area[1])
        self.height = self.bottom + _BELOW
        self._parts: list[str] = []
        for value in (_list_log_ticks if log else _list_ticks)(*sorted(y_limits)):
            y = float(self._place_y(np.array(value)))
            self._parts.append(f'<path d="M{LEFT} {y:.1f}H{self.right}" stroke="{Style.GRID}"/>')
            self.write(LEFT - 6, y + 4, y_text(value), Style.MUTED, 12, "end")
        self._parts.append(f'<path d="M{LEFT} {self.bottom}H{self.right}" stroke="{Style.GRID}"/>')
        for value in _list_ticks(*x_limits) if x_ticks else ():
            across = float(self._place_x(np.array(value)))
            self.write(across, self.bottom + 17, f"{value:g}", Style.MUTED, 12)
        self.write((LEFT + self.right) / 2, self.height - 10, x_label, Style.MUTED, 13)
        self.write(LEFT, 20, title, Style.INK, 15, "start", bold=True)

    @classmethod
    def make_map(cls, title: str, label: str, x: np.ndarray, y: np.ndarray) -> Chart:
        """Makes a chart that shows points in the same scale along both axes."""
        (left, right), (low, high) = cls.pad_limits(x), cls.pad_limits(y)
        unit = max((right - left) / AREA[0], (high - low) / AREA[1])
        middle, half = (left + right) / 2, 0.5 * unit * AREA[0]
        center, tall = (low + high) / 2, 0.5 * unit * AREA[1]
        return cls(title, label, (middle - half, middle + half), (center - tall, center + tall))

    @staticmethod
    def pad_limits(values: np.ndarray) -> tuple[float, float]:
        """Returns the ends of an axis that shows all values; a single value is centred."""
        low, high = float(np.min(values)), float(np.max(values))
        room = _MARGIN * (high - low) or 0.5 * abs(high) or 1.0
        return low - room, high + room

    def write(
        self, x: float, y: float, words: str, color: str, size: float, anchor: str = "middle",
        bold: bool = False, halo: bool = False,
    ) -> None:  # fmt: skip
        """Writes words at a place of the chart, in its pixels; a halo sets them off."""
        weight = ' font-weight="bold"' if bold else ""
        weight += ' stroke="white" stroke-width="4" paint-order="stroke"' if halo else ""
        self._parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" font-size="{size:g}" '
            f'text-anchor="{anchor}"{weight}>{html.escape(words)}</text>'
        )

    def draw_line(
        self, x: np.ndarray, y: np.ndarray, color: str = Style.LINE, width: float = 2.3,
        dots: bool = False,
    ) -> None:  # fmt: skip
        """Draws a line through points; `dots` marks each of them."""
        places = [
            f"{a:.1f} {b:.1f}" for a, b in zip(self._place_x(x), self._place_y(y), strict=True)
        ]
        if len(places) > 1:
            self._parts.append(
                f'<path d="M{"L".join(places)}" fill="none" stroke="{color}" '
                f'stroke-width="{width:g}" stroke-linejoin="round"/>'
            )
        for place in places if dots or len(places) == 1 else ():
            across, down = place.split()
            self._parts.append(f'<circle cx="{across}" cy="{down}" r="3" fill="{color}"/>')

    def label_point(self, x: float, y: float, words: str) -> None:
        """Writes words below a point of a line, to its left."""
        across, down = float(self._place_x(np.array(x))), float(self._place_y(np.array(y)))
        self.write(across - 2, down + 19, words, Style.INK, 12.5, "end", bold=True)

    def list_names(self, names: Sequence[tuple[str, str]]) -> None:
        """Lists the names of lines, each in its colour, at the top right of the area."""
        for number, (words, color) in enumerate(names):
            self.write(
                self.right - 6, TOP + 16 + 17 * number, words, color, 12.5, "end", bold=True,
                halo=True,
            )  # fmt: skip

    def mark_x(self, x: float, words: str, color: str = Style.GRID) -> None:
        """Draws a thin vertical line at x behind everything else, with words beside its top."""
        across = float(self._place_x(np.array(x)))
        self._parts.insert(0, f'<path d="M{across:.1f} {TOP}V{self.bottom}" stroke="{color}"/>')
        self.write(across + 4, TOP + 9, words, Style.MUTED, 10, "start")

    def draw_bars(self, labels: Sequence[str], values: Sequence[float]) -> None:
        """Draws bars at x = 0, 1, 2 ... with the value above and the label below each."""
        for place, (label, value) in enumerate(zip(labels, values, strict=True)):
            left, middle, right = self._place_x(place + np.array([-0.31, 0.0, 0.31]))
            top = float(self._place_y(np.array(value)))
            self._parts.append(
                f'<path d="M{left:.1f} {self.bottom}V{top:.1f}H{right:.1f}V{self.bottom}Z" '
                f'fill="{Style.LINE}"/>'
            )
            self.write(middle, top - 6, f"{value:.2f}", Style.INK, 12.5, bold=True)
            self.write(middle, self.bottom + 17, label, Style.MUTED, 12)

    def draw_segments(
        self, x: np.ndarray, y: np.ndarray, color: str = Style.LINE, width: float = 1.2
    ) -> None:
        """Draws segments from (x[:, 0], y[:, 0]) to (x[:, 1], y[:, 1]); dots where they are one."""
        ends = np.stack([self._place_x(x), self._place_y(y)], axis=2).reshape(-1, 4)
        path = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in ends)
        self._parts.append(
            f'<path d="{path}" stroke="{color}" stroke-width="{width:g}" stroke-linecap="round"/>'
        )

    def draw_points(self, x: np.ndarray, y: np.ndarray, colors: np.ndarray, size: int = 2) -> None:
        """Draws many points as one picture, in colours (N, 3) uint8, the last ones on top.

        Each is a square of `size` half pixels of the chart.
        """
        import cv2

        width, height = self.right - LEFT, self.bottom - TOP
        picture = np.zeros((_FINER * height, _FINER * width, 4), np.uint8)
        column = np.floor(_FINER * (self._place_x(x) - LEFT)).astype(int)
        row = np.floor(_FINER * (self._place_y(y) - TOP)).astype(int)
        inside = (column >= 0) & (column < picture.shape[1]) & (row >= 0) & (row < len(picture))
        picture[row[inside], column[inside], :3] = colors[inside, ::-1]
        picture[row[inside], column[inside], 3] = 255
        thicker = cv2.dilate(picture, np.ones((size, size), np.uint8))
        self.place_picture(thicker, LEFT, TOP, width, height)

    def draw_marks(self, x: np.ndarray, y: np.ndarray, color: str = Style.INK) -> None:
        """Draws rings at points that lie within the area."""
        for across, down in zip(self._place_x(x), self._place_y(y), strict=True):
            if LEFT <= across <= self.right and TOP <= down <= self.bottom:
                self._parts.append(
                    f'<circle cx="{across:.1f}" cy="{down:.1f}" r="3.5" fill="none" '
                    f'stroke="{color}" stroke-width="1.2"/>'
                )

    def build(self) -> str:
        """Returns the chart as the text of an SVG file."""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {self.height}" '
            f'width="{_WIDTH}" height="{self.height}" font-family="{_FONT}">'
            f"{''.join(self._parts)}</svg>"
        )

    def embed(self) -> str:
        """Returns the chart as the data address of an SVG."""
        return embed_bytes(self.build().encode(), "image/svg+xml")

    def place_picture(
        self, picture: np.ndarray, x: float, y: float, width: float, height: float
    ) -> None:
        """Places a BGR or BGRA picture in the chart; its pixels stay sharp squares."""
        import cv2

        address = embed_bytes(cv2.imencode(".png", picture)[1].tobytes(), "image/png")
        self._parts.append(
            f'<image x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" href="{address}" '
            'preserveAspectRatio="none" style="image-rendering: pixelated"/>'
        )

    def _place_x(self, values: np.ndarray) -> np.ndarray:
        low, high = self._x_limits
        return LEFT + (values - low) / (high - low) * (self.right - LEFT)

    def _place_y(self, values: np.ndarray) -> np.ndarray:
        low, high = self._y_limits
        if self._log:
            low, high, values = math.log(low), math.log(high), np.log(values)
        down = self.bottom - (values - low) / (high - low) * (self.bottom - TOP)
        return np.clip(down, 0, self.height)


def _list_ticks(low: float, high: float) -> list[float]:
    """Lists the multiples of 1, 2 or 5 times a power of ten within an axis."""
    least = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(least))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{number * step:.12g}") for number in range(first, last + 1)]


def _list_log_ticks(low: float, high: float) -> list[float]:
    """Lists 1, 2 and 5 times powers of ten within an axis."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [float(f"{factor}e{power}") for power in powers for factor in (1, 2, 5)]
    return [tick for tick in ticks if low <= tick <= high]
