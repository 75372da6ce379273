"""Finds a sky to seed far away, where photographs show one that has no points.

A direction from the cameras' middle belongs to a sky if no point lies near it in any photograph
that sees it, and if these photographs show one colour there. White walls do that, too. So
photographs must agree far better when most of these directions are taken for far than at the
distance of the points: then their light does come from afar. A sky without clouds cannot show that.
It is one if all of it is above the cameras, and if what any photograph shows empty of points is
mostly so in all of them when it is taken for far away: a near wall moves before the points around
it.
"""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.sampling import ENOUGH_SAMPLES

# Number of directions, evenly over the sphere, 2.6 degrees apart: a sky is smooth.
_DIRECTIONS = 6000
# Photographs that are compared, evenly chosen; more cost time only.
_MOST_VIEWS = 30
# Longer side of the compared photographs in pixels: enough for directions that far apart.
_LONGER_SIDE = 240
# Photographs that must see a direction: two agree by chance.
_SEEN_BY = 3
# Distance within which a point is near, x the photograph's longer side: the gaps between points.
_GAP = 0.035
# Standard deviation of one colour, values in [0, 1]: noise and exposure.
_ALIKE = 0.06
# Standard deviation over all directions, values in [0, 1], below which a sky has no clouds.
_PLAIN = 0.03
# Percentile of the heights of a plain sky's directions that lies above the cameras.
_LOWEST = 2.0
# Distance of a sky, x the distance of the points: parallax there is below a pixel.
SKY_DISTANCE = 10.0
# Percentile of the points' distances that counts as their distance: some lie far off by mistake.
_PERCENT = 99.0
# Standard deviation of colours at the points' distance that noise explains, values in [0, 1].
_NOISE = 0.01
# Share of that deviation below which light comes from afar.
_LEFT_OVER = 0.5
# Fewest directions that are worth seeding.
_FEWEST = 50


def find_sky(scene: Scene) -> tuple[np.ndarray, np.ndarray] | None:
    """Finds points to seed a sky from.

    Args:
        scene: as it is trained on; only its training photographs are used.

    Returns:
        Points (N, 3) in the scene's coordinates, ten times as far as the scene's own, and colours
        (N, 3) uint8. None if the photographs do not clearly show a sky without points.
    """
    rows = scene.train_indices[:: -(-len(scene.train_indices) // _MOST_VIEWS)]
    if not len(scene.points) or len(rows) < _SEEN_BY:
        return None
    longest = max(max(camera.width, camera.height) for camera in scene.cameras)
    small = scene.scale_images(min(1.0, _LONGER_SIDE / longest), decodes_small=True)
    points = scene.points[:: -(-len(scene.points) // ENOUGH_SAMPLES)]
    middle = np.mean([scene.views[row].camera_center for row in rows], axis=0)
    far = middle + SKY_DISTANCE * measure_reach(points, middle) * _spread_directions()
    seen, (taken, empty) = np.zeros(len(far), int), np.zeros((2, len(far)), bool)
    near_points = {row: _mark_near_points(small, row, points) for row in rows}
    for row in rows:
        directions, x, y = _project_into(small, row, far)
        seen[directions] += 1
        near = near_points[row][y, x]
        taken[directions[near]], empty[directions[~near]] = True, True
    often = seen >= _SEEN_BY
    stays = 2 * np.count_nonzero(often & ~taken) > np.count_nonzero(often & empty)
    far = far[often & ~taken]
    if len(far) < _FEWEST:
        return None
    colors, apart = _average_colors(small, near_points, far)
    alike = apart < _ALIKE
    far, colors = far[alike], colors[alike]
    if len(far) < _FEWEST:
        return None
    if colors.std(axis=0).mean() < _PLAIN:
        up = -np.sum([scene.views[row].camera_from_world[1, :3] for row in rows], axis=0)
        if not stays or np.percentile((far - middle) @ up, _LOWEST) <= 0:
            return None
    else:
        near = middle + (1 / SKY_DISTANCE) * (far - middle)  # where the points are
        of_near, of_far = _average_colors(small, near_points, near)[1], apart[alike]
        compared = np.isfinite(of_near)
        afar = compared & (of_near > _NOISE) & (of_far < _LEFT_OVER * of_near)
        if compared.sum() < _FEWEST or 2 * afar.sum() < compared.sum():
            return None
    return far, np.rint(255 * colors).astype(np.uint8)


def measure_reach(points: np.ndarray, middle: np.ndarray) -> float:
    """Measures how far points (N, 3) lie from a place: that of nearly all of them."""
    return float(np.percentile(np.linalg.norm(points - middle, axis=1), _PERCENT))


def describe_sky(count: int) -> str:
    """Explains in a sentence that `count` first Gaussians form a sky."""
    return (
        f"{count} of the first Gaussians are a sky, {SKY_DISTANCE:g} times as far as the points: "
        "there the photographs show no points, but colours that agree when they are taken for far "
        "away."
    )


def _spread_directions() -> np.ndarray:
    """Returns (n, 3) unit vectors, evenly over the sphere along a spiral."""
    steps = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * steps / _DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * steps
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


def _project_into(scene: Scene, row: int, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Returns rows and pixels of the points (n, 3) within a photograph, whatever hides them."""
    camera, pose = scene.camera(row), scene.views[row].camera_from_world
    pixels, valid = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    found = np.flatnonzero(np.asarray(valid, bool) & inside)
    x, y = pixels[found].astype(np.int64).T
    return found, x, y


def _mark_near_points(scene: Scene, row: int, points: np.ndarray) -> np.ndarray:
    """Returns (H, W) bool: whether some point lies near in the photograph."""
    import cv2

    camera = scene.camera(row)
    empty = np.ones((camera.height, camera.width), np.uint8)
    _, x, y = _project_into(scene, row, points)
    empty[y, x] = 0
    if empty.all():
        return np.zeros(empty.shape, bool)
    distances = cv2.distanceTransform(empty, cv2.DIST_L2, 3)
    return distances < _GAP * max(camera.width, camera.height)


def _average_colors(
    scene: Scene, near_points: dict[int, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns mean colours (n, 3) in [0, 1] of points in photographs, and standard deviations (n,).

    Both are NaN if too few photographs see a point. Pixels near the scene's own points
    (`near_points`, by view) do not count: they show what stands before a sky.
    """
    import cv2

    count, total, squares = np.zeros(len(points)), *np.zeros((2, len(points), 3))
    for row, taken in near_points.items():
        found, x, y = _project_into(scene, row, points)
        counts = scene.mask(row)[y, x] & ~taken[y, x]
        found, x, y = found[counts], x[counts], y[counts]
        shown = cv2.blur(scene.image(row), (3, 3))[y, x] / 255.0
        count[found] += 1
        total[found] += shown
        squares[found] += shown**2
    few = count < _SEEN_BY
    count = np.maximum(count, 1)[:, None]
    mean = total / count
    apart = np.sqrt(np.maximum(squares / count - mean**2, 0.0)).mean(axis=1)
    mean[few], apart[few] = np.nan, np.nan
    return mean, apart
