"""Draws a calibration: residuals, coverage, uncertainty and halves, as SVG data addresses."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from calib.boards import Board
from calib.camera import PIXEL_SHIFT, CameraSolution
from calib.trust import TRUSTED_SIGMA_PX, Halves, Trust, trace_trusted_outline
from gsut.page import RING_DEGREES, Chart, ImageChart, Style, paint_values, plot_map, plot_residuals

_SIGMA_RANGE = (0.02, 20.0)  # pixels: ends of the colour scale of the uncertainty
_HALVES_RANGE = (1e-3, 1.0)  # degrees: ends of the colour scale of the difference of two lenses
_DOT = 5  # half pixels of a chart: side of a corner's dot
_BLUE = Style.SERIES[0]  # of residuals
_RED = Style.SERIES[1]  # of outliers and means
_GREEN = Style.SERIES[2]  # of the trusted field


def draw_camera(
    camera: CameraSolution, trust: Trust, halves: Halves | None, board: Board
) -> list[str]:
    """Draws all pictures of one camera; those without values are left out."""
    size = (camera.width, camera.height)
    over_image = [_draw_coverage(camera, size, trust, board)]
    if np.isfinite(trust.sigma).any():
        over_image.append(_draw_uncertainty(size, trust))
    if halves is not None and np.isfinite(halves.degrees).any():
        title = "Difference of two lenses: odd and even photographs"
        over_image.append(
            plot_map(title, size, halves.degrees, "inferno", "degrees", logarithmic=_HALVES_RANGE)
        )
    outline = trace_trusted_outline(camera, trust.valid_angle) + PIXEL_SHIFT
    for chart in over_image:
        chart.draw_line(*outline.T, _GREEN, 1.5)
    first = [_draw_residuals(camera, size), _draw_angles(camera, trust, board)]
    return [chart.embed() for chart in (*first, *over_image)]


def _draw_residuals(camera: CameraSolution, size: tuple[int, int]) -> Chart:
    """Draws residual vectors at their corners, enlarged, and outliers as rings."""
    good, pixels = ~camera.outliers, camera.corners + PIXEL_SHIFT
    chart = plot_residuals("Residuals", size, pixels[good], camera.residuals[good])
    if (~good).any():
        chart.draw_marks(*pixels[~good].T, _RED)
        chart.list_names([(f"{(~good).sum()} outliers", _RED)])
    return chart


def _draw_angles(camera: CameraSolution, trust: Trust, board: Board) -> Chart:
    """Draws residual lengths over field angle, with their RMS in rings."""
    good = ~camera.outliers
    degrees = np.degrees(camera.measure_field_angles(board))[good]
    length = np.linalg.norm(camera.residuals[good], axis=1)
    trusted = float(np.degrees(trust.valid_angle))
    chart = Chart(
        "Residuals [px]; red: RMS of rings", "degrees from the axis",
        (0.0, 1.03 * max(float(degrees.max()), trusted)),
        (0.0, 1.05 * max(float(length.max()), 1e-9)),
    )  # fmt: skip
    blue = np.tile(np.frombuffer(bytes.fromhex(_BLUE[1:]), np.uint8), (len(degrees), 1))
    chart.draw_points(degrees, length, blue, _DOT)
    edges = np.arange(0, degrees.max() + RING_DEGREES, RING_DEGREES)
    for start, end in itertools.pairwise(edges):
        ring = (degrees >= start) & (degrees < end)
        if ring.any():
            rms = np.sqrt(np.mean(length[ring] ** 2))
            chart.draw_line(np.array([start, end]), np.array([rms, rms]), _RED, 2.0)
    chart.mark_x(trusted, "", _GREEN)
    chart.list_names([("trusted to the green line", _GREEN)])
    return chart


def _draw_coverage(
    camera: CameraSolution, size: tuple[int, int], trust: Trust, board: Board
) -> ImageChart:
    """Draws every corner, coloured by its field angle."""
    good = ~camera.outliers
    degrees = np.degrees(camera.measure_field_angles(board))[good]
    title = f"{good.sum()} corners; trusted to {np.degrees(trust.valid_angle):.1f}°"
    chart = ImageChart(title, size)
    most = max(float(degrees.max()), 1e-9)
    colors = paint_values(degrees[None] / most, cv2.COLORMAP_VIRIDIS)[0]
    chart.draw_points(*(camera.corners[good] + PIXEL_SHIFT).T, colors, _DOT)
    chart.draw_scale(cv2.COLORMAP_VIRIDIS, "degrees from the axis", (0.0, most))
    return chart


def _draw_uncertainty(size: tuple[int, int], trust: Trust) -> Chart:
    """Draws the map of the projection's standard deviation, with the trusted level as a line."""
    title, label = "Uncertainty of projection", "px, one standard deviation"
    chart = plot_map(title, size, trust.sigma, "inferno", label, logarithmic=_SIGMA_RANGE)
    chart.draw_border(trust.sigma > TRUSTED_SIGMA_PX, np.isfinite(trust.sigma), "white")
    return chart
