"""Do the points lie where the cameras see them; and if not, in which unit or axes would they?"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.evidence import Evidence
from gsut.check.geometry import TOLERANCE
from gsut.data import Finding, Scene, has_colors, view_agreement
from gsut.sfm import angular_errors

_FEWEST = 30  # points, or triangulated matches
_UNITS = {
    1e-3: ("metres", "millimetres"),
    0.01: ("metres", "centimetres"),
    100.0: ("centimetres", "metres"),
    1e3: ("millimetres", "metres"),
}
_NEAR_UNIT = 2.5  # factor within which a ratio of distances is that of two units
_AGREE, _GAIN = 0.5, 0.2  # correlation of colours that agree, and how much more it must be
_VIEWS = 5
_MOST_POINTS = 20_000


def check_points_frame(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Points against poses that the photographs agree with.

    Args:
        scene: with points; in the dataset's coordinates.
        evidence: of the photographs; None where they say nothing.

    Returns:
        An error that names the unit or the axes in which the points would fit, or nothing.
    """
    if len(scene.points) < _FEWEST:
        return []
    where = str(scene.path)
    ratio = None if evidence is None else _spread_ratio(scene, evidence)
    colors = _Colors(scene) if has_colors(scene) else None
    if colors is not None and colors.given >= _AGREE:
        return []
    for unit in _UNITS:
        if colors is not None:
            value = colors.agreement(np.eye(3) / unit)
            if value >= max(_AGREE, colors.given + _GAIN):
                seen = f"the points' colours agree with the photographs at r = {value:.2f} if they "
                seen += f"are {'divided' if unit > 1 else 'multiplied'} by {max(unit, 1 / unit):g}"
                return [_in_unit(where, unit, f"{seen}, as they are at {colors.given:.2f}")]
        elif ratio is not None and 1 / _NEAR_UNIT < ratio / unit < _NEAR_UNIT:
            seen = f"the points spread {ratio:.3g} times as far as the things that the photographs"
            return [_in_unit(where, unit, f"{seen} show")]
    return [] if colors is None else _other_axes(colors, where)


def _in_unit(where: str, unit: float, seen: str) -> Finding:
    name, other = _UNITS[unit]
    return Finding(
        "error",
        where,
        f"{seen}: points are in {name}, poses in {other}?",
        f"{'divide' if unit > 1 else 'multiply'} the points by {max(unit, 1 / unit):g}, or scale "
        "the poses' positions",
    )


def _spread_ratio(scene: Scene, evidence: Evidence) -> float | None:
    """How much more the points spread than triangulated matches do, by medians."""
    matches, poses = evidence.matches, evidence.table.of_matches()
    errors = angular_errors(evidence.rays, poses)
    tolerance = TOLERANCE * matches.diagonal / 1000 / evidence.focal
    one, two = np.einsum("smij,smj->smi", poses[..., :3, :3], evidence.rays)
    base = poses[1, :, :3, 3] - poses[0, :, :3, 3]
    sine = np.linalg.norm(np.cross(one, two), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # the law of sines
        distance = np.linalg.norm(np.cross(base, two), axis=1) / sine
    good = (errors < tolerance) & (sine > 5 * tolerance) & np.isfinite(distance)
    if np.count_nonzero(good) < _FEWEST:
        return None
    seen = poses[0, good, :3, 3] + distance[good, None] * one[good]
    return _spread(scene.points) / max(_spread(seen), 1e-300)


def _spread(points: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


class _Colors:
    """How well the colours of some points agree with some photographs, the points moved or not."""

    def __init__(self, scene: Scene) -> None:
        step = -(-len(scene.points) // _MOST_POINTS)
        self._points, self._colors = scene.points[::step], scene.point_colors[::step]
        self._scene = scene
        self._views = np.unique(np.linspace(0, len(scene) - 1, _VIEWS).round().astype(int))
        self.given = self.agreement(np.eye(3))

    def agreement(self, change: np.ndarray) -> float:
        """Median correlation with the points multiplied by a (3, 3) matrix; -1: nothing is seen."""
        moved = self._scene.replace(points=self._points @ change.T, point_colors=self._colors)
        found = [_agreement(moved, int(index)) for index in self._views]
        known = [value for value in found if value is not None]
        return float(np.median(known)) if known else -1.0


def _other_axes(colors: _Colors, where: str) -> list[Finding]:
    """Axes permuted or mirrored, where the colours say so."""
    best = max((colors.agreement(axes), text) for text, axes in _axes())
    if best[0] < max(_AGREE, colors.given + _GAIN):
        return []
    return [
        Finding(
            "error",
            where,
            f"the points' colours agree with the photographs at r = {best[0]:.2f} if their x, y, z "
            f"are read as {best[1]}, as they are at {colors.given:.2f}",
            f"write the points' coordinates as {best[1]}: they are in other axes than the poses",
        )
    ]


def _agreement(scene: Scene, index: int) -> float | None:
    try:
        return view_agreement(scene, index)
    except InputError:
        return None


def _axes() -> Iterator[tuple[str, np.ndarray]]:
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            axes = np.eye(3)[list(order)] * np.array(signs)[:, None]
            names = [("-" if s < 0 else "") + "xyz"[a] for a, s in zip(order, signs, strict=True)]
            if not np.array_equal(axes, np.eye(3)):
                yield ", ".join(names), axes
