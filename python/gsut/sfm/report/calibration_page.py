"""Writes the page of a refined lens: before and after, in pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gsut.files import write_file
from gsut.lens import Camera, spread_pixels
from gsut.page import (
    Chart,
    Style,
    build_page,
    build_table,
    plot_map,
    plot_residuals,
    render_template,
)
from gsut.sfm.lens import RefinedLens

PAGE = "report.html"
_REGIONS = 3  # columns and rows of the image for which residuals are given
_MOST_ARROWS = 3000  # drawn: more cover each other
_RING_DEGREES = 5.0  # of the field angle, in the plot of residuals
_FEWEST_IN_RING = 10  # residuals, for a mean
_PICTURES = """<h2>Pictures</h2>
<div class="pictures">
{%- for address in pictures %}<img alt="" src="{{ address }}">{% endfor %}</div>
<h2>Residuals by region of the image</h2>
<p>Before: the same points and refined poses through the dataset's own lens, turned as well as it
can be; pixels, root mean square lengths. The mean says where a region is off as a whole.</p>"""
_BEFORE = Style.SERIES[1]


def write_page(
    folder: Path, found: RefinedLens, camera: Camera, sigma: np.ndarray, values: dict[str, Any]
) -> Path:
    """Writes FOLDER/report.html, which needs no other file, and returns its path.

    Args:
        folder: beside the lens.
        camera: the refined lens.
        sigma: (rows, columns) pixels on the grid of `spread_pixels`.
        values: of report.json.

    Raises:
        InputError: the file cannot be written.
    """
    solution = found.solution
    good = np.isfinite(solution.residuals).all(axis=1)
    after = solution.residuals[good]
    turn = _find_turn(found.before, camera, found.reach)
    before = _compute_residuals_before(found, turn)[good]
    title = f"{values['lens']} refined from {values['images']} images"
    rows = {
        "images": f"{values['images']} of {values['images_total']}",
        "points, observations": f"{values['points']:,}, {values['observations']:,}",
        "residuals": f"RMS {values['rms_2d_px']:.3f} px (2-D), {values['rms_axis_px']:.3f} "
        f"(an axis); median {values['median_px']:.3f}",
        "observations that no adjustment used, median": (
            f"{_format_px(values['held_out_before_px'])} px before, "
            f"{_format_px(values['held_out_after_px'])} after ({values['held_out_observations']})"
        ),
        "seen to": f"{values['valid_angle_degrees']:.1f} degrees from the axis; the lens is "
        f"one-to-one to {values['lens_domain_degrees']:.1f}",
        "standard deviation of a projected pixel": ", ".join(
            f"{_format_px(value)} px ({name})" for name, value in values["uncertainty_px"].items()
        ),
        "seconds": f"{values['seconds']:.1f}",
    }
    size = (camera.width, camera.height)
    change = _measure_change(found.before, camera, turn)
    pictures = [
        _plot_arrows(camera, solution.pixels[good], after),
        _plot_rings(np.degrees(solution.field_angles[good]), before, after),
        plot_map("Uncertainty of projection", size, sigma, "inferno", "px, one sigma").embed(),
        plot_map("Change of the lens", size, change, "viridis", "px").embed(),
    ]
    parts = [
        build_table(rows.items()),
        render_template("<h2>Parameters</h2>"),
        build_table(
            map(_make_param_row, values["params"]),
            ("parameter", "before", "after", "sigma", "change / sigma"),
        ),
        render_template(_PICTURES, pictures=pictures),
        build_table(
            _make_region_rows(camera, solution.pixels[good], before, after, sigma),
            ("column, row", "observations", "before", "after", "mean x, y after",
             "sigma of the lens"),
        ),
    ]  # fmt: skip
    path = folder / PAGE
    write_file(path, build_page(title, values["notes"], parts))
    return path


def _find_turn(before: Camera, after: Camera, reach: float) -> np.ndarray:
    """Finds (3, 3) the rotation from the new lens' rays to the old one's (Kabsch).

    Poses follow a lens that is turned as a whole.
    """
    pixels = spread_pixels(after.width, after.height).reshape(-1, 2)
    (old, _), (new, _) = before.unproject(pixels), after.unproject(pixels)
    use = np.isfinite(old).all(axis=1) & np.isfinite(new).all(axis=1)
    use[use] = new[use][:, 2] >= np.cos(reach)
    u, _, vt = np.linalg.svd(old[use].T @ new[use])
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


def _compute_residuals_before(found: RefinedLens, turn: np.ndarray) -> np.ndarray:
    """Returns (S, 2) the residuals through the dataset's lens; NaN where it has no pixel."""
    solution = found.solution
    pose = solution.camera_from_world[solution.observations[:, 1]]
    points = solution.points[solution.observations[:, 0]]
    directions = np.einsum("nij,nj->ni", pose[:, :3, :3], points) + pose[:, :3, 3]
    pixels, valid = found.before.project(directions @ turn.T)
    difference = found.before.subtract_pixels(pixels, solution.pixels)
    return np.where(valid[:, None], difference, np.nan)


