"""The benchmarks' plots: speed against error, scale, PSNR against seconds and size."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.compact import METHODS
from gsut.files import write_file

FORMATS = (".svg", ".png", ".pdf")
_INK, _MUTED, _GRID = "#1d2733", "#6b7785", "#e3e8ee"
# Told apart by people who do not see all colours, too (Okabe and Ito, 2008).
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")
_MARKERS = "osD^vPXd"
_LOWEST, _ALIKE = 1.5, 0.15  # dB below the best that `plot_complexity` shows, and shades


# plot_compact: dB below the whole model; what is worse leaves the picture.
_SHOWN_DB = 6.0


def check_plot_path(path: str) -> None:
    """Raises InputError unless the file's name ends in a format that can be drawn."""
    if Path(path).suffix.lower() not in FORMATS:
        raise InputError(f"--plot {path}: the name must end in {', '.join(FORMATS)}")


def plot_knobs(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Time against error of each setting, see `knob_bench`.

    Left what the blend rule's knobs cost and give, by the error to the rule without cut-offs; right
    the instruction sets and the scalar baseline, by the error to the double reference.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    time = "forward + backward, ms (processor time / threads)"
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    _style(left, f"{rows[0]['name']}: the rule", time, "image rms to the rule without cut-offs")
    _style(right, "the arithmetic and the tiles", time, "image rms to the double reference")
    default = rows[0]
    knobs = ("alpha_min", "transmittance_min", "response_min", "order")
    for place, knob in enumerate(knobs):
        line = [row for row in rows if row["knob"] == knob]
        _points(left, line, "rule_rms_error", knob, place)
    _points(left, [default], "rule_rms_error", f"default ({default['isa']})", len(knobs))
    shown = [{**default, "value": default["isa"]}, *(r for r in rows if r["knob"] == "isa")]
    _points(right, shown, "image_rms_error", "tiled renderer, exact tiles", 0)
    shown = [row for row in rows if row["knob"] == "tile bound"]
    _points(right, shown, "image_rms_error", "scalar baseline, unscented extents", 1)
    right.set_xscale("log")
    right.margins(x=0.25, y=0.15)
    left.margins(x=0.15, y=0.12)
    _save(figure, path)


def _points(axes: Any, rows: Sequence[dict[str, Any]], key: str, label: str, place: int) -> None:
    if not rows:
        return
    x, y = [row["forward_backward_cpu_ms"] for row in rows], [row[key] for row in rows]
    axes.plot(
        x, y, _MARKERS[place], color=_COLORS[place], label=label, markersize=7, linestyle="none"
    )
    for row, left, low in zip(rows, x, y, strict=True):
        axes.annotate(
            row["value"].removeprefix("scalar baseline, "), (left, low), fontsize=7.5,
            textcoords="offset points", xytext=(0, 7), ha="center", color=_MUTED,
        )  # fmt: skip
    axes.set_yscale("log")
    axes.legend(frameon=False, fontsize=8)


def plot_scale(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Step time and memory over the number of Gaussians, one line an image size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    for place, (key, label) in enumerate(
        (("step_cpu_ms", "training step, ms (processor time / threads)"), ("peak_mb", "memory, MB"))
    ):
        axes = figure.add_subplot(1, 2, place + 1)
        _style(axes, "", "Gaussians", label)
        for index, pixels in enumerate(sorted({row["width"] * row["height"] for row in rows})):
            line = sorted(
                (row for row in rows if row["width"] * row["height"] == pixels and row[key]),
                key=lambda row: row["num_gaussians"],
            )
            axes.plot(
                [row["num_gaussians"] for row in line], [row[key] for row in line],
                _MARKERS[index % len(_MARKERS)] + "-", color=_COLORS[index % len(_COLORS)],
                label=f"{pixels / 1e6:.2g} megapixels", markersize=5, linewidth=1.4,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.legend(frameon=False, fontsize=8)
    _save(figure, path)


def plot_curves(path: str | os.PathLike[str], curves: dict[str, list[dict[str, Any]]]) -> None:
    """PSNR against seconds, one line a preset; rows with `seconds` and `psnr`."""
    figure, axes = _figure("held-out PSNR", "seconds since the command began", "dB", (7.2, 4.4))
    for index, (preset, rows) in enumerate(curves.items()):
        color = _COLORS[index % len(_COLORS)]
        x, y = [row["seconds"] for row in rows], [row["psnr"] for row in rows]
        axes.plot(
            x, y, _MARKERS[index % len(_MARKERS)] + "-", color=color, markersize=4,
            linewidth=1.5, label=f"{preset}: {y[-1]:.2f} dB in {x[-1]:.0f} s",
        )  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.legend(frameon=False, fontsize=9, loc="lower right")
    _save(figure, path)


def plot_complexity(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Held-out PSNR below the best against Gaussians, a line a capture; what is chosen is filled.

    Shaded is what lies within 0.15 dB of the best; what is 1.5 dB below is not shown.

    Args:
        path: svg, png or pdf.
        rows: of `complexity_bench`; where there are several degrees of harmonics, the best counts.
    """
    title = "held-out PSNR, below the best of the sweep"
    figure, axes = _figure(title, "most Gaussians", "dB", (7.2, 4.8))
    captures = dict.fromkeys((row["capture"], row["views"]) for row in rows)
    for index, (capture, views) in enumerate(captures):
        below: dict[int, float] = {}
        chosen = {}
        for row in rows:
            if (row["capture"], row["views"]) == (capture, views):
                count = row["max_gaussians"]
                below[count] = min(row["below"], below.get(count, row["below"]))
                chosen |= {count: row["below"]} if row.get("chosen") else {}
        x = sorted(below)
        color, marker = _COLORS[index % len(_COLORS)], _MARKERS[index % len(_MARKERS)]
        axes.plot(
            x, [-below[count] for count in x], marker + ("-", "--")[index // len(_COLORS) % 2],
            color=color, markersize=4, markerfacecolor="white", linewidth=1.3,
            label=f"{capture.split(',')[0]}, {views} views",
        )  # fmt: skip
        for count, at in chosen.items():
            axes.plot([count], [-at], marker, color=color, markersize=9)
    axes.axhspan(-_ALIKE, 0.0, color="#f0f0f0", zorder=0)
    axes.set_ylim(bottom=max(axes.get_ylim()[0], -_LOWEST))
    _rounded_ticks(axes)
    axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _save(figure, path)


def plot_compact(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """One row of two panels a scene and start: PSNR against Gaussians and against render time.

    Points more than 6 dB below the whole model are not shown.

    Args:
        path: svg, png or pdf.
        rows: of `compact_bench`.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    scenes = list(dict.fromkeys((row["scene"], row["start"]) for row in rows))
    figure = Figure(figsize=(10.0, 0.8 + 3.1 * len(scenes)), layout="constrained")
    drawn: dict[str, Any] = {}  # what the legend shows, once for all panels
    for place, scene in enumerate(scenes):
        of_scene = [row for row in rows if (row["scene"], row["start"]) == scene]
        whole = next(row for row in of_scene if row["method"] == "whole")
        title = f"{scene[0]}, {scene[1]} start of {whole['num_gaussians']:,}"
        for k, key in enumerate(("num_gaussians", "render_ms")):
            axes = figure.add_subplot(len(scenes), 2, 2 * place + k + 1)
            x = ("Gaussians", "render time, ms a view (processor time / threads)")[k]
            _style(axes, title if k == 0 else "", x, "held-out PSNR, dB" if k == 0 else "")
            drawn |= _lines(axes, of_scene, whole, key)
            _rounded_ticks(axes)
            axes.set_ylim(bottom=whole["free"]["psnr"] - _SHOWN_DB)
    drawn["fine-tuned"] = Line2D([], [], color=_MUTED, linestyle="-", linewidth=1.4)
    drawn["no photograph"] = Line2D([], [], color=_MUTED, linestyle=":", linewidth=1.4)
    figure.legend(
        [*drawn.values()], [*drawn], loc="outside upper left", ncols=5, frameon=False, fontsize=9
    )
    _save(figure, path)


def _lines(
    axes: Any, rows: Sequence[dict[str, Any]], whole: dict[str, Any], key: str
) -> dict[str, Any]:
    """Each method's lines, the rival's and the whole model; the legend's entries by label."""
    drawn: dict[str, Any] = {}
    there = {row["method"] for row in rows}
    methods = [method for method in METHODS if method in there]
    for method in methods:
        index = METHODS.index(method)  # one colour a method in all panels
        line = sorted((row for row in rows if row["method"] == method), key=lambda row: row["keep"])
        color, marker = _COLORS[index % 6], _MARKERS[index % len(_MARKERS)]
        for kind, form in ((":", "free"), ("-", "tuned")):
            x = [row[key] if key in row else row[form][key] for row in line]
            y = [row[form]["psnr"] for row in line]
            (drawn[method],) = axes.plot(
                x, y, marker + kind, color=color, markersize=4, linewidth=1.3
            )
    rivals = {
        row["keep"]: row["rival"] for row in rows if row["method"] != "whole" and row.get("rival")
    }
    line = [rivals[keep] for keep in sorted(rivals)]
    if line:
        (drawn["trained that small, same seconds"],) = axes.plot(
            [rival[key] for rival in line], [rival["psnr"] for rival in line], "X--",
            color="#000000", markersize=6, linewidth=1.2,
        )  # fmt: skip
    at = whole[key] if key in whole else whole["free"][key]
    (drawn["whole"],) = axes.plot(
        [at], [whole["free"]["psnr"]], "*", color="#000000", markersize=11
    )
    return drawn


def _rounded_ticks(axes: Any) -> None:
    """A logarithmic axis with ticks at 1, 2 and 5 times the powers of ten, written out."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))


def _figure(title: str, x: str, y: str, size: tuple[float, float]) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    _style(axes, title, x, y)
    return figure, axes


def _style(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", color=_INK, fontsize=11, fontweight="bold")
    axes.set_xlabel(x, color=_MUTED)
    axes.set_ylabel(y, color=_MUTED)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=_MUTED, labelsize=9)


def _save(figure: Any, path: str | os.PathLike[str]) -> None:
    import matplotlib

    kind = Path(path).suffix.lower().lstrip(".")
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gsut"}):
        metadata = {"Date": None} if kind == "svg" else None
        figure.savefig(buffer, format=kind, metadata=metadata, dpi=150)
    write_file(path, buffer.getvalue())


def plot_basin(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Share of poses that come back against the disturbance, a line for each way back."""
    figure, axes = _figure(
        "poses that come back to 0.1 degrees and 1 cm",
        "turned by so many degrees, and moved by 4 cm a degree",
        "share",
        (7.2, 4.0),
    )
    ways = {
        "tracks": "training poses, by tracks of features",
        "colours": "one held-out photograph, by its colours alone",
    }
    for place, (way, words) in enumerate(ways.items()):
        line = [row for row in rows if row["basin"] == way]
        if line:
            axes.plot(
                [row["degrees"] for row in line], [row["share"] for row in line],
                _MARKERS[place] + "-", color=_COLORS[place], markersize=6, linewidth=1.5,
                label=f"{words} ({line[0]['poses']} a point)",
            )  # fmt: skip
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_ylim(-0.03, 1.05)
    axes.legend(frameon=False, fontsize=9, loc="lower left")
    _save(figure, path)
