"""Writes report.html: one self-contained page of a training run, from the files in its folder."""

from __future__ import annotations

import concurrent.futures
import math
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.evaluate.detail import SIDE
from gsut.evaluate.report_plots import (
    name_ring,
    plot_curve,
    plot_light,
    plot_reliability,
    plot_rings,
)
from gsut.files import read_package_file, read_picture
from gsut.page import (
    embed_picture,
    format_duration,
    format_number,
    paint_values,
    render_template,
)
from gsut.render import Confidence
from gsut.run import RunFile, RunFolder, TrainOptions, Verdict

_MOST_VIEWS = 12  # with pictures, to keep the page small; the table lists all
_ERROR_FULL = 0.1  # mean absolute difference of the colours, of [0, 1], at the heat map's end
_DEPTH_PERCENTILES = (1.0, 99.0)  # of all distances shown: the ends of the colour scale


def _plot_curves(history: list[dict[str, Any]], options: TrainOptions) -> list[str]:
    """Plots a training's history over steps, as data addresses."""
    return [
        plot_curve(history, key, title, options)
        for key, title in (
            ("psnr", "Held-out PSNR [dB]"),
            ("loss", "Training loss"),
            ("num_gaussians", "Gaussians"),
        )
        if any(row.get(key) is not None for row in history)
    ]


def write_report(run: RunFolder) -> Path:
    """Writes RUN/report.html and returns its path.

    It is made from metrics.json, history.jsonl, options.json, environment.json and the pictures in
    renders/.

    Args:
        run: the folder of a run whose training and evaluation are finished.

    Raises:
        InputError: metrics.json is absent, a picture that it names cannot be read, or the report
            cannot be written.
    """
    metrics = run.read_json(RunFile.METRICS)
    if metrics is None:
        raise InputError(
            f"{run.path / RunFile.METRICS} is absent: the run is not finished; resume it"
        )
    environment = run.read_json(RunFile.ENVIRONMENT) or {}
    options = run.read_options()
    source = read_package_file("gsut.evaluate", "report.html.j2").decode()
    page = render_template(
        source,
        metrics=metrics,
        environment=environment,
        headline=_list_headline(metrics),
        verdict=Verdict.from_dict(metrics["verdict"]) if metrics.get("verdict") else None,
        **_embed_views(metrics.get("views", []), run.path / RunFile.RENDERS),
        **_list_rows(metrics, environment),
        marked=[
            (_embed(_read(run.path / RunFile.RENDERS / row["picture"])), row["text"])
            for row in metrics.get("marked", [])
        ],
        curves=_plot_curves(run.history.read(), options),
        ring_plot=plot_rings(metrics["rings"]) if metrics.get("rings") else None,
        light_plots=plot_light(metrics["light"]) if "light" in metrics else [],
        confidence=_describe_confidence(run.path / RunFile.CONFIDENCE),
        title=_choose_title(run, metrics),
        page=RunFile.PAGE if (run.path / RunFile.PAGE).is_file() else None,
    )
    return run.write_text(RunFile.REPORT, page)


def _describe_confidence(path: Path) -> tuple[str, str | None] | None:
    """Describes how well sigmas hold, with a plot if they were judged; None: not measured."""
    if not path.is_file():
        return None
    found = Confidence.load(path)
    return found.describe(), plot_reliability(found) if found.held_by_view.size else None


def _choose_title(run: RunFolder, metrics: dict[str, Any]) -> str:
    """Returns the dataset's name, or the run's if the dataset is a folder within the run."""
    name = metrics.get("dataset")
    return name if name and not (run.path / name).is_dir() else run.path.name


