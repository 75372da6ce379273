"""Checks whether points lie where the cameras see them, and if not, in which unit or axes."""

from __future__ import annotations

import math

import numpy as np

from gsut.check.colors import COLOR_GAIN, EXPECTED_R, correlate_colors, see_points
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.data import Scene
from gsut.data.points import has_colors
from gsut.judge import TINY, list_signed_permutations
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
    seen = np.zeros((0, 3)) if evidence is None else evidence.triangulate()
    ratio = None
    if len(seen) >= FEWEST_SAMPLES:
        spread = _spread(scene.points) / max(_spread(seen), TINY)
        ratio = None if 1 / _OTHER_SCALE < spread < _OTHER_SCALE else spread
    if has_colors(scene):
        given = _correlate(scene, np.eye(3))
        if given >= EXPECTED_R:
            return []
        for changes in (_list_scales(ratio), _list_axes()):
            r = [_correlate(scene, matrix) for matrix, _, _ in changes]
            best = int(np.argmax(r))
            if r[best] >= max(EXPECTED_R, given + COLOR_GAIN):
                _, words, cure = changes[best]
                what = f"the points' colours agree with the photographs at r = {r[best]:.2f} if "
                what += f"{words}, as they are at {given:.2f}"
                return [Finding("error", str(scene.path), what, cure)]
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


def _spread(points: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _correlate(scene: Scene, change: np.ndarray) -> float:
    """Returns how some points' colours agree with some photographs, if they are changed."""
    some = slice(None, None, -(-len(scene.points) // ENOUGH_SAMPLES))
    moved = scene.replace(
        points=scene.points[some] @ change.T, point_colors=scene.point_colors[some]
    )
    seen = (see_points(moved, view) for view in choose_evenly(range(len(scene))))
    return correlate_colors(each for each in seen if each is not None)


def _list_scales(ratio: float | None) -> list[tuple[np.ndarray, str, str]]:
    """Lists other units and, near a ratio of spreads, scales: matrices, in words, and cures."""
    scales = [*_UNITS]
    if ratio is not None:
        scales += [10.0 ** round(math.log10(ratio)), *(ratio * _NEAR_SCALES)]
    found = []
    for scale in scales:
        cure = _describe_cure(scale)
        if scale in _UNITS:
            cure += "; points are in {}, poses in {}?".format(*_UNITS[scale])
        found.append((np.eye(3) / scale, f"they are multiplied by {1 / scale:.3g}", cure))
    return found


def _list_axes() -> list[tuple[np.ndarray, str, str]]:
    """Lists permuted and mirrored axes of the points: matrices, in words, and cures."""
    found = []
    for axes in list_signed_permutations():
        if not np.array_equal(axes, np.eye(3)):
            name = _name_axes(axes)
            cure = f"write the points' coordinates as {name}: they are in other axes than the poses"
            found.append((axes, f"their x, y, z are read as {name}", cure))
    return found


def _name_axes(axes: np.ndarray) -> str:
    """Writes a signed permutation as the coordinates it takes, such as "x, z, -y"."""
    columns = np.argmax(np.abs(axes), axis=1)
    signs = axes[np.arange(3), columns]
    return ", ".join(
        f"{'-' if s < 0 else ''}{'xyz'[c]}" for c, s in zip(columns, signs, strict=True)
    )
