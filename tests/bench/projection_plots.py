"""Plots of `./run bench projection`: time against error, one picture a lens."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.plots import _COLORS, _MARKERS, _MUTED, _save, _style
from tests.bench.projection_bench import BENCH_METHODS, SIZES

_FLOOR = {"center_error_px": 1e-6, "covariance_relative_error": 1e-6, "alpha_missed": 1e-5}
_TITLES = {
    "center_error_px": "error of the centre, px",
    "covariance_relative_error": "error of the covariance, relative",
    "alpha_missed": "share of alpha outside the box",
}


def plot_projection(folder: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> list[Path]:
    """One SVG a lens in `folder`; returns their paths."""
    lenses = list(dict.fromkeys(row["lens"] for row in rows))
    paths = []
    for lens in lenses:
        path = Path(folder) / f"projection_{lens}.svg"
        plot_lens(path, [row for row in rows if row["lens"] == lens])
        paths.append(path)
    return paths


def plot_lens(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Medians over the rings: a colour a method, a marker a size, lines are Pareto fronts.

    Below a floor (dashed) errors are shown on it.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 4.3), layout="constrained")
    for place, (key, title) in enumerate(_TITLES.items()):
        axes = figure.add_subplot(1, 3, place + 1)
        _style(axes, rows[0]["lens"] if place == 0 else "", "ns a Gaussian, one thread", title)
        for marker, size in zip(_MARKERS, SIZES, strict=False):
            points = []
            for color, (method, _, _) in zip(_COLORS, BENCH_METHODS, strict=False):
                cells = [r for r in rows if r["method"] == method and r["size"] == size]
                errors = [r[key] for r in cells if r[key] is not None]
                if not errors:
                    continue
                x = float(np.median([r["ns_per_gaussian"] for r in cells]))
                y = max(float(np.median(errors)), _FLOOR[key])
                points.append((x, y))
                axes.plot(x, y, marker, color=color, markersize=6)
            front = _front(points)
            axes.plot(*zip(*front, strict=True), color=_MUTED, linewidth=0.7, zorder=0)
        axes.axhline(_FLOOR[key], color=_MUTED, linestyle="--", linewidth=0.8)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks([10, 20, 50, 100, 200, 500], minor=False)
        axes.set_xticks([], minor=True)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _legend(figure)
    _save(figure, path)


def _front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that no other beats in both, from left to right."""
    front: list[tuple[float, float]] = []
    for point in sorted(points):
        if not front or point[1] < front[-1][1]:
            front.append(point)
    return front


def _legend(figure: Any) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=color, marker="s", linestyle="none", label=method)
        for color, (method, _, _) in zip(_COLORS, BENCH_METHODS, strict=False)
    ] + [
        Line2D([], [], color=_MUTED, marker=marker, linestyle="none", label=size)
        for marker, size in zip(_MARKERS, SIZES, strict=False)
    ]
    figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize=8)
