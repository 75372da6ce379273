"""Compares the colours of points with the pixels that show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gsut._core import InputError
from gsut.check.findings import Finding
from gsut.data import Scene, list_some
from gsut.data.scene import find_visible_points
from gsut.run import Progress
from gsut.sampling import FEWEST_SAMPLES, choose_evenly

EXPECTED_R = 0.5  # correlation; good real data reach 0.7 to 0.95
_STOPS = 0.7  # photographic stops by which a view may be brighter or darker than the others
COLOR_GAIN = 0.1  # of the correlation, by another order of colours, unit or axes of the points

_Colors = np.ndarray  # (2, N, 3) of points, and of the pixels that show them


def check_colors(scene: Scene, *, progress: bool = True) -> Iterator[Finding]:
    """Correlates the colours of projected points with the pixels of some views.

    Args:
        scene: at full size, with coloured points; yields nothing otherwise.
        progress: show a bar.
    """
    if len(scene.points) < FEWEST_SAMPLES or np.ptp(scene.point_colors) == 0:
        return
    views = Progress(progress).iterate("colours", choose_evenly(range(len(scene))))
    seen = {view: each for view in views if (each := _see_points(scene, view)) is not None}
    per_view = {view: r for view, each in seen.items() if (r := _correlate(each)) is not None}
    where = str(scene.path)
    agreed = float(np.median(list(per_view.values()))) if per_view else None
    if agreed is None or agreed < EXPECTED_R:
        swapped = list(_check_channels(scene, seen, agreed or 0.0))
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
    bad = [view for view, r in per_view.items() if r < EXPECTED_R / 2]
    if bad:
        names = list_some([f"{scene.views[view].name} ({per_view[view]:.2f})" for view in bad])
        what = f"{len(bad)} views disagree with the points' colours: {names}"
        yield Finding("warning", where, what, "their poses may be wrong")
    yield from _check_exposure(scene, seen)
    yield from _check_channels(scene, seen, agreed)


def _check_channels(scene: Scene, seen: Mapping[int, _Colors], agreed: float) -> Iterator[Finding]:
    """Checks whether the colours agree better with red and blue swapped (OpenCV's BGR)."""
    swapped = [_correlate(np.stack([point[:, ::-1], pixel])) for point, pixel in seen.values()]
    value = float(np.median([r for r in swapped if r is not None] or [-1.0]))
    if value > agreed + COLOR_GAIN:
        yield Finding(
            "warning",
            str(scene.path),
            f"colours of points and photographs agree at r = {value:.2f} with red and blue swapped "
            f"in one of them, as they are at {agreed:.2f}",
            "one of both was written as BGR (OpenCV's order): convert it with "
            "cv2.cvtColor(image, cv2.COLOR_BGR2RGB)",
        )


def _check_exposure(scene: Scene, seen: Mapping[int, _Colors]) -> Iterator[Finding]:
    """Names views in which points are far brighter or darker than in the others."""
    stops = {}
    for view, each in seen.items():
        point, pixel = np.maximum(each.mean(axis=2), 1.0)
        stops[view] = float(np.median(np.log2(pixel / point)))
    usual = np.median(list(stops.values()))
    far = [view for view, each in stops.items() if abs(each - usual) > _STOPS]
    if far:
        names = list_some([scene.views[view].name for view in far])
        yield Finding(
            "warning",
            str(scene.path),
            f"{len(far)} of {len(stops)} views show the points more than {_STOPS} stops brighter "
            f"or darker than the median view: {names}",
            "photograph with fixed exposure, or train with per-image colour correction",
        )


def correlate_colors(scene: Scene, index: int) -> float | None:
    """Correlates the colours of points and pixels in one view.

    Returns:
        The correlation, or None with too few points or an unreadable photograph.
    """
    seen = _see_points(scene, index)
    return None if seen is None else _correlate(seen)


def _correlate(seen: _Colors) -> float | None:
    if seen[0].std() == 0 or seen[1].std() == 0:
        return None
    return float(np.corrcoef(seen[0].ravel(), seen[1].ravel())[0, 1])


def _see_points(scene: Scene, index: int) -> _Colors | None:
    """Returns colours of points and of a view's pixels (2, N, 3); None with too few of them."""
    try:
        image = scene.image(index)
        rows, places, _ = find_visible_points(scene, index, scene.points)
    except InputError:
        return None
    if len(rows) < FEWEST_SAMPLES:
        return None
    x, y = (places * image.shape[1::-1]).astype(int).T
    return np.stack([scene.point_colors[rows], image[y, x]]).astype(np.float64)
