"""First Gaussians far away, where the photographs show a sky and no point that could seed it.

Directions from the cameras' middle are a sky's where no point lies near them in any photograph
that sees them, and these show one colour there. White walls do that too. So photographs must agree
far better when most of these directions are taken for far than at the distance of the points: then
their light does come from afar. A sky without clouds cannot show that. It is one if all of it is
above the cameras, and if what any photograph shows empty of points is mostly so in all of them when
it is taken for far away: a near wall moves before the points around it.
"""

from __future__ import annotations

import numpy as np

from gsut.data import Scene

_DIRECTIONS = 6000  # evenly over the sphere, 2.6 degrees apart
_MOST_VIEWS, _MOST_POINTS = 30, 20_000  # evenly chosen
_LONGER_SIDE = 240  # pixels of the photographs that are asked
_SEEN_BY = 3  # photographs, or a direction says nothing
_GAP = 0.035  # of a photograph's longer side, within which a point is near
_ALIKE = 0.06  # standard deviation of one colour, values in [0, 1]
_PLAIN = 0.03  # standard deviation over all directions, below which a sky is without clouds
_STAYS, _LOWEST = 0.5, 2.0  # of what is empty somewhere; percentile of the height of a plain sky
# Distances in units of the points' (99 of 100 are nearer): a sky's, and that it is compared with.
_FAR, _NEAR, _PERCENT = 10.0, 1.0, 99.0
# Light comes from afar where photographs disagree by more than noise at the points' distance, and
# by less than half of that far away.
_NOISE, _LEFT_OVER = 0.01, 0.5
_MOST = 0.5  # of the directions, of which that has to hold
_FEWEST = 50  # directions, below which there is no sky to seed


def first_sky(scene: Scene) -> tuple[np.ndarray, np.ndarray] | None:
    """Points to seed a sky from.

    Args:
        scene: as it is trained on; only its training photographs are looked at.

    Returns:
        Points (N, 3) in the scene's coordinates, ten times as far as the scene's own, and colours
        (N, 3) uint8. None where the photographs show no sky for certain that has no points.
    """
    rows = scene.train_indices[:: -(-len(scene.train_indices) // _MOST_VIEWS)]
    if not len(scene.points) or len(rows) < _SEEN_BY:
        return None
    longest = max(max(camera.width, camera.height) for camera in scene.cameras)
    small = scene.scaled(min(1.0, _LONGER_SIDE / longest), decodes_small=True)
    points = scene.points[:: -(-len(scene.points) // _MOST_POINTS)]
    middle = np.mean([scene.views[row].camera_center for row in rows], axis=0)
    away = float(np.percentile(np.linalg.norm(points - middle, axis=1), _PERCENT))
    far = middle + _FAR * away * _directions()
    seen, (taken, empty) = np.zeros(len(far), int), np.zeros((2, len(far)), bool)
    near_points = {row: _near_points(small, row, points) for row in rows}
    for row in rows:
        directions, x, y = _pixels(small, row, far)
        seen[directions] += 1
        near = near_points[row][y, x]
        taken[directions[near]], empty[directions[~near]] = True, True
    often = seen >= _SEEN_BY
    stays = np.count_nonzero(often & ~taken) > _STAYS * np.count_nonzero(often & empty)
    far = far[often & ~taken]
    if len(far) < _FEWEST:
        return None
    colors, apart = _colors(small, near_points, far)
    alike = apart < _ALIKE
    far, colors = far[alike], colors[alike]
    if len(far) < _FEWEST:
        return None
    if colors.std(axis=0).mean() < _PLAIN:
        up = -np.sum([scene.views[row].camera_from_world[1, :3] for row in rows], axis=0)
        if not stays or np.percentile((far - middle) @ up, _LOWEST) <= 0:
            return None
    else:
        near = middle + (_NEAR / _FAR) * (far - middle)
        of_near, of_far = _colors(small, near_points, near)[1], apart[alike]
        compared = np.isfinite(of_near)
        afar = compared & (of_near > _NOISE) & (of_far < _LEFT_OVER * of_near)
        if compared.sum() < _FEWEST or afar.sum() < _MOST * compared.sum():
            return None
    return far, np.rint(255 * colors).astype(np.uint8)


def sky_note(count: int) -> str:
    """That so many first Gaussians are a sky's, and why, in a sentence."""
    return (
        f"{count} of the first Gaussians are a sky, {_FAR:g} times as far as the points: there the "
        "photographs show no points, but colours that agree when they are taken for far away "
        "(--init-count leaves it out)."
    )


def _directions() -> np.ndarray:
    """(n, 3) unit vectors, evenly over the sphere along a spiral."""
    steps = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1.0 - 2.0 * steps / _DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * steps
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)


def _pixels(scene: Scene, row: int, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Rows of the points (n, 3) that lie in a photograph, whatever hides them; their pixels."""
    camera, pose = scene.camera(row), scene.views[row].camera_from_world
    pixels, valid = camera.project(points @ pose[:3, :3].T + pose[:3, 3])
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    found = np.flatnonzero(np.asarray(valid, bool) & inside)
    x, y = pixels[found].astype(np.int64).T
    return found, x, y


def _near_points(scene: Scene, row: int, points: np.ndarray) -> np.ndarray:
    """(H, W) bool: some point lies near in the photograph."""
    import cv2

    camera = scene.camera(row)
    empty = np.ones((camera.height, camera.width), np.uint8)
    _, x, y = _pixels(scene, row, points)
    empty[y, x] = 0
    if empty.all():
        return np.zeros(empty.shape, bool)
    distances = cv2.distanceTransform(empty, cv2.DIST_L2, 3)
    return distances < _GAP * max(camera.width, camera.height)


def _colors(
    scene: Scene, near_points: dict[int, np.ndarray], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean colours (n, 3) in [0, 1] of what photographs show of points; standard deviations (n,).

    NaN where too few see a point. Pixels near the scene's own points (`near_points`, by view) do
    not count: they show what stands before a sky.
    """
    import cv2

    count, total, squares = np.zeros(len(points)), *np.zeros((2, len(points), 3))
    for row, taken in near_points.items():
        found, x, y = _pixels(scene, row, points)
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
