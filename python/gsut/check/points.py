"""Checks whether points lie where the cameras see them, and if not, in which unit or axes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gsut.check.colors import COLOR_GAIN, EXPECTED_R, correlate_colors
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.data import Scene
from gsut.data.points import has_colors
from gsut.judge import list_signed_permutations
from gsut.sampling import ENOUGH_SAMPLES, FEWEST_SAMPLES, choose_evenly

_UNITS = {  # points' unit over the poses' -> names of both
    1e-3: ("metres", "millimetres"),
    0.01: ("metres", "centimetres"),
    100.0: ("centimetres", "metres"),
    1e3: ("millimetres", "metres"),
}
_NEAR_SCALES = 2.0 ** np.linspace(-2, 2, 17)  # times the ratio of spreads, which is inexact
_OTHER_SCALE = 30.0  # ratio of spreads that points far behind what matches show do not reach


def check_points_frame(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Checks points against poses that the photographs agree with.

    Args:
        scene: with points; in the dataset's coordinates.
        evidence: of the photographs, or None if they share too few features.

    Returns:
        An error that names the unit, scale or axes with which the points' colours would fit, or a
        warning that their spread does not fit, or nothing.
    """
    if len(scene.points) < FEWEST_SAMPLES:
        return []
    ratio = None if evidence is None else _compare_spread(scene, evidence)
    if ratio is not None and 1 / _OTHER_SCALE < ratio < _OTHER_SCALE:
        ratio = None
    if has_colors(scene):
        colors = _PointColors(scene)
        if colors.given >= EXPECTED_R:
            return []
        scales = [*_UNITS]
        if ratio is not None:
            scales += [10.0 ** round(math.log10(ratio)), *(ratio * _NEAR_SCALES)]
        for found in (_try_scales(colors, scales), _try_axes(colors)):
            if found is not None:
                return [Finding("error", str(scene.path), *found)]
    if ratio is None:
        return []
    what = f"the points spread {ratio:.3g} times as far as the things that the photographs show"
    return [Finding("warning", str(scene.path), what, _describe_cure(ratio))]


def _describe_cure(scale: float) -> str:
    """Says how points whose unit is `scale` of the poses' are mended."""
    return (
        f"multiply the points by {1 / scale:.3g}, or scale the poses' positions: both must be of "
        "one model"
    )


def _compare_spread(scene: Scene, evidence: Evidence) -> float | None:
    """Divides the median spread of the points by that of triangulated matches."""
    seen = evidence.triangulate()
    if len(seen) < FEWEST_SAMPLES:
        return None
    return _spread(scene.points) / max(_spread(seen), 1e-300)


def _spread(points: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


class _PointColors:
    """Compares the colours of some points with some photographs, as given or moved."""

    def __init__(self, scene: Scene) -> None:
        step = -(-len(scene.points) // ENOUGH_SAMPLES)
        self._points, self._colors = scene.points[::step], scene.point_colors[::step]
        self._scene = scene
        self._views = choose_evenly(range(len(scene)))
        self.given = self.correlate(np.eye(3))

    def correlate(self, change: np.ndarray) -> float:
        """Returns the median correlation of the points times a (3, 3) matrix; -1 if unseen."""
        moved = self._scene.replace(points=self._points @ change.T, point_colors=self._colors)
        found = [correlate_colors(moved, index) for index in self._views]
        known = [value for value in found if value is not None]
        return float(np.median(known)) if known else -1.0


def _try_scales(colors: _PointColors, scales: Sequence[float]) -> tuple[str, str] | None:
    """Tries other scales of the points; returns what is found of the best, and what to do."""
    value, scale = max((colors.correlate(np.eye(3) / each), each) for each in scales)
    if value < max(EXPECTED_R, colors.given + COLOR_GAIN):
        return None
    what = (
        f"the points' colours agree with the photographs at r = {value:.2f} if they are multiplied "
        f"by {1 / scale:.3g}, as they are at {colors.given:.2f}"
    )
    if scale in _UNITS:
        what += ": points are in {}, poses in {}?".format(*_UNITS[scale])
    return what, _describe_cure(scale)


def _try_axes(colors: _PointColors) -> tuple[str, str] | None:
    """Tries permuted and mirrored axes of the points; returns the same of the best."""
    axes = [each for each in list_signed_permutations() if not np.array_equal(each, np.eye(3))]
    value, text = max((colors.correlate(each), _name_axes(each)) for each in axes)
    if value < max(EXPECTED_R, colors.given + COLOR_GAIN):
        return None
    return (
        f"the points' colours agree with the photographs at r = {value:.2f} if their x, y, z are "
        f"read as {text}, as they are at {colors.given:.2f}",
        f"write the points' coordinates as {text}: they are in other axes than the poses",
    )


def _name_axes(axes: np.ndarray) -> str:
    """Writes a signed permutation as the coordinates it takes, such as "x, z, -y"."""
    columns = np.argmax(np.abs(axes), axis=1)
    signs = axes[np.arange(3), columns]
    return ", ".join(
        f"{'-' if s < 0 else ''}{'xyz'[c]}" for c, s in zip(columns, signs, strict=True)
    )
