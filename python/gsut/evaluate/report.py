"""Makes report.html: one self-contained page of everything a training run left in its folder."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import importlib.resources
import math
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.evaluate.report_plots import curve_plot, light_plots, ring_plot
from gsut.page import bytes_address, duration_text, number_text, picture_address, render_page
from gsut.run import (
    BLOCKS,
    ENVIRONMENT,
    METRICS,
    PAGE,
    RENDERS,
    REPORT,
    RunFolder,
    TrainOptions,
    Verdict,
    default_text,
    flag_name,
    option_info,
)

_MOST_VIEWS = 12  # with pictures; the table lists all
_MOST_PIXELS_WIDE = 900  # of an embedded picture
_ERROR_FULL = 0.1  # mean absolute difference of the colours, of [0, 1], at the heat map's end
_DEPTH_PERCENTILES = (1.0, 99.0)  # of all distances shown: the ends of the colour scale
_LEGEND_STOPS = 12


def _curves(history: list[dict[str, Any]], options: TrainOptions) -> dict[str, list[str]]:
    """Data addresses of the plots of a training, by what they are over."""
    return {
        axis: [
            curve_plot(history, key, title, axis, options)
            for key, title in (
                ("psnr", "Held-out PSNR [dB]"),
                ("loss", "Training loss"),
                ("num_gaussians", "Gaussians"),
            )
            if any(row.get(key) is not None for row in history)
        ]
        for axis in ("step", "seconds")
    }


def write_report(run: RunFolder) -> Path:
    """Writes RUN/report.html from metrics.json, history.jsonl, options.json, environment.json and
    the pictures in renders/, and returns its path.

    Args:
        run: the folder of a run whose training and evaluation are done.

    Raises:
        InputError: metrics.json is absent, a picture it names cannot be read, or the report cannot
            be written.
    """
    metrics = run.read_json(METRICS)
    if metrics is None:
        raise InputError(f"{run.path / METRICS} is absent: the run is not finished; resume it")
    environment = run.read_json(ENVIRONMENT) or {}
    options = run.read_options()
    source = (
        importlib.resources.files("gsut.evaluate").joinpath("report.html.j2").read_text("utf-8")
    )
    page = render_page(
        source,
        metrics=metrics,
        environment=environment,
        headline=_headline(metrics),
        verdict=Verdict.from_dict(metrics["verdict"]) if metrics.get("verdict") else None,
        **_pictures(metrics.get("views", []), run.path / RENDERS),
        rows=sorted(metrics.get("views", []), key=lambda row: row["name"]),
        curves=_curves(run.read_history(), options.resolved()),
        rings=metrics.get("rings", []),
        ring_plot=ring_plot(metrics["rings"]) if metrics.get("rings") else None,
        light_plots=light_plots(metrics["light"]) if "light" in metrics else [],
        settings=_settings(options),
        block_map=_block_map(run.path / BLOCKS / "map.png"),
        title=_title(run, metrics),
        page=PAGE if (run.path / PAGE).is_file() else None,
    )
    return run.write_text(REPORT, page)


def _title(run: RunFolder, metrics: dict[str, Any]) -> str:
    """The dataset's name; that of a folder within the run says nothing."""
    name = metrics.get("dataset")
    return name if name and not (run.path / name).is_dir() else run.path.name


def _headline(metrics: dict[str, Any]) -> list[tuple[str, str, str]]:
    """(value, unit, label) of the figures at the top."""
    render_ms = metrics.get("render_ms")
    rows = [
        (number_text(metrics.get("psnr")), "dB", "PSNR, held-out mean"),
        (number_text(metrics.get("ssim"), 4), "", "SSIM, held-out mean"),
        (number_text(metrics.get("num_gaussians"), 0), "", "Gaussians"),
        (number_text(metrics.get("steps"), 0), "", "training steps"),
        (duration_text(metrics.get("train_seconds")), "", "training time"),
        (number_text(render_ms, 1), "ms", "per rendered view"),
        (number_text(metrics.get("peak_rss_mb"), 0), "MiB", "peak memory"),
    ]
    return rows


