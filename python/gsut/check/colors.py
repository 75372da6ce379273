"""Compares the colours of points with the pixels that they project to.

Of all points that fall into one cell of an image only the nearest counts, since it may hide the
others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding
from gsut.check.samples import FEWEST, choose_views
from gsut.data import Scene, list_some
from gsut.run import Progress

EXPECTED_R = 0.5  # correlation; good real data reach 0.7 to 0.95
_LEAST_VIEW_R = 0.25  # correlation below which a single view is suspect if the others are good
_ORDER_GAIN = 0.03  # correlation gained by another order of colours that is worth a warning
_CELLS = 48  # cells along the image's longer side: fine enough that few points are thinned out


def check_colors(scene: Scene, *, progress: bool = True) -> Iterator[Finding]:
    """Correlates the colours of projected points with the pixels of some views.

    Args:
        scene: at full size, with coloured points; yields nothing otherwise.
        progress: show a bar.
    """
    if len(scene.points) < FEWEST or np.ptp(scene.point_colors) == 0:
        return
    chosen = choose_views(range(len(scene)))
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
        if agreed is None:  # the cameras may look elsewhere
            what = "too few points fall into the images to compare colours"
            yield Finding("info", where, what)
            return
        found = f"colours of the points agree with the pixels only at r = {agreed:.2f}; expected >"
        yield Finding(
            "warning", where, f"{found} {EXPECTED_R}",
            "poses, lens or points may use another convention: check them; a cloud in "
            "a frame of its own is placed by `gsut align CLOUD DATA -o NEW`",
        )  # fmt: skip
        return
    yield Finding("info", where, f"colours of the points agree with the pixels at r = {agreed:.2f}")
    bad = [f"{scene.views[i].name} ({r:.2f})" for i, r in per_view.items() if r < _LEAST_VIEW_R]
    if bad:
        what = f"{len(bad)} views disagree with the points' colours: {list_some(bad)}"
        yield Finding("warning", where, what, "their poses may be wrong")
    yield from _check_channels(scene, chosen, agreed)


def _check_channels(scene: Scene, views: list[int], agreed: float) -> Iterator[Finding]:
    """Checks whether the colours agree better with red and blue swapped (OpenCV's BGR)."""
    swapped = scene.replace(points=scene.points, point_colors=scene.point_colors[:, ::-1])
    value = _take_median(correlate_colors(swapped, index) for index in views)
    if value is not None and value > agreed + _ORDER_GAIN:
        yield Finding(
            "warning",
            str(scene.path),
            f"colours of points and photographs agree at r = {value:.2f} with red and blue swapped "
            f"in one of them, as they are at {agreed:.2f}",
            "one of both was written as BGR (OpenCV's order): convert it with "
            "cv2.cvtColor(image, cv2.COLOR_BGR2RGB)",
        )


def _take_median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def correlate_colors(scene: Scene, index: int) -> float | None:
    """Correlates the colours of points and pixels in one view.

    Returns:
        The correlation, or None with too few points or an unreadable photograph.
    """
    seen = _see_points(scene, index)
    return None if seen is None else seen.correlate()


@dataclasses.dataclass(frozen=True)
class _SeenPoints:
    """Points as one view sees them, the nearest first.

    Args:
        colors: (N, 3) of the points.
        pixels: (N, 2) where they are seen.
        image, mask: of the view.
    """

    colors: np.ndarray
    pixels: np.ndarray
    image: np.ndarray
    mask: np.ndarray

    def correlate(self) -> float | None:
        """Correlates colours of points and pixels; None with too few points."""
        height, width = self.mask.shape
        longer = max(width, height)
        x, y = np.floor(self.pixels).T.astype(int)
        rows = np.flatnonzero((x >= 0) & (y >= 0) & (x < width) & (y < height))
        rows = rows[self.mask[y[rows], x[rows]]]
        cell = (y[rows] * _CELLS // longer) * (_CELLS + 1) + x[rows] * _CELLS // longer
        nearest = np.full((_CELLS + 1) ** 2, -1)
        nearest[cell[::-1]] = rows[::-1]  # the last one written to a cell stays: the nearest
        first = nearest[nearest >= 0]
        if len(first) < FEWEST:
            return None
        points = self.colors[first].astype(np.float64).ravel()
        seen = self.image[y[first], x[first]].astype(np.float64).ravel()
        if points.std() == 0 or seen.std() == 0:
            return None
        return float(np.corrcoef(points, seen)[0, 1])


def _see_points(scene: Scene, index: int) -> _SeenPoints | None:
    """Projects the points into a view; None if its photograph cannot be read."""
    camera = scene.camera(index)
    try:
        image, mask = scene.image(index), scene.mask(index)
    except InputError:
        return None
    pose = scene.views[index].camera_from_world
    relative = scene.points @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(relative)
    rows = np.flatnonzero(np.asarray(valid, bool))
    rows = rows[np.argsort(np.linalg.norm(relative[rows], axis=1), kind="stable")]
    return _SeenPoints(scene.point_colors[rows], pixels[rows], image, mask)
