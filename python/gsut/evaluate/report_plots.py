"""Draws the charts of a run's report, as data addresses of SVG."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.page import Chart
from gsut.render import Confidence, Falloff
from gsut.run import TrainOptions

_FAINT = "#a9c9e8"  # of the noisy curve behind the smooth one
_CHANNELS = ("#c0392b", "#27865a", "#2c6fb5")  # of lines for red, green and blue
_MOST_POINTS = 400  # of a curve, about one a pixel; more are averaged
_SMOOTH_POINTS = 60  # of a smooth curve; those of a curve with no more are marked
_BAR_ROOM_DB = 8.0  # below the lowest bar: bars from 0 would hide small differences


def plot_curve(history: list[dict[str, Any]], key: str, title: str, options: TrainOptions) -> str:
    """Plots a quantity of history.jsonl over steps.

    Args:
        history: rows with `step` and some with `key`.
        key: psnr, loss or num_gaussians.
        title: title, with unit.
        options: they give the steps at which the resolution changed.

    Returns:
        A data address.
    """
    rows = [row for row in history if row.get(key) is not None]
    x = np.array([row["step"] for row in rows], float)
    y = np.array([row[key] for row in rows], float)
    across = 0.0, 1.03 * max(float(x.max(initial=0.0)), 1e-6)
    if len(x) > 2 and key == "loss" and (y > 0).all():
        low, high = np.percentile(y, (0.5, 99.5))
        chart = Chart(title, "steps", across, (low / 1.15, high * 1.15), log=True)
        chart.draw_line(*_average_runs(x, y, _MOST_POINTS), _FAINT, 1.0)
        chart.draw_line(*_average_runs(x, y, _SMOOTH_POINTS))
    else:
        up = Chart.pad_limits(y) if len(y) else (0.0, 1.0)
        if key == "num_gaussians":
            up = 0.0, up[1]
        chart = Chart(title, "steps", across, up, y_text=_format_count)
        chart.draw_line(x, y, dots=len(x) <= _SMOOTH_POINTS)
    if key == "psnr" and len(x):
        chart.label_point(x[-1], y[-1], f"{y[-1]:.2f}")
    if len(history) > 1:
        _mark_resolutions(chart, options)
    return chart.embed()


def plot_rings(rings: list[dict[str, Any]]) -> str:
    """Plots PSNR by ring of field angle as bars; rings without pixels are left out."""
    rings = [ring for ring in rings if ring["psnr"] is not None]
    values = [ring["psnr"] for ring in rings]
    up = (max(0.0, min(values) - _BAR_ROOM_DB), max(values) + 2.0) if values else (0.0, 1.0)
    chart = Chart(
        "PSNR by field angle [dB]", "angle to the optical axis",
        (-0.6, max(len(values), 3) - 0.4), up, x_ticks=False,
    )  # fmt: skip
    chart.draw_bars([name_ring(ring) for ring in rings], values)
    return chart.embed()


def plot_light(light: dict[str, Any]) -> list[str]:
    """Plots the gains of the photographs and the falloffs of the lenses, from metrics.json."""
    gains = np.array(list(light["gains"].values()))
    falloffs = [falloff for each in light["falloffs"] if (falloff := Falloff.from_dict(each))]
    plots = []
    if np.ptp(gains, axis=0).any():
        number = np.arange(len(gains), dtype=float)
        chart = Chart(
            "Gain of each photograph", "photographs, by name", (0.0, max(1.0, number[-1])),
            Chart.pad_limits(gains),
        )  # fmt: skip
        for values, color in zip(gains.T, _CHANNELS, strict=True):
            chart.draw_line(number, values, color, 1.4)
        plots.append(chart.embed())
    if falloffs:
        widest = float(np.degrees(max(falloff.max_angle for falloff in falloffs)))
        chart = Chart(
            "Light that the lens passes", "angle to the optical axis [degrees]", (0.0, widest),
            (0.0, 1.1),
        )  # fmt: skip
        for falloff in falloffs:
            angles = np.linspace(0.0, falloff.max_angle, _SMOOTH_POINTS)
            for values, color in zip(falloff.evaluate(angles).T, _CHANNELS, strict=True):
                chart.draw_line(np.degrees(angles), values, color, 1.4)
        plots.append(chart.embed())
    return plots


def plot_reliability(confidence: Confidence) -> str:
    """Plots the shares of pixels within intervals over those due: of each held-out view, of all."""
    chart = Chart(
        "Pixels within their interval", "share that is due", (0.0, 1.0), (0.0, 1.05)
    )  # fmt: skip
    due = np.array([0.0, *confidence.levels, 1.0])
    for held in confidence.held_by_view:
        chart.draw_line(due, np.array([0.0, *held, 1.0]), _FAINT, 1.0)
    chart.draw_line(due, np.array([0.0, *confidence.held, 1.0]), _CHANNELS[2], 1.8)
    return chart.embed()


def name_ring(ring: dict[str, Any]) -> str:
    """Names a ring by its range: 0–30°, beyond 80°."""
    low, high = ring["from_degrees"], ring["to_degrees"]
    return f"beyond {low:g}°" if high >= 180 else f"{low:g}–{high:g}°"


def _format_count(value: float) -> str:
    """Formats 20000 as 20 000, and 31.5 as it is."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 1000 else f"{value:g}"


def _average_runs(x: np.ndarray, y: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Averages runs of equal length, so that at most `most` points remain."""
    if len(x) <= most:
        return x, y
    starts = np.linspace(0, len(x), most + 1).astype(int)[:-1]
    counts = np.diff(np.append(starts, len(x)))
    return np.add.reduceat(x, starts) / counts, np.add.reduceat(y, starts) / counts


def _mark_resolutions(chart: Chart, options: TrainOptions) -> None:
    """Marks where training changed to 1/2 and to the full resolution."""
    for fraction, text in zip(
        options.recipe.coarse_to_fine, ("1/2 size", "full size"), strict=True
    ):
        if 0 < fraction < 1:
            chart.mark_x(fraction * options.steps, text)