def _pictures(rows: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    """The views to show, with embedded pictures, and the two colour scales."""
    import cv2

    shown = [row for row in _chosen_views(rows) if "truth" in row[0]]

    def distance_of(shown: tuple[dict[str, Any], list[str]]) -> np.ndarray:
        return _read(folder / shown[0]["depth"]).astype(np.float32) * shown[0]["depth_unit"]

    with concurrent.futures.ThreadPoolExecutor(_core.num_threads(), "gsut-pictures") as threads:
        distances = list(threads.map(distance_of, shown))
        seen = [d[d > 0] for d in distances if np.any(d > 0)]
        near, far = np.percentile(np.concatenate(seen), _DEPTH_PERCENTILES) if seen else (1.0, 1.0)

        def view_of(shown: tuple[dict[str, Any], list[str]], distance: np.ndarray) -> Any:
            row, marks = shown
            depth = _log_position(distance, near, far)
            depth = _coloured(depth, cv2.COLORMAP_TURBO, distance > 0)
            return _view(row, folder) | {"marks": marks, "depth": _picture(depth)}

        views = list(threads.map(view_of, shown, distances))
    hero = next((view for view in views if "median" in view["marks"]), None)
    return {
        "views": views,
        "hero": hero,
        "error_scale": _gradient(cv2.COLORMAP_INFERNO),
        "error_full_percent": 100 * _ERROR_FULL,
        "depth_scale": _gradient(cv2.COLORMAP_TURBO, reverse=True),
        "depth_near": near,
        "depth_far": far,
    }


def _view(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A view's row with its photograph, its render and how far they differ, to embed."""
    import cv2

    truth, render = _read(folder / row["truth"]), _read(folder / row["render"])
    red, green, blue = cv2.split(cv2.absdiff(truth, render))
    error = (red.astype(np.float32) + green + blue) / (3 * 255)
    height, width = truth.shape[:2]
    return {
        **row,
        "width": width,
        "height": height,
        "truth": _picture(truth),
        "render": _picture(render),
        "error": _picture(_coloured(error / _ERROR_FULL, cv2.COLORMAP_INFERNO)),
    }


def _chosen_views(rows: list[dict[str, Any]]) -> list[tuple[dict[str, Any], list[str]]]:
    """At most _MOST_VIEWS rows spread over the ranks of PSNR, by name, with their marks."""
    ranked = sorted((row for row in rows if row["psnr"] is not None), key=lambda row: row["psnr"])
    if not ranked:
        return []
    last = len(ranked) - 1
    marks = {last // 2: ["median"], 0: ["worst"], last: ["best"]} if last else {0: ["median"]}
    count = min(len(ranked), _MOST_VIEWS)
    ranks = {round(i * last / max(1, count - 1)) for i in range(count)} | set(marks)
    chosen = [(ranked[rank], marks.get(rank, [])) for rank in ranks]
    return sorted(chosen, key=lambda entry: entry[0]["name"])


def _log_position(distance: np.ndarray, near: float, far: float) -> np.ndarray:
    """1 at `near`, 0 at `far`, evenly by the logarithm of the distance between them."""
    span = math.log(far / near) or 1.0
    with np.errstate(divide="ignore"):
        return 1.0 - np.clip(np.log(distance / near) / span, 0.0, 1.0)


def _coloured(values: np.ndarray, colormap: int, valid: np.ndarray | None = None) -> np.ndarray:
    """(H, W, 3) RGB of values in [0, 1] by a colour map of OpenCV; black where not valid."""
    import cv2

    levels = np.rint(np.clip(values, 0.0, 1.0) * 255).astype(np.uint8)
    colours = cv2.cvtColor(cv2.applyColorMap(levels, colormap), cv2.COLOR_BGR2RGB)
    return colours if valid is None else colours * valid[..., None].astype(np.uint8)


def _gradient(colormap: int, reverse: bool = False) -> str:
    """The colour map as a CSS gradient from left to right."""
    colours = _coloured(np.linspace(0, 1, _LEGEND_STOPS)[None], colormap)[0]
    stops = ", ".join(f"rgb({r},{g},{b})" for r, g, b in (colours[::-1] if reverse else colours))
    return f"linear-gradient(90deg, {stops})"


def _read(path: Path) -> np.ndarray:
    """A picture as stored: (H, W, 3) RGB uint8 or (H, W) uint16."""
    import cv2

    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; evaluate the run again") from None
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if image is None:
        raise InputError(f"{path} is not a readable picture; evaluate the run again")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 else image


def _block_map(path: Path) -> str | None:
    """The map of a training in blocks as a data address; None: there is none."""
    return bytes_address(path.read_bytes(), "image/png") if path.is_file() else None


def _picture(image: np.ndarray) -> str:
    return picture_address(image, _MOST_PIXELS_WIDE)


def _settings(options: TrainOptions) -> list[dict[str, Any]]:
    """All options by group, with those that differ from a default run marked."""
    defaults = TrainOptions().resolved()
    groups: dict[str, list[dict[str, Any]]] = {}
    for field in dataclasses.fields(options):
        info, value = option_info(field), getattr(options, field.name)
        groups.setdefault(info.group, []).append(
            {
                "flag": flag_name(field.name),
                "value": _value_text(value),
                "unit": info.unit,
                "help": info.help,
                "default": default_text(field),
                "changed": value != getattr(defaults, field.name),
            }
        )
    return [{"name": name, "options": rows} for name, rows in groups.items()]


def _value_text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return ", ".join(_value_text(entry) for entry in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