def _list_headline(metrics: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Lists (value, unit, label) of the figures at the top."""
    render_ms, shown = metrics.get("render_ms"), metrics.get("psnr_unit_gain")
    detail = metrics.get("detail")
    return [
        (format_number(metrics.get("psnr")), "dB", "PSNR, held-out mean"),
        *(
            [(format_number(shown), "dB", "PSNR as shown, without the photographs' light")]
            if "light" in metrics
            else []
        ),
        (
            format_number(None if detail is None else 100 * detail, 0),
            "%",
            "of the detail is right, held-out mean",
        ),
        (format_number(metrics.get("ssim"), 4), "", "SSIM, held-out mean"),
        (format_number(metrics.get("num_gaussians"), 0), "", "Gaussians"),
        (format_number(metrics.get("steps"), 0), "", "training steps"),
        (format_duration(metrics.get("train_seconds")), "", "training time"),
        (format_number(render_ms, 1), "ms", "per rendered view"),
        (format_number(metrics.get("peak_rss_mb"), 0), "MiB", "peak memory"),
    ]


def _list_rows(metrics: dict[str, Any], environment: dict[str, Any]) -> dict[str, list[list[str]]]:
    """Lists the rows of the page's tables, as text."""
    views = sorted(metrics.get("views", []), key=lambda row: row["name"])
    means = {"name": "mean", "render_ms": None, **{k: metrics.get(k) for k in _QUALITY}}
    blocks = metrics.get("blocks", {"stages": {}, "rows": []})
    return {
        "ring_rows": [
            [name_ring(ring), format_number(ring["psnr"]), format_number(ring["pixels"], 0)]
            for ring in metrics.get("rings", [])
        ],
        "view_rows": [
            [
                row["name"],
                *(format_number(row[key], digits) for key, digits in _QUALITY.items()),
                "" if row is means else format_number(row["render_ms"], 1),
            ]
            for row in [*views, means]
        ],
        "stage_rows": [
            [name, format_duration(seconds)] for name, seconds in blocks["stages"].items()
        ],
        "block_rows": [
            [
                row["block"], format_number(row["gaussians"], 0), row["views"], row["steps"],
                format_duration(row["seconds"]), format_number(row["bytes"] / 1e6, 1),
                format_number(row["peak_rss_mb"], 0),
            ]
            for row in blocks["rows"]
        ],
        "environment_rows": [
            *([k, v] for k, v in environment.items() if k != "command" and v is not None),
            ["seconds per step", format_number(metrics.get("seconds_per_step"), 4)],
            ["seed", metrics.get("seed")],
        ],
    }  # fmt: skip


_QUALITY = {"psnr": 2, "psnr_color_corrected": 2, "ssim": 4}  # keys of a view, with decimals


def _embed_views(rows: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    """Embeds the pictures of the views to show, and the two colour scales."""
    import cv2

    shown = [row for row in _choose_views(rows) if "truth" in row[0]]

    def read_distance(shown: tuple[dict[str, Any], list[str]]) -> np.ndarray:
        return _read(folder / shown[0]["depth"]).astype(np.float32) * shown[0]["depth_unit"]

    with concurrent.futures.ThreadPoolExecutor(_core.num_threads(), "gsut-pictures") as threads:
        distances = list(threads.map(read_distance, shown))
        seen = [d[d > 0] for d in distances if np.any(d > 0)]
        near, far = np.percentile(np.concatenate(seen), _DEPTH_PERCENTILES) if seen else (1.0, 1.0)

        def embed_all(shown: tuple[dict[str, Any], list[str]], distance: np.ndarray) -> Any:
            row, marks = shown
            depth = _place_on_log_scale(distance, near, far)
            depth = paint_values(depth, cv2.COLORMAP_TURBO, distance > 0)
            return _embed_view(row, folder) | {"marks": marks, "depth": _embed(depth)}

        views = list(threads.map(embed_all, shown, distances))
    hero = next((view for view in views if "median" in view["marks"]), None)
    return {
        "views": views,
        "hero": hero,
        "error_scale": _build_gradient(cv2.COLORMAP_INFERNO),
        "error_full_percent": 100 * _ERROR_FULL,
        "depth_scale": _build_gradient(cv2.COLORMAP_TURBO, reverse=True),
        "depth_near": near,
        "depth_far": far,
    }


def _embed_view(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Adds to a view's row its photograph, its render and their difference, embedded."""
    import cv2

    truth, render = _read(folder / row["truth"]), _read(folder / row["render"])
    red, green, blue = cv2.split(cv2.absdiff(truth, render))
    error = (red.astype(np.float32) + green + blue) / (3 * 255)
    height, width = truth.shape[:2]
    return {
        **row,
        "width": width,
        "height": height,
        "truth": _embed(truth),
        "render": _embed(render),
        "error": _embed(paint_values(error / _ERROR_FULL, cv2.COLORMAP_INFERNO)),
    }


def _choose_views(rows: list[dict[str, Any]]) -> list[tuple[dict[str, Any], list[str]]]:
    """Chooses about _MOST_VIEWS rows spread over the ranks of PSNR, with their marks, by name."""
    ranked = sorted((row for row in rows if row["psnr"] is not None), key=lambda row: row["psnr"])
    if not ranked:
        return []
    last = len(ranked) - 1
    marks = {last // 2: ["median"], 0: ["worst"], last: ["best"]} if last else {0: ["median"]}
    count = min(len(ranked), _MOST_VIEWS)
    ranks = {round(i * last / max(1, count - 1)) for i in range(count)} | set(marks)
    chosen = [(ranked[rank], marks.get(rank, [])) for rank in ranks]
    return sorted(chosen, key=lambda entry: entry[0]["name"])


def _place_on_log_scale(distance: np.ndarray, near: float, far: float) -> np.ndarray:
    """Maps distances to 1 at `near` and 0 at `far`, evenly in their logarithm."""
    span = math.log(far / near) or 1.0
    with np.errstate(divide="ignore"):
        return 1.0 - np.clip(np.log(distance / near) / span, 0.0, 1.0)


def _build_gradient(colormap: int, reverse: bool = False) -> str:
    """Builds a CSS gradient of the colour map, from left to right."""
    colours = paint_values(np.arange(256)[None] / 255, colormap)[0]
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in (colours[::-1] if reverse else colours))
    return f"linear-gradient(90deg, {stops})"


def _read(path: Path) -> np.ndarray:
    """Reads a picture as stored: (H, W, 3) RGB uint8 or (H, W) uint16."""
    import cv2

    image = read_picture(path, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"{path} is not a readable picture; evaluate the run again")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 else image


def _embed(image: np.ndarray) -> str:
    return embed_picture(image, SIDE)
