"""The report's plots, as data addresses of SVG."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.page import Chart
from gsut.render import Falloff
from gsut.run import TrainOptions

_FAINT = "#a9c9e8"
_CHANNELS = ("#c0392b", "#27865a", "#2c6fb5")  # of lines for red, green and blue
_MOST_POINTS = 400  # of a curve; more are averaged
_MOST_DOTS = 40  # points of a curve that are shown as such
_ROOM = 0.05  # of the range of values, above and below


def curve_plot(
    history: list[dict[str, Any]], key: str, title: str, axis: str, options: TrainOptions
) -> str:
    """A quantity of history.jsonl over steps or seconds.

    Args:
        history: rows with `step`, `seconds` and some with `key`.
        key: psnr, loss or num_gaussians.
        title: title, with unit.
        axis: "step" or "seconds".
        options: resolved; tell where the resolution changed.

    Returns:
        A data address.
    """
    rows = [row for row in history if row.get(key) is not None and row.get(axis) is not None]
    x = np.array([row[axis] for row in rows], float)
    y = np.array([row[key] for row in rows], float)
    smooth = bool(key == "loss" and len(x) > 2 and (y > 0).all())
    ends = _around(y)
    if smooth:
        low, high = np.percentile(y, (0.5, 99.5))
        ends = float(low) / 1.15, float(high) * 1.15
    count = key == "num_gaussians"
    if count:
        ends = 0.0, ends[1]
    number = _thousands if count else "{:g}".format
    label = "steps" if axis == "step" else "seconds of training"
    chart = Chart(title, label, (0.0, 1.02 * x.max()), ends, log=smooth, number=number)
    chart.ticks_along()
    _mark_resolutions(chart, history, axis, options)
    if smooth:
        chart.line(*_thinned(x, y, _MOST_POINTS), color=_FAINT, width=1.0)
        chart.line(*_thinned(x, y, 60))
    else:
        chart.line(x, y, dots=len(x) <= _MOST_DOTS)
    if key == "psnr":
        chart.value(x[-1], y[-1], f"{y[-1]:.2f}")
    return chart.address()


def ring_plot(rings: list[dict[str, Any]]) -> str:
    """PSNR by ring of field angle as bars, a data address; rings without pixels are left out."""
    rings = [ring for ring in rings if ring["psnr"] is not None]
    values = [ring["psnr"] for ring in rings] or [0.0]
    # Bars from 0 would hide differences of some dB: they start well below the least.
    ends = max(0.0, min(values) - 8.0), max(values) + 2.0
    wide = max(len(values), 3) - 0.4
    chart = Chart("PSNR by field angle [dB]", "angle to the optical axis", (-0.6, wide), ends)
    chart.bars([ring_text(ring) for ring in rings], values[: len(rings)], 2)
    return chart.address()


def light_plots(light: dict[str, Any]) -> list[str]:
    """What metrics.json says of the photographs' light, as data addresses: gains, and falloffs."""
    gains = np.array(list(light["gains"].values()))
    falloffs = [falloff for each in light["falloffs"] if (falloff := Falloff.from_dict(each))]
    plots = []
    if (gains != 1.0).any():
        wide = (0.0, len(gains) - 1.0)
        chart = Chart("Gain of each photograph", "photographs, by name", wide, _around(gains))
        chart.ticks_along()
        for values, color in zip(gains.T, _CHANNELS, strict=True):
            chart.line(np.arange(len(values)), values, color, 1.5)
        plots.append(chart.address())
    if falloffs:
        lines = []
        for falloff in falloffs:
            angles = np.linspace(0.0, falloff.max_angle, 60)
            lines += [(np.degrees(angles), values) for values in falloff.at(angles).T]
        most_x, most_y = (max(float(line[i].max()) for line in lines) for i in (0, 1))
        chart = Chart(
            "Light that the lens passes", "angle to the optical axis [degrees]",
            (0.0, 1.02 * most_x), (0.0, (1 + _ROOM) * most_y),
        ).ticks_along()  # fmt: skip
        for place, line in enumerate(lines):
            chart.line(*line, _CHANNELS[place % 3], 1.5)
        plots.append(chart.address())
    return plots


def _around(values: np.ndarray) -> tuple[float, float]:
    """The ends of an axis for values."""
    low, high = float(values.min()), float(values.max())
    return low - _ROOM * (high - low), high + _ROOM * (high - low)


def _thousands(value: float) -> str:
    return f"{value:,.0f}".replace(",", " ")


def ring_text(ring: dict[str, Any]) -> str:
    """A ring's range in words: 0–30°, beyond 80°."""
    low, high = ring["from_degrees"], ring["to_degrees"]
    return f"beyond {low:g}°" if high >= 180 else f"{low:g}–{high:g}°"


def _thinned(x: np.ndarray, y: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most `most` points: means of equal stretches of rows."""
    if len(x) <= most:
        return x, y
    starts = np.linspace(0, len(x), most + 1).astype(int)[:-1]
    counts = np.diff(np.append(starts, len(x)))
    return np.add.reduceat(x, starts) / counts, np.add.reduceat(y, starts) / counts


def _mark_resolutions(
    chart: Chart, history: list[dict[str, Any]], axis: str, options: TrainOptions
) -> None:
    """Thin lines where training went on to 1/2 and to the full resolution."""
    steps = np.array([row["step"] for row in history], float)
    x = np.array([row.get(axis, np.nan) for row in history], float)
    fractions = options.coarse_to_fine
    if len(steps) < 2 or not isinstance(fractions, tuple):
        return
    for fraction, text in zip(fractions, ("1/2 size", "full size"), strict=True):
        if 0 < fraction < 1:
            chart.mark(float(np.interp(fraction * options.steps, steps, x)), text)
