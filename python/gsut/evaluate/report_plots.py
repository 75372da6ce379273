"""The report's plots, as data addresses of SVG."""

from __future__ import annotations

from typing import Any

import numpy as np

from gsut.page import GRID, INK, LINE, MUTED, plot_figure, svg_address
from gsut.render import Falloff
from gsut.run import TrainOptions

_FAINT = "#a9c9e8"
_CHANNELS = ("#c0392b", "#27865a", "#2c6fb5")  # of lines for red, green and blue
_SIZE_INCHES = (5.2, 3.0)
_MOST_POINTS = 400  # of a curve; more are averaged


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
    figure, axes = plot_figure(title, *_SIZE_INCHES, frame=False)
    if len(x) > 2 and key == "loss":
        axes.plot(*_thinned(x, y, _MOST_POINTS), color=_FAINT, linewidth=0.8)
        axes.plot(*_thinned(x, y, 60), color=LINE, linewidth=1.8)
        axes.set_yscale("log")
        low, high = np.percentile(y, (0.5, 99.5))
        axes.set_ylim(low / 1.15, high * 1.15)
        _plain_log_ticks(axes)
    else:
        marker = "o" if len(x) <= 40 else None
        axes.plot(x, y, color=LINE, linewidth=1.8, marker=marker, markersize=4)
    if key == "num_gaussians":
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}".replace(",", " "))
    if key == "psnr" and len(x):
        axes.annotate(
            f"{y[-1]:.2f}",
            (x[-1], y[-1]),
            textcoords="offset points",
            xytext=(-2, -14),
            ha="right",
            color=INK,
            fontsize=9,
            fontweight="bold",
        )
    axes.set_xlim(left=0)
    axes.set_xlabel("steps" if axis == "step" else "seconds of training", color=MUTED)
    _mark_resolutions(axes, history, axis, options)
    return svg_address(figure)


def ring_plot(rings: list[dict[str, Any]]) -> str:
    """PSNR by ring of field angle as bars, a data address; rings without pixels are left out."""
    rings = [ring for ring in rings if ring["psnr"] is not None]
    figure, axes = plot_figure("PSNR by field angle [dB]", *_SIZE_INCHES, frame=False)
    labels = [ring_text(ring) for ring in rings]
    values = [ring["psnr"] for ring in rings]
    axes.bar(labels, values, color=LINE, width=0.62)
    for place, value in enumerate(values):
        axes.annotate(
            f"{value:.2f}",
            (place, value),
            textcoords="offset points",
            xytext=(0, 4),
            ha="center",
            color=INK,
            fontsize=9,
            fontweight="bold",
        )
    if values:
        # Bars from 0 would hide differences of some dB: they start well below the least.
        axes.set_ylim(max(0.0, min(values) - 8.0), max(values) + 2.0)
        axes.set_xlim(-0.6, max(len(values), 3) - 0.4)
    axes.set_xlabel("angle to the optical axis", color=MUTED)
    return svg_address(figure)


def light_plots(light: dict[str, Any]) -> list[str]:
    """What metrics.json says of the photographs' light, as data addresses: gains, and falloffs."""
    gains = np.array(list(light["gains"].values()))
    falloffs = [falloff for each in light["falloffs"] if (falloff := Falloff.from_dict(each))]
    plots = []
    if (gains != 1.0).any():
        figure, axes = plot_figure("Gain of each photograph", *_SIZE_INCHES, frame=False)
        for values, color in zip(gains.T, _CHANNELS, strict=True):
            axes.plot(np.arange(len(values)), values, color=color, linewidth=1.2)
        axes.set_xlabel("photographs, by name", color=MUTED)
        plots.append(svg_address(figure))
    if falloffs:
        figure, axes = plot_figure("Light that the lens passes", *_SIZE_INCHES, frame=False)
        for falloff in falloffs:
            angles = np.linspace(0.0, falloff.max_angle, 60)
            for values, color in zip(falloff.at(angles).T, _CHANNELS, strict=True):
                axes.plot(np.degrees(angles), values, color=color, linewidth=1.2)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("angle to the optical axis [degrees]", color=MUTED)
        plots.append(svg_address(figure))
    return plots


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


def _plain_log_ticks(axes: Any) -> None:
    """Numbers like 0.05 on a logarithmic axis, enough of them for less than a decade."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())


def _mark_resolutions(
    axes: Any, history: list[dict[str, Any]], axis: str, options: TrainOptions
) -> None:
    """Thin lines where training went on to 1/2 and to the full resolution."""
    steps = np.array([row["step"] for row in history], float)
    x = np.array([row.get(axis, np.nan) for row in history], float)
    fractions = options.coarse_to_fine
    if len(steps) < 2 or not isinstance(fractions, tuple):
        return
    for fraction, text in zip(fractions, ("1/2 size", "full size"), strict=True):
        if 0 < fraction < 1:
            place = np.interp(fraction * options.steps, steps, x)
            axes.axvline(place, color=GRID, linewidth=1, zorder=0)
            axes.annotate(
                text,
                (place, 1),
                xycoords=("data", "axes fraction"),
                xytext=(3, -9),
                textcoords="offset points",
                color=MUTED,
                fontsize=7.5,
            )