def _measure_change(before: Camera, after: Camera, turn: np.ndarray) -> np.ndarray:
    """Returns (rows, columns) pixels between the images of one ray in the two lenses, or NaN."""
    pixels = spread_pixels(after.width, after.height)
    rays, _ = after.unproject(pixels.reshape(-1, 2))
    old, valid = before.project(rays @ turn.T)
    difference = before.subtract_pixels(old, pixels.reshape(-1, 2))
    distance = np.linalg.norm(np.where(valid[:, None], difference, np.nan), axis=1)
    return distance.reshape(pixels.shape[:2])


def _make_region_rows(
    camera: Camera, pixels: np.ndarray, before: np.ndarray, after: np.ndarray, sigma: np.ndarray
) -> list[tuple[str, ...]]:
    size = np.array([camera.width, camera.height])

    def find_cell(at: np.ndarray) -> np.ndarray:
        place = np.clip(at * _REGIONS / size, 0, _REGIONS - 1).astype(int)
        return place[..., 1] * _REGIONS + place[..., 0]

    of_observation, of_grid = (
        find_cell(pixels),
        find_cell(spread_pixels(camera.width, camera.height)),
    )
    rows: list[tuple[str, ...]] = []
    for index in range(_REGIONS**2):
        mine, here = of_observation == index, sigma[of_grid == index]
        mean = after[mine].mean(axis=0) if mine.any() else np.full(2, np.nan)
        here = here[np.isfinite(here)]
        known = _format_px(float(np.median(here))) if len(here) else "-"
        rows.append((
            f"{index % _REGIONS + 1}, {index // _REGIONS + 1}", f"{mine.sum():,}",
            _format_px(_measure_rms(before[mine])), _format_px(_measure_rms(after[mine])),
            f"{_format_px(mean[0])}, {_format_px(mean[1])}", known,
        ))  # fmt: skip
    return rows


def _measure_rms(residuals: np.ndarray) -> float:
    squares = np.sum(residuals**2, axis=1)
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def _make_param_row(row: dict[str, Any]) -> tuple[str, ...]:
    before, after, sigma = row["before"], row["after"], row["sigma"]
    moved = f"{(after - before) / sigma:.1f}" if sigma > 0 else "-"
    return row["name"], f"{before:.8g}", f"{after:.8g}", f"{sigma:.2g}", moved


def _format_px(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3f}"


def _plot_arrows(camera: Camera, pixels: np.ndarray, residuals: np.ndarray) -> str:
    step, size = max(1, len(pixels) // _MOST_ARROWS), (camera.width, camera.height)
    return plot_residuals("Residuals after", size, pixels[::step], residuals[::step]).embed()


def _plot_rings(degrees: np.ndarray, before: np.ndarray, after: np.ndarray) -> str:
    ring = np.floor(degrees / _RING_DEGREES).astype(int)
    full = [i for i in np.unique(ring) if np.sum(ring == i) >= _FEWEST_IN_RING]
    middle = np.array([(i + 0.5) * _RING_DEGREES for i in full])
    rms = np.array([[_measure_rms(r[ring == i]) for i in full] for r in (before, after)])
    seen = rms[np.isfinite(rms) & (rms > 0)]
    up = (seen.min() / 1.2, seen.max() * 1.2) if seen.size else (0.1, 1.0)
    across = (0.0, max(float(degrees.max(initial=0.0)), _RING_DEGREES))
    chart = Chart(
        "RMS of residuals [px] by field angle", "degrees from the axis", across, up, log=True
    )
    for values, color in zip(rms, (_BEFORE, Style.LINE), strict=True):
        drawn = np.isfinite(values) & (values > 0)
        chart.draw_line(middle[drawn], values[drawn], color, dots=True)
    chart.list_names([("before", _BEFORE), ("after", Style.LINE)])
    return chart.embed()
