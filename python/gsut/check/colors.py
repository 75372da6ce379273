"""Compares the colours of points with the pixels that show them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

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
    seen = {view: each for view in views if (each := see_points(scene, view)) is not None}
    agreed, where = correlate_colors(seen.values()), str(scene.path)
    swapped = correlate_colors(np.stack([point[:, ::-1], pixel]) for point, pixel in seen.values())
    is_swapped = swapped > max(agreed, 0.0) + COLOR_GAIN
    if agreed >= EXPECTED_R:
        what = f"colours of the points agree with the pixels at r = {agreed:.2f}"
        yield Finding("info", where, what)
        yield from _name_doubtful(scene, seen)
        yield from _check_exposure(scene, seen)
    if is_swapped:
        yield Finding(
            "warning", where,
            f"colours of points and photographs agree at r = {swapped:.2f} with red and blue "
            f"swapped in one of them, as they are at {agreed:.2f}",
            "one of both was written as BGR (OpenCV's order): convert it with "
            "cv2.cvtColor(image, cv2.COLOR_BGR2RGB)",
        )  # fmt: skip
    elif agreed == -1:  # the cameras may look elsewhere
        yield Finding("info", where, "too few points fall into the images to compare colours")
    elif agreed < EXPECTED_R:
        found = f"colours of the points agree with the pixels only at r = {agreed:.2f}; expected >"
        yield Finding(
            "warning", where, f"{found} {EXPECTED_R}",
            "poses, lens or points may use another convention: check them; a cloud in "
            "a frame of its own is placed by `gsut align CLOUD DATA -o NEW`",
        )  # fmt: skip


def _name_doubtful(scene: Scene, seen: Mapping[int, _Colors]) -> Iterator[Finding]:
    """Names views whose pixels hardly agree with the points that others agree with."""
    found = {view: correlate_colors([each]) for view, each in seen.items()}
    bad = [view for view, r in found.items() if -1 < r < EXPECTED_R / 2]
    if bad:
        names = list_some([f"{scene.views[view].name} ({found[view]:.2f})" for view in bad])
        what = f"{len(bad)} views disagree with the points' colours: {names}"
        yield Finding("warning", str(scene.path), what, "their poses may be wrong")


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


def correlate_colors(seen: Iterable[_Colors]) -> float:
    """Returns the median correlation of points and pixels; -1 if there is none."""
    known = [float(np.corrcoef(*each.reshape(2, -1))[0, 1]) for each in seen
             if each.std(axis=(1, 2)).all()]  # fmt: skip
    return float(np.median(known)) if known else -1.0


def see_points(scene: Scene, index: int) -> _Colors | None:
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
