"""Draws a calibration: residuals, coverage, uncertainty and halves, as PNG data addresses."""

from __future__ import annotations

import io
import itertools
from typing import Any

import numpy as np

from calib.boards import Board
from calib.camera import PIXEL_SHIFT, CameraSolution
from calib.trust import TRUSTED_SIGMA_PX, Halves, Trust, trace_trusted_outline
from gsut.page import (
    Style,
    embed_bytes,
    make_figure,
    make_image_figure,
    plot_map,
    plot_residuals,
)

_PNG_DPI = 110  # sharp at the width that pages give a plot
_SIGMA_RANGE = (0.02, 20.0)  # pixels: ends of the colour scale of the uncertainty
_HALVES_RANGE = (1e-3, 1.0)  # degrees: ends of the colour scale of the difference of two lenses
_RING_DEGREES = 5.0  # width of the rings of field angle
_BLUE = Style.SERIES[0]  # of residuals
_RED = Style.SERIES[1]  # of outliers and means
_GREEN = Style.SERIES[2]  # of the trusted field


def draw_camera(
    camera: CameraSolution, trust: Trust, halves: Halves | None, board: Board
) -> list[str]:
    """Draws all pictures of one camera; those without values are left out."""
    size = (camera.width, camera.height)
    figures = [
        _draw_residuals(camera, size),
        _draw_angles(camera, trust, board),
        _draw_coverage(camera, size, trust, board),
    ]
    if np.isfinite(trust.sigma).any():
        figures.append(_draw_uncertainty(camera, size, trust))
    if halves is not None and np.isfinite(halves.degrees).any():
        title = "Difference of two lenses: odd and even photographs"
        figures.append(
            plot_map(title, size, halves.degrees, "inferno", "degrees", logarithmic=_HALVES_RANGE)
        )
    for index, (_, axes) in enumerate(figures):
        if index >= 2:
            outline = trace_trusted_outline(camera, trust.valid_angle) + PIXEL_SHIFT
            axes.plot(*outline.T, color=_GREEN, lw=1.5)
    return [_embed_figure(figure) for figure, _ in figures]


def _draw_residuals(camera: CameraSolution, size: tuple[int, int]) -> tuple[Any, Any]:
    """Draws residual vectors at their corners, enlarged, and outliers as crosses."""
    good, pixels = ~camera.outliers, camera.corners + PIXEL_SHIFT
    figure, axes = plot_residuals("Residuals", size, pixels[good], camera.residuals[good])
    if (~good).any():
        axes.plot(*pixels[~good].T, "x", color=_RED, label=f"{(~good).sum()} outliers")
        axes.legend(loc="upper right")
    return figure, axes


def _draw_angles(camera: CameraSolution, trust: Trust, board: Board) -> tuple[Any, Any]:
    """Draws residual lengths over field angle, with their RMS in rings."""
    good = ~camera.outliers
    degrees = np.degrees(camera.measure_field_angles(board))[good]
    length = np.linalg.norm(camera.residuals[good], axis=1)
    figure, axes = make_figure("Residuals; red: RMS of rings", 6.0, 3.2)
    axes.plot(degrees, length, ".", ms=2, color=_BLUE, alpha=0.4)
    edges = np.arange(0, degrees.max() + _RING_DEGREES, _RING_DEGREES)
    for start, end in itertools.pairwise(edges):
        ring = (degrees >= start) & (degrees < end)
        if ring.any():
            rms = np.sqrt(np.mean(length[ring] ** 2))
            axes.plot([start, end], [rms, rms], color=_RED, lw=2)
    axes.axvline(np.degrees(trust.valid_angle), color=_GREEN, label="trusted to here")
    axes.set(xlabel="degrees from the axis", ylabel="residual [px]")
    axes.legend()
    return figure, axes


def _draw_coverage(
    camera: CameraSolution, size: tuple[int, int], trust: Trust, board: Board
) -> tuple[Any, Any]:
    """Draws every corner, coloured by its field angle."""
    good = ~camera.outliers
    degrees = np.degrees(camera.measure_field_angles(board))[good]
    title = f"{good.sum()} corners; trusted to {np.degrees(trust.valid_angle):.1f}°"
    figure, axes = make_image_figure(title, size)
    pixels = camera.corners[good] + PIXEL_SHIFT
    points = axes.scatter(*pixels.T, c=degrees, s=5, cmap="viridis", vmin=0)
    figure.colorbar(points, ax=axes, label="degrees from the axis", shrink=0.75)
    return figure, axes


def _draw_uncertainty(
    camera: CameraSolution, size: tuple[int, int], trust: Trust
) -> tuple[Any, Any]:
    """Draws the map of the projection's standard deviation, with the trusted level as a line."""
    title, label = "Uncertainty of projection", "px, one standard deviation"
    figure, axes = plot_map(title, size, trust.sigma, "inferno", label, logarithmic=_SIGMA_RANGE)
    if (trust.sigma > TRUSTED_SIGMA_PX).any() and (trust.sigma < TRUSTED_SIGMA_PX).any():
        rows, columns = trust.sigma.shape
        grid = np.linspace(0, size[0] - 1, columns), np.linspace(0, size[1] - 1, rows)
        axes.contour(*grid, trust.sigma, [TRUSTED_SIGMA_PX], colors="w")
    return figure, axes


def _embed_figure(figure: Any) -> str:
    """Returns a figure as the data address of a PNG, for plots of many points."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_PNG_DPI)
    return embed_bytes(buffer.getvalue(), "image/png")
