"""The doctor's best test of poses and lens: do points have the colours of the pixels they fall on?

Points that hide behind others are thinned out: of all that fall into one cell of an image only the
nearest counts. If the agreement is low, other readings of the poses are tried and the best named.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from gsut._core import InputError
from gsut.data.findings import Finding, some_names
from gsut.data.poses import OPENGL_FROM_OPENCV, inverse
from gsut.data.scene import Scene
from gsut.run import Progress

EXPECTED_R = 0.5  # correlation; good real data reach 0.7 to 0.95
VIEW_R = 0.25  # a single view this low among good ones is suspect
CELLS = 48  # cells along the image's longer side
VIEWS_TESTED = 16
LENS_SHIFT = (
    0.03  # share of the image's longer side by which the principal point is tried elsewhere
)
LENS_GAIN = 0.03  # better correlation with another lens that is worth a warning
MIN_SAMPLES = 30  # points a view; fewer say nothing

# A reading takes camera_from_world as loaded and the world's offset, and gives another one.
PoseReading = Callable[[np.ndarray, np.ndarray], np.ndarray]
_D = OPENGL_FROM_OPENCV


def _as_is(pose: np.ndarray, offset: np.ndarray) -> np.ndarray:
    return pose


def _world_from_camera(pose: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pose as it was taken from the file, and dataset_from_scene."""
    moved = np.eye(4)
    moved[:3, 3] = offset
    return inverse(pose @ inverse(moved)), moved


def _inverted(before: np.ndarray, after: np.ndarray) -> PoseReading:
    """The file's matrix is camera_from_world itself, up to flipped axes on either side."""

    def read(pose: np.ndarray, offset: np.ndarray) -> np.ndarray:
        world_from_camera, moved = _world_from_camera(pose, offset)
        return before @ world_from_camera @ after @ moved

    return read


READINGS: tuple[tuple[str, PoseReading], ...] = (
    (
        "with the camera's y and z axes flipped (OpenGL against OpenCV)",
        lambda pose, offset: _D @ pose,
    ),
    ("as world-to-camera instead of camera-to-world", _inverted(np.eye(4), np.eye(4))),
    ("as world-to-camera with OpenCV axes", _inverted(np.eye(4), _D)),
    ("as world-to-camera with OpenGL axes", _inverted(_D, _D)),
)


def check_colors(
    scene: Scene, *, views: int = VIEWS_TESTED, progress: bool = True
) -> Iterator[Finding]:
    """Correlates the colours of projected points with the pixels, over some views.

    Args:
        scene: at full size, with coloured points; nothing is found otherwise.
        views: how many are looked at.
        progress: show a bar.
    """
    if len(scene.points) < MIN_SAMPLES or np.ptp(scene.point_colors) == 0:
        return
    chosen = np.unique(np.linspace(0, len(scene) - 1, views).round().astype(int))
    per_view = {}
    for index in Progress(progress).through("colours", chosen.tolist()):
        r = view_agreement(scene, int(index), _as_is)
        if r is not None:
            per_view[int(index)] = r
    where, tested = str(scene.path), [int(index) for index in chosen]
    agreed = _median(per_view.values())
    if agreed is None or agreed < EXPECTED_R:
        found = (
            "too few points fall into the images to compare colours"
            if agreed is None
            else f"colours of the points agree with the pixels only at r = {agreed:.2f}; expected >"
            f" {EXPECTED_R}"
        )
        yield Finding(
            "warning",
            where,
            f"poses or lens may use another convention: {found}",
            _better_reading(scene, tested, agreed),
        )
        return
    yield Finding("info", where, f"colours of the points agree with the pixels at r = {agreed:.2f}")
    bad = [f"{scene.views[i].name} ({r:.2f})" for i, r in per_view.items() if r < VIEW_R]
    if bad:
        yield Finding(
            "warning",
            where,
            f"{len(bad)} views disagree with the points' colours: {some_names(bad)}",
            "their poses may be wrong",
        )
    yield from _check_lens(scene, tested, agreed)


