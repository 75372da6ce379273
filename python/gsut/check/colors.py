"""Compares the colours of points with the pixels that they project to.

Of all points that fall into one cell of an image only the nearest counts, since it may hide the
others. Where colours disagree, other readings of the poses are tried, and the best is named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding
from gsut.check.readings import list_usual_readings
from gsut.data import Scene, list_some
from gsut.data.poses import invert_pose
from gsut.run import Progress

EXPECTED_R = 0.5  # correlation; good real data reach 0.7 to 0.95
_LEAST_VIEW_R = 0.25  # correlation below which a single view is suspect if the others are good
_READING_GAIN = 0.2  # correlation gained by another reading of the poses that is worth naming
_LENS_GAIN = 0.03  # correlation gained by another lens, or order of colours, worth a warning
_CELLS = 48  # cells along the image's longer side: fine enough that few points are thinned out
_VIEWS_TESTED = 16  # views: enough for a stable median
_FEWEST_POINTS = 30  # in a view; the correlation of fewer means little
_FOCAL_FACTORS = (0.75, 0.85, 0.93, 1.07, 1.18, 1.33)  # wrong focal lengths found in practice
_CENTER_SHIFT = 0.03  # of the image's longer side: how far the principal point is moved on trial


def check_colors(
    scene: Scene, *, views: int = _VIEWS_TESTED, progress: bool = True
) -> Iterator[Finding]:
    """Correlates the colours of projected points with the pixels of some views.

    Args:
        scene: at full size, with coloured points; yields nothing otherwise.
        views: the number of views examined.
        progress: show a bar.
    """
    if len(scene.points) < _FEWEST_POINTS or np.ptp(scene.point_colors) == 0:
        return
    chosen = np.unique(np.linspace(0, len(scene) - 1, views).round().astype(int)).tolist()
    per_view = {}
    for index in Progress(progress).iterate("colours", chosen):
        r = correlate_colors(scene, index)
        if r is not None:
            per_view[index] = r
    where = str(scene.path)
    agreed = _take_median(per_view.values())
    if agreed is None or agreed < EXPECTED_R:
        swapped = list(_check_channels(scene, chosen, agreed or 0.0))
        if swapped:
            yield swapped[0]
            return
        better = _name_better_reading(scene, chosen, agreed)
        if agreed is None and better is None:  # the cameras may look elsewhere
            what = "too few points fall into the images to compare colours"
            yield Finding("info", where, what)
            return
        found = (
            "too few points fall into the images to compare colours"
            if agreed is None
            else f"colours of the points agree with the pixels only at r = {agreed:.2f}; expected >"
            f" {EXPECTED_R}"
        )
        what = f"poses or lens may use another convention: {found}"
        none = "no other reading of the poses agrees better: check the lens and its distortion"
        yield Finding("warning", where, what, better or none)
        return
    yield Finding("info", where, f"colours of the points agree with the pixels at r = {agreed:.2f}")
    bad = [f"{scene.views[i].name} ({r:.2f})" for i, r in per_view.items() if r < _LEAST_VIEW_R]
    if bad:
        what = f"{len(bad)} views disagree with the points' colours: {list_some(bad)}"
        yield Finding("warning", where, what, "their poses may be wrong")
    yield from _check_channels(scene, chosen, agreed)
    yield from _check_lens(scene, chosen, agreed)


def _check_channels(scene: Scene, views: list[int], agreed: float) -> Iterator[Finding]:
    """Checks whether the colours agree better with red and blue swapped (OpenCV's BGR)."""
    swapped = scene.replace(points=scene.points, point_colors=scene.point_colors[:, ::-1])
    value = _take_median(correlate_colors(swapped, index) for index in views)
    if value is not None and value > agreed + _LENS_GAIN:
        yield Finding(
            "warning",
            str(scene.path),
            f"colours of points and photographs agree at r = {value:.2f} with red and blue swapped "
            f"in one of them, as they are at {agreed:.2f}",
            "one of both was written as BGR (OpenCV's order): convert it with "
            "cv2.cvtColor(image, cv2.COLOR_BGR2RGB)",
        )


def _check_lens(scene: Scene, views: list[int], agreed: float) -> Iterator[Finding]:
    """Tries other focal lengths and principal points, and names the one that agrees best."""
    trials = {f"focal lengths times {scale:g}": (scale, np.zeros(2)) for scale in _FOCAL_FACTORS}
    for name, shift in (("cx", np.array([1.0, 0.0])), ("cy", np.array([0.0, 1.0]))):
        for part in (-_CENTER_SHIFT, _CENTER_SHIFT):
            trials[f"{name} moved by {part:+.1%} of the image's longer side"] = (1, part * shift)
    better = {}
    seen = [each for each in (_see_points(scene, index) for index in views) if each is not None]
    for name, (scale, shift) in trials.items():
        value = _take_median(each.correlate(scale, shift) for each in seen)
        if value is not None and value > agreed + _LENS_GAIN:
            better[value] = name
    if better:
        best = max(better)
        yield Finding(
            "warning",
            str(scene.path),
            f"colours of the points agree better with another lens: r = {best:.2f} with"
            f" {better[best]} against {agreed:.2f}",
            "check lens model, focal length and principal point, and that images are not cropped",
        )


def _take_median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _name_better_reading(scene: Scene, views: Sequence[int], agreed: float | None) -> str | None:
    """Names the reading of the poses with which colours agree best; None if none is far better."""
    scene = scene.move_origin((0.0, 0.0, 0.0))
    table = np.array([invert_pose(view.camera_from_world) for view in scene.views])[:, None]
    best, best_r = "", max((agreed or 0) + _READING_GAIN, EXPECTED_R)
    for reading in list_usual_readings(scene, table):
        poses = {index: invert_pose(reading.poses[index, 0]) for index in views}
        value = _take_median(correlate_colors(scene, index, poses[index]) for index in views)
        if value is not None and value > best_r:
            best, best_r = reading.name, value
    return f"they agree at r = {best_r:.2f} if the poses are {best}" if best else None


def correlate_colors(
    scene: Scene, index: int, camera_from_world: np.ndarray | None = None
) -> float | None:
    """Correlates the colours of points and pixels in one view.

    Args:
        scene: with points.
        index: of the view.
        camera_from_world: (4, 4) the pose; None: the view's own.

    Returns:
        The correlation, or None with too few points or an unreadable photograph.
    """
    seen = _see_points(scene, index, camera_from_world)
    return None if seen is None else seen.correlate()


@dataclasses.dataclass(frozen=True)
class _SeenPoints:
    """Points as one view sees them, the nearest first.

    Args:
        colors: (N, 3) of the points.
        away: (N, 2) pixels from the optical axis, which lies at `axis` (2,).
        image, mask: of the view.
    """

    colors: np.ndarray
    away: np.ndarray
    axis: np.ndarray
    image: np.ndarray
    mask: np.ndarray

    def correlate(self, scale: float = 1.0, shift: np.ndarray | float = 0.0) -> float | None:
        """Correlates colours of points and pixels; None with too few points.

        Args:
            scale: factor on the pixels' distance from the optical axis.
            shift: (2,) moves the pixels by this share of the image's longer side.
        """
        height, width = self.mask.shape
        longer = max(width, height)
        x, y = np.floor(self.axis + scale * self.away + np.multiply(shift, longer)).T.astype(int)
        rows = np.flatnonzero((x >= 0) & (y >= 0) & (x < width) & (y < height))
        rows = rows[self.mask[y[rows], x[rows]]]
        cell = (y[rows] * _CELLS // longer) * (_CELLS + 1) + x[rows] * _CELLS // longer
        nearest = np.full((_CELLS + 1) ** 2, -1)
        nearest[cell[::-1]] = rows[::-1]  # the last one written to a cell stays: the nearest
        first = nearest[nearest >= 0]
        if len(first) < _FEWEST_POINTS:
            return None
        points = self.colors[first].astype(np.float64).ravel()
        seen = self.image[y[first], x[first]].astype(np.float64).ravel()
        if points.std() == 0 or seen.std() == 0:
            return None
        return float(np.corrcoef(points, seen)[0, 1])


def _see_points(
    scene: Scene, index: int, camera_from_world: np.ndarray | None = None
) -> _SeenPoints | None:
    """Projects the points into a view; None if its photograph cannot be read."""
    camera = scene.camera(index)
    try:
        image, mask = scene.image(index), scene.mask(index)
    except InputError:
        return None
    pose = scene.views[index].camera_from_world if camera_from_world is None else camera_from_world
    relative = scene.points @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(relative)
    axis = camera.project(np.array([[0.0, 0.0, 1.0]]))[0][0]
    rows = np.flatnonzero(np.asarray(valid, bool))
    rows = rows[np.argsort(np.linalg.norm(relative[rows], axis=1), kind="stable")]
    return _SeenPoints(scene.point_colors[rows], pixels[rows] - axis, axis, image, mask)
