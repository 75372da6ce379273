"""Writes the page of a run: cameras and points, and residuals by field angle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gsut.data import CAPTURE_FOLDER, STRIP
from gsut.data.poses import find_centers
from gsut.files import read_bytes, write_file
from gsut.page import (
    RING_DEGREES,
    Chart,
    Style,
    build_page,
    build_table,
    embed_bytes,
    render_template,
)
from gsut.run import Verdict
from gsut.sampling import ENOUGH_SAMPLES, FEWEST_SAMPLES
from gsut.sfm.solution import Solution

REPORT = "report.html"
_SHOWN_PERCENT = 97.0  # of the points, nearest first: far ones would shrink the rest
_CHARTS = """<div class="plots" style="grid-template-columns: repeat(auto-fit, minmax(20rem, 1fr))">
{%- for chart in charts %}<img src="{{ chart.embed() }}" alt="{{ alt }}">{% endfor %}</div>"""
_STRIP = """<h2>Pictures chosen</h2>
<img src="{{ address }}" alt="the pictures chosen" style="width: 100%">"""


def write_report(out: Path, solution: Solution, values: dict[str, Any]) -> None:
    """Writes report.html, which needs no other file.

    Args:
        out: the folder.
        solution: what the charts are drawn from.
        values: the content of poses.json.

    Raises:
        InputError: the file cannot be written.
    """
    title = f"{values['registered']} of {values['images']} images registered"
    error = values["reprojection_error_px"]
    summary = {
        "points": f"{values['points']:,}",
        "observations": f"{values['observations']:,} ({values['mean_track_length'] or 0:.1f} a "
        "point)",
        "reprojection error": f"median {error['median']:.3f} px, rms {error['rms']:.3f} px",
        "seconds": ", ".join(f"{k} {v:.1f}" for k, v in values["seconds"].items()),
        "began with": " and ".join(values["initial_pair"]),
        **(_make_rig_rows(values["rig"]) if "rig" in values else {}),
        **{
            f"lens {i}": f"{lens['model']} "
            + " ".join(f"{v:.6g}" for v in lens["params"])
            + f" ({values['lens']})"
            for i, lens in enumerate(values["lenses"], 1)
        },
    }
    parts = []
    if "verdict" in values:  # a calibration judges its lens on its own page
        verdict = Verdict.from_dict(values["verdict"])
        parts.append(render_template("<p><b>{{ verdict }}</b></p>", verdict=verdict))
    parts += [
        build_table(summary.items()),
        render_template("<h2>Cameras and points from above and from the side</h2>"),
        render_template(
            _CHARTS, charts=_plot_scene(solution, values.get("rig")), alt="cameras and points"
        ),
        render_template("<h2>Residuals</h2>"),
        render_template(_CHARTS, charts=_plot_residuals(solution), alt="residuals"),
        render_template("<h2>Images</h2>"),
        build_table(
            map(_make_image_row, values["views"]),
            ("image", "points", "median error [px]", "sigma of the turn [degrees]"),
        ),
    ]
    strip = out / CAPTURE_FOLDER / STRIP
    if strip.is_file():
        address = embed_bytes(read_bytes(strip), "image/jpeg")
        parts.append(render_template(_STRIP, address=address))
    write_file(out / REPORT, build_page(title, values["notes"], parts))


def _make_image_row(row: dict[str, Any]) -> tuple[str, ...]:
    if not row["registered"]:
        return row["name"], "not registered", "", ""
    sigma = [v for v in row["sigma_turn_degrees"] if v is not None]
    shown = f"{max(sigma):.4f}" if sigma else "unknown"
    return row["name"], str(row["points"]), f"{row['error_px'] or 0:.3f}", shown


def _make_rig_rows(rig: dict[str, Any]) -> dict[str, str]:
    """Makes the rows of the summary: the frames, the unit, and each camera of the rig."""
    rows = {
        "rig": f"{rig['frames_registered']} of {rig['frames_total']} frames; lengths in the "
        f"unit of {rig['file']}, baseline {rig['baseline']:.6g}",
        "residuals of the same features": f"{rig['residual_px']:.3f} px with one pose a frame, "
        f"{rig['residual_alone_px']:.3f} px image by image (medians)",
    }
    if rig["scale_sigma_percent"] is not None:
        rows["standard error of lengths"] = (
            f"{rig['scale_sigma_percent']:.2f} %, the baseline taken for exact"
        )
    for camera in rig["cameras"]:
        words = f"{camera['registered']} of {camera['images']} images"
        if rig["refined"]:
            words += (
                f"; refined: turned by {camera['turned_degrees']:.4f} degrees, moved by "
                f"{camera['shifted']:.3g}"
            )
        rows[f"camera {camera['name']}"] = words
    return rows


def _plot_scene(solution: Solution, rig: dict[str, Any] | None) -> list[Chart]:
    """Plots the scene along two principal axes of the path; each camera of a rig in a colour."""
    centers = find_centers(solution.camera_from_world[solution.registered])
    forward = solution.camera_from_world[solution.registered][:, 2, :3]
    down = solution.camera_from_world[solution.registered][:, 1, :3].mean(axis=0)
    down = down / max(float(np.linalg.norm(down)), 1e-12)
    middle = centers.mean(axis=0)
    flat = centers - middle - np.outer((centers - middle) @ down, down)
    across = np.linalg.svd(flat - flat.mean(axis=0))[2][0]
    across = across - (across @ down) * down
    across /= max(float(np.linalg.norm(across)), 1e-12)
    along = np.cross(down, across)
    far = np.linalg.norm(solution.points - middle, axis=1)
    keep = np.flatnonzero(far <= np.percentile(far, _SHOWN_PERCENT))
    keep = keep[:: max(1, len(keep) // ENOUGH_SAMPLES)]
    points, colors = solution.points[keep] - middle, solution.colors[keep]
    cameras, frames = _group_by_rig(solution, rig)
    size = 0.03 * max(float(np.ptp(centers @ across)), float(np.ptp(centers @ along)), 1e-9)
    starts = centers - middle
    rays = np.stack([starts, starts + size * forward], axis=1)
    shown = np.concatenate([points, rays.reshape(-1, 3)])
    charts = []
    for title, (x, y) in (("from above", (across, along)), ("from the side", (across, -down))):
        unit = "" if rig is None else "in the rig's unit"
        chart = Chart.make_map(title, unit, shown @ x, shown @ y)
        chart.draw_points(points @ x, points @ y, colors)
        for rows in frames:
            chart.draw_line(starts[rows] @ x, starts[rows] @ y, Style.MUTED, 0.8)
        for number, (name, rows) in enumerate(cameras.items()):
            color = Style.SERIES[number % len(Style.SERIES)]
            dots = np.repeat(starts[rows, None], 2, axis=1)
            chart.draw_segments(dots @ x, dots @ y, color, 4.0)
            chart.draw_segments(rays[rows] @ x, rays[rows] @ y, color)
            chart.write(66, 48 + 15 * number, name, color, 12, "start")
        charts.append(chart)
    return charts


def _group_by_rig(
    solution: Solution, rig: dict[str, Any] | None
) -> tuple[dict[str, list[int]], list[list[int]]]:
    """Returns the rows, among the images with a pose, of each camera and of each frame."""
    if rig is None:
        return {"": list(range(solution.num_registered))}, []
    place = {name: row for row, name in enumerate(solution.registered_names)}
    cameras = {
        camera["name"]: [place[m[number]] for m in rig["frames"] if m[number] in place]
        for number, camera in enumerate(rig["cameras"])
    }
    return cameras, [[place[name] for name in m if name in place] for m in rig["frames"]]


def _plot_residuals(solution: Solution) -> list[Chart]:
    lengths = np.linalg.norm(solution.residuals, axis=1)
    good = np.isfinite(lengths)
    degrees = np.degrees(solution.field_angles[good])
    lengths = lengths[good]
    bins = np.floor(degrees / RING_DEGREES).astype(int)
    middles, medians, upper = [0.0], [0.0], [0.0]
    for index in np.unique(bins):
        inside = lengths[bins == index]
        if len(inside) < FEWEST_SAMPLES:
            continue
        middles.append((index + 0.5) * RING_DEGREES)
        medians.append(float(np.median(inside)))
        upper.append(float(np.percentile(inside, 90)))
    by_angle = Chart(
        "residual [px] by field angle: median and 90 %", "degrees from the axis",
        (0.0, middles[-1] + RING_DEGREES), (0.0, 1.1 * max(upper) or 1.0),
    )  # fmt: skip
    x = np.array(middles[1:])
    by_angle.draw_line(x, np.array(upper[1:]), Style.MUTED, 1.5, dots=True)
    by_angle.draw_line(x, np.array(medians[1:]), dots=True)
    return [by_angle]
