"""Checks whether points lie where the cameras see them, and if not, in which unit or axes."""

from __future__ import annotations

import math

import numpy as np

from gsut.check.colors import EXPECTED_R, correlate_colors
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.samples import FEWEST
from gsut.data import Scene
from gsut.data.points import has_colors
from gsut.judge import list_signed_permutations
from gsut.sampling import ENOUGH_SAMPLES, choose_evenly

_UNITS = {  # points' unit over the poses' -> names of both
    1e-3: ("metres", "millimetres"),
    0.01: ("metres", "centimetres"),
    100.0: ("centimetres", "metres"),
    1e3: ("millimetres", "metres"),
}
_NEAR_SCALES = 2.0 ** np.linspace(-2, 2, 17)  # times the ratio of spreads, which is inexact
_OTHER_SCALE = 30.0  # ratio of spreads that points far behind what matches show do not reach
_NEAR_UNIT = 2.5  # factor within which a ratio of distances counts as the ratio of two units
_COLOR_GAIN = 0.2  # correlation that another unit, or other axes, must gain


def check_points_frame(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Checks points against poses that the photographs agree with.

    Args:
        scene: with points; in the dataset's coordinates.
        evidence: of the photographs, or None if they share too few features.

    Returns:
        An error that names the unit or the axes in which the points would fit, or nothing.
    """
    if len(scene.points) < FEWEST:
        return []
    where = str(scene.path)
    ratio = None if evidence is None else _compare_spread(scene, evidence)
    colors = _PointColors(scene) if has_colors(scene) else None
    if colors is not None and colors.given >= EXPECTED_R:
        return []
    for unit in _UNITS:
        if colors is not None:
            value = colors.correlate(np.eye(3) / unit)
            if value >= max(EXPECTED_R, colors.given + _COLOR_GAIN):
                seen = f"the points' colours agree with the photographs at r = {value:.2f} if they "
                seen += f"are {'divided' if unit > 1 else 'multiplied'} by {max(unit, 1 / unit):g}"
                return [_name_unit(where, unit, f"{seen}, as they are at {colors.given:.2f}")]
        elif ratio is not None and 1 / _NEAR_UNIT < ratio / unit < _NEAR_UNIT:
            seen = f"the points spread {ratio:.3g} times as far as the things that the photographs"
            return [_name_unit(where, unit, f"{seen} show")]
    found = [] if colors is None else _try_other_axes(colors, where)
    return found or _try_other_scales(colors, ratio, where)


def _name_unit(where: str, unit: float, seen: str) -> Finding:
    name, other = _UNITS[unit]
    return Finding(
        "error",
        where,
        f"{seen}: points are in {name}, poses in {other}?",
        f"{'divide' if unit > 1 else 'multiply'} the points by {max(unit, 1 / unit):g}, or scale "
        "the poses' positions",
    )


def _compare_spread(scene: Scene, evidence: Evidence) -> float | None:
    """Divides the median spread of the points by that of triangulated matches."""
    seen = evidence.triangulate()
    if len(seen) < FEWEST:
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


def _try_other_axes(colors: _PointColors, where: str) -> list[Finding]:
    """Tries permuted and mirrored axes, and names those with which colours agree best."""
    axes = [each for each in list_signed_permutations() if not np.array_equal(each, np.eye(3))]
    value, text = max((colors.correlate(each), _name_axes(each)) for each in axes)
    if value < max(EXPECTED_R, colors.given + _COLOR_GAIN):
        return []
    return [
        Finding(
            "error",
            where,
            f"the points' colours agree with the photographs at r = {value:.2f} if their x, y, z "
            f"are read as {text}, as they are at {colors.given:.2f}",
            f"write the points' coordinates as {text}: they are in other axes than the poses",
        )
    ]


def _try_other_scales(
    colors: _PointColors | None, ratio: float | None, where: str
) -> list[Finding]:
    """Tries scales that are no unit's, about that of the matches; without these says nothing."""
    if ratio is None or 1 / _OTHER_SCALE < ratio < _OTHER_SCALE:
        return []
    severity, scale = "warning", ratio
    what = f"the points spread {ratio:.3g} times as far as the things that the photographs show"
    if colors is not None:
        scales = [10.0 ** round(math.log10(ratio)), *(ratio * _NEAR_SCALES)]
        value, found = max((colors.correlate(np.eye(3) / each), each) for each in scales)
        if value >= max(EXPECTED_R, colors.given + _COLOR_GAIN):
            severity, scale = "error", found
            what += f", and their colours agree at r = {value:.2f} if they are multiplied by "
            what += f"{1 / scale:.3g}, as they are at {colors.given:.2f}"
    advice = f"multiply the points by {1 / scale:.3g}, or scale the poses' positions: both must be "
    return [Finding(severity, where, what, f"{advice}of one model")]


def _name_axes(axes: np.ndarray) -> str:
    """Writes a signed permutation as the coordinates it takes, such as "x, z, -y"."""
    columns = np.argmax(np.abs(axes), axis=1)
    signs = axes[np.arange(3), columns]
    return ", ".join(
        f"{'-' if s < 0 else ''}{'xyz'[c]}" for c, s in zip(columns, signs, strict=True)
    )
