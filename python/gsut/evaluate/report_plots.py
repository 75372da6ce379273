"""The report's plots, as data addresses of SVG."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.page import Chart, limits_of
from gsut.render import Falloff
from gsut.run import TrainOptions

_FAINT = "#a9c9e8"
_CHANNELS = ("#c0392b", "#27865a", "#2c6fb5")  # of lines for red, green and blue
_MOST_POINTS, _SMOOTH_POINTS = 400, 60  # of a curve; more are averaged
_MOST_DOTS = 40


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
    across = 0.0, 1.03 * max(float(x.max(initial=0.0)), 1e-6)
    name = "steps" if axis == "step" else "seconds of training"
    if len(x) > 2 and key == "loss" and (y > 0).all():
        low, high = np.percentile(y, (0.5, 99.5))
        chart = Chart(title, name, across, (low / 1.15, high * 1.15), log=True)
        chart.line(*_thinned(x, y, _MOST_POINTS), _FAINT, 1.0)
        chart.line(*_thinned(x, y, _SMOOTH_POINTS))
    else:
        up = limits_of(y) if len(y) else (0.0, 1.0)
        if key == "num_gaussians":
            up = 0.0, up[1]
        chart = Chart(title, name, across, up, y_text=_with_spaces)
        chart.line(x, y, dots=len(x) <= _MOST_DOTS)
    if key == "psnr" and len(x):
        chart.last_value(x[-1], y[-1], f"{y[-1]:.2f}")
    _mark_resolutions(chart, history, axis, options)
    return chart.address()


def ring_plot(rings: list[dict[str, Any]]) -> str:
    """PSNR by ring of field angle as bars, a data address; rings without pixels are left out."""
    rings = [ring for ring in rings if ring["psnr"] is not None]
    values = [ring["psnr"] for ring in rings]
    # Bars from 0 would hide differences of some dB: they start well below the least.
    up = (max(0.0, min(values) - 8.0), max(values) + 2.0) if values else (0.0, 1.0)
    chart = Chart(
        "PSNR by field angle [dB]", "angle to the optical axis",
        (-0.6, max(len(values), 3) - 0.4), up, x_ticks=False,
    )  # fmt: skip
    chart.bars([ring_text(ring) for ring in rings], values)
    return chart.address()


def light_plots(light: dict[str, Any]) -> list[str]:
    """What metrics.json says of the photographs' light, as data addresses: gains, and falloffs."""
    gains = np.array(list(light["gains"].values()))
    falloffs = [falloff for each in light["falloffs"] if (falloff := Falloff.from_dict(each))]
    plots = []
    if (gains != 1.0).any():
        number = np.arange(len(gains), dtype=float)
        chart = Chart(
            "Gain of each photograph", "photographs, by name", (0.0, max(1.0, number[-1])),
            limits_of(gains),
        )  # fmt: skip
        for values, color in zip(gains.T, _CHANNELS, strict=True):
            chart.line(number, values, color, 1.4)
        plots.append(chart.address())
    if falloffs:
        widest = float(np.degrees(max(falloff.max_angle for falloff in falloffs)))
        chart = Chart(
            "Light that the lens passes", "angle to the optical axis [degrees]", (0.0, widest),
            (0.0, 1.1),
        )  # fmt: skip
        for falloff in falloffs:
            angles = np.linspace(0.0, falloff.max_angle, 60)
            for values, color in zip(falloff.at(angles).T, _CHANNELS, strict=True):
                chart.line(np.degrees(angles), values, color, 1.4)
        plots.append(chart.address())
    return plots


def ring_text(ring: dict[str, Any]) -> str:
    """A ring's range in words: 0–30°, beyond 80°."""
    low, high = ring["from_degrees"], ring["to_degrees"]
    return f"beyond {low:g}°" if high >= 180 else f"{low:g}–{high:g}°"


def _with_spaces(value: float) -> str:
    """20 000, 31.5."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1000 else f"{value:g}"


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
            chart.upright(float(np.interp(fraction * options.steps, steps, x)), text)
