"""Pictures of a calibration, as PNG data addresses: residuals, coverage, uncertainty, halves."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from calib.board import Board
from calib.halves import Halves
from calib.solution import CameraSolution
from calib.trust import TRUSTED_SIGMA_PX, Trust, trusted_outline
from gsut.page import SERIES, TITLE, plot_figure, png_address

_WIDTH_INCHES = 6.4
_SIGMA_RANGE = (0.02, 20.0)  # pixels: ends of the colour scale of the uncertainty
_HALVES_RANGE = (1e-3, 1.0)  # degrees
_ARROW_PART = 0.05  # of the image's width: length of the arrow of a 99-percentile residual
_BLUE, _RED, _GREEN = SERIES[:3]


def residual_picture(camera: CameraSolution) -> str:
    """Residual vectors at their corners, enlarged; outliers as crosses."""
    good = ~camera.outliers
    pixels, left = camera.corners(), camera.residuals
    length = np.percentile(np.linalg.norm(left[good], axis=1), 99)
    factor = _ARROW_PART * camera.width / max(length, 1e-12)

    def draw(axes: Axes) -> None:
        at, by = pixels[good], left[good] * factor
        axes.quiver(*at.T, *by.T, angles="xy", scale_units="xy", scale=1, width=0.0016, color=_BLUE)
        axes.plot(*pixels[~good].T, "x", color=_RED, label=f"{(~good).sum()} outliers")
        axes.set_title(f"Residuals, enlarged {factor:.0f} times", **TITLE)
        if (~good).any():
            axes.legend(loc="upper right")

    return _image_axes(camera, draw)


def coverage_picture(camera: CameraSolution, trust: Trust, board: Board) -> str:
    """Every corner, coloured by its field angle, and the outline of the trusted field."""
    good = ~camera.outliers
    degrees = np.degrees(camera.field_angles(board))

    def draw(axes: Axes) -> None:
        points = axes.scatter(
            *camera.corners()[good].T, c=degrees[good], s=5, cmap="viridis", vmin=0
        )
        axes.figure.colorbar(points, ax=axes, label="degrees from the axis", shrink=0.75)
        _outline(axes, camera, trust)
        axes.set_title(
            f"{good.sum()} corners; trusted to {np.degrees(trust.valid_angle):.1f}°", **TITLE
        )

    return _image_axes(camera, draw)


def uncertainty_picture(camera: CameraSolution, trust: Trust) -> str | None:
    """Map of the projection's standard deviation; None where it is not known."""
    if not np.isfinite(trust.sigma).any():
        return None

    def draw(axes: Axes) -> None:
        _map(axes, camera, trust.sigma, _SIGMA_RANGE, "px, one standard deviation")
        if (trust.sigma > TRUSTED_SIGMA_PX).any() and (trust.sigma < TRUSTED_SIGMA_PX).any():
            axes.contour(*_grid(camera, trust.sigma), trust.sigma, [TRUSTED_SIGMA_PX], colors="w")
        _outline(axes, camera, trust)
        axes.set_title("Uncertainty of projection", **TITLE)

    return _image_axes(camera, draw)


def halves_picture(camera: CameraSolution, trust: Trust, halves: Halves | None) -> str | None:
    """Map of the angle between the lenses of odd and even photographs."""
    if halves is None or not np.isfinite(halves.degrees).any():
        return None

    def draw(axes: Axes) -> None:
        _map(axes, camera, halves.degrees, _HALVES_RANGE, "degrees")
        _outline(axes, camera, trust)
        axes.set_title("Difference of two lenses: odd and even photographs", **TITLE)

    return _image_axes(camera, draw)


def angle_picture(camera: CameraSolution, trust: Trust, board: Board) -> str:
    """Residual lengths against field angle, with their RMS in rings."""
    good = ~camera.outliers
    degrees = np.degrees(camera.field_angles(board))[good]
    length = np.linalg.norm(camera.residuals[good], axis=1)
    figure, axes = plot_figure("Residuals; red: RMS of rings", _WIDTH_INCHES, 3.2)
    axes.plot(degrees, length, ".", ms=2, color=_BLUE, alpha=0.4)
    edges = np.arange(0, degrees.max() + 5, 5)
    for start, end in itertools.pairwise(edges):
        ring = (degrees >= start) & (degrees < end)
        if ring.any():
            rms = np.sqrt(np.mean(length[ring] ** 2))
            axes.plot([start, end], [rms, rms], color=_RED, lw=2)
    axes.axvline(np.degrees(trust.valid_angle), color=_GREEN, label="trusted to here")
    axes.set(xlabel="degrees from the axis", ylabel="residual [px]")
    axes.legend()
    return png_address(figure)


def _image_axes(camera: CameraSolution, draw: Callable[[Axes], None]) -> str:
    height = _WIDTH_INCHES * camera.height / camera.width + 0.5
    figure, axes = plot_figure("", _WIDTH_INCHES, height)
    axes.grid(False)
    draw(axes)
    axes.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal")
    return png_address(figure)


def _grid(camera: CameraSolution, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = values.shape
    return np.linspace(0, camera.width - 1, columns), np.linspace(0, camera.height - 1, rows)


def _map(axes: Axes, camera: CameraSolution, values, limits, label: str) -> None:
    shown = np.ma.masked_invalid(np.clip(values, *limits))
    colours = axes.pcolormesh(
        *_grid(camera, values), shown, norm=LogNorm(*limits), cmap="inferno", shading="gouraud"
    )
    axes.figure.colorbar(colours, ax=axes, label=label, shrink=0.75)


def _outline(axes: Axes, camera: CameraSolution, trust: Trust) -> None:
    axes.plot(*trusted_outline(camera, trust.valid_angle).T, color=_GREEN, lw=1.5)
