"""Chooses points of what photographs show, so that they cover all that is seen."""

from __future__ import annotations

import numpy as np

from gsut.data import Scene
from gsut.data.scene import project_points
from gsut.gaussians import choose_points
from gsut.sampling import choose_evenly
from gsut.surface.stereo.sweep import FEWEST, Shown, find_distances

# Number of photographs up to which all get distances.
_FEWEST_VIEWS = 20
# Most photographs that get distances; in between, a quarter of all, evenly chosen.
_MOST_VIEWS = 100
# Cells along the longer side of a view in which given points are looked for.
_CELLS = 20


def find_points_by_stereo(
    scene: Scene, most: int, seed: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Finds points on what training photographs show, from poses and lenses alone.

    Args:
        scene: as it is trained on.
        most: number of points.
        seed: of the draw if there are more.

    Returns:
        Points (N, 3) in the scene's coordinates, and colours (N, 3) uint8. None if hardly anything
        in neighbouring photographs is alike.
    """
    found = sample_distances(scene, max(most, FEWEST))
    if found is None:
        return None
    rows = choose_points(len(found[0]), most, seed)
    return found[1][rows], found[2][rows]


def sample_distances(scene: Scene, most: int) -> tuple[np.ndarray, ...] | None:
    """Samples what some training views show, evenly over each image.

    Returns:
        Where each ray starts and what it meets (N, 3), in the scene's coordinates, colours (N, 3)
        uint8 and views (N,), of about `most` rays; None if there are fewer than 100.
    """
    views = choose_views(scene)
    shown = find_distances(scene, views)
    parts = [_choose_by_cell(each, most / len(views)) for each in shown.values()]
    counts = [len(points) for _, points, _ in parts]
    if sum(counts) < FEWEST:
        return None
    starts, points, colors = (np.concatenate(each) for each in zip(*parts, strict=True))
    return starts, points, colors, np.repeat([*shown], counts)


def measure_coverage(scene: Scene) -> float:
    """Measures on what share of the training views the scene's points lie.

    Returns:
        The share of the cells of all views, 20 along a longer side, in which a point projects.
        Cells of masked pixels alone do not count.
    """
    import cv2

    if len(scene.points) == 0:
        return 0.0
    covered, counted = 0, 0
    for view in scene.train_indices:
        camera = scene.camera(view)
        size = np.array([camera.width, camera.height])
        cells = np.maximum(1, np.rint(_CELLS * size / size.max()).astype(int))
        valid_share = cv2.resize(
            scene.mask(view).astype(np.float32), cells.tolist(), interpolation=cv2.INTER_AREA
        )
        _, pixels, valid = project_points(camera, scene.views[view].motion, scene.points)
        pixels = pixels[valid]
        pixels = pixels[((pixels >= 0) & (pixels < size)).all(axis=1)]
        column, row = np.minimum(pixels * cells / size, cells - 1).astype(int).T
        shown = np.zeros(valid_share.shape, bool)
        shown[row, column] = True
        covered += int(np.count_nonzero(shown & (valid_share > 0)))
        counted += int(np.count_nonzero(valid_share))
    return covered / counted


def choose_views(scene: Scene) -> list[int]:
    """Chooses the training views that get distances, evenly spread."""
    train = scene.train_indices
    return choose_evenly(train, min(max(_FEWEST_VIEWS, len(train) // 4), _MOST_VIEWS))


def _choose_by_cell(shown: Shown, most: float) -> tuple[np.ndarray, ...]:
    """Chooses one point in each cell of a view: that on which most other views agree.

    Points through which more views see than show them are left out.
    """
    balance = shown.agree.astype(int) - shown.oppose
    usable = (shown.inverse > 0) & (shown.agree > 0) & (balance >= 0)
    rows, columns = np.nonzero(usable)
    side = max(1.0, np.sqrt(len(rows) / most))
    cells = (rows // side).astype(int), (columns // side).astype(int)
    order = np.lexsort((-balance[rows, columns], *cells))
    kept = np.stack(cells)[:, order]
    is_first = np.ones(len(order), bool)
    is_first[1:] = (kept[:, 1:] != kept[:, :-1]).any(axis=0)
    rows, columns = rows[order[is_first]], columns[order[is_first]]
    starts, rays = shown.photograph.trace_rays(np.stack([columns, rows], axis=1) + 0.5)
    points = starts + rays / shown.inverse[rows, columns][:, None]
    good = np.isfinite(points).all(axis=1)
    return starts[good], points[good], shown.photograph.color[rows, columns][good]