def _check_lens(scene: Scene, views: list[int], agreed: float) -> Iterator[Finding]:
    """Would the points agree better with another focal length or principal point?"""
    trials = {
        f"focal lengths times {scale:g}": (scale, np.zeros(2))
        for scale in (0.75, 0.85, 0.93, 1.07, 1.18, 1.33)
    }
    for name, shift in (("cx", np.array([1.0, 0.0])), ("cy", np.array([0.0, 1.0]))):
        for sign in (-1, 1):
            part = sign * LENS_SHIFT
            trials[f"{name} moved by {part:+.1%} of the image's longer side"] = (1, part * shift)
    better = {}
    seen = [each for each in (_seen(scene, index, _as_is) for index in views) if each is not None]
    for name, (scale, shift) in trials.items():
        value = _median(each.agreement(scale, shift) for each in seen)
        if value is not None and value > agreed + LENS_GAIN:
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


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _better_reading(scene: Scene, views: list[int], agreed: float | None) -> str:
    best, best_r = "", max((agreed or 0) + 0.2, EXPECTED_R)
    for name, reading in READINGS:
        value = _median(view_agreement(scene, i, reading) for i in views)
        if value is not None and value > best_r:
            best, best_r = name, value
    if best:
        return f"they agree at r = {best_r:.2f} if the poses are read {best}"
    return "no other reading of the poses agrees better: check the lens and its distortion"


def view_agreement(scene: Scene, index: int, reading: PoseReading = _as_is) -> float | None:
    """Correlation of point and pixel colours in one view, or None with too few points.

    Args:
        scene: with points.
        index: of the view.
        reading: turns the pose into another reading of the same file.
    """
    seen = _seen(scene, index, reading)
    return None if seen is None else seen.agreement()


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

    def agreement(self, scale: float = 1.0, shift: np.ndarray | float = 0.0) -> float | None:
        """Correlation of colours, or None with too few points.

        Args:
            scale: factor on the pixels' distance from the optical axis.
            shift: (2,) moves the pixels by this share of the image's longer side.
        """
        height, width = self.mask.shape
        longer = max(width, height)
        x, y = np.floor(self.axis + scale * self.away + np.multiply(shift, longer)).T.astype(int)
        rows = np.flatnonzero((x >= 0) & (y >= 0) & (x < width) & (y < height))
        rows = rows[self.mask[y[rows], x[rows]]]
        cell = (y[rows] * CELLS // longer) * (CELLS + 1) + x[rows] * CELLS // longer
        nearest = np.full((CELLS + 1) ** 2, -1)
        nearest[cell[::-1]] = rows[::-1]  # of a cell the last that is written stays
        first = nearest[nearest >= 0]
        if len(first) < MIN_SAMPLES:
            return None
        points = self.colors[first].astype(np.float64).ravel()
        seen = self.image[y[first], x[first]].astype(np.float64).ravel()
        if points.std() == 0 or seen.std() == 0:
            return None
        return float(np.corrcoef(points, seen)[0, 1])


def _seen(scene: Scene, index: int, reading: PoseReading) -> _SeenPoints | None:
    """The points that have an image in a view; None where its photograph cannot be read."""
    camera = scene.camera(index)
    try:
        image, mask = scene.image(index), scene.mask(index)
    except InputError:
        return None
    pose = reading(scene.views[index].camera_from_world, scene.world_offset)
    relative = scene.points @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(relative)
    axis = camera.project(np.array([[0.0, 0.0, 1.0]]))[0][0]
    rows = np.flatnonzero(np.asarray(valid, bool))
    rows = rows[np.argsort(np.linalg.norm(relative[rows], axis=1), kind="stable")]
    return _SeenPoints(scene.point_colors[rows], pixels[rows] - axis, axis, image, mask)
