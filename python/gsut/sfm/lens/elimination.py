"""Eliminates points, or poses and points, from normal equations: what is left is what they share.

Equations of many images at once are large. A window of images with poses and points of its own is
an independent estimate: windows together know a little less than all images at once, because a
point that two windows see counts as two.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_WINDOW = 150  # images, about
# Points that an image must share with a window to join it: fewer do not hold its pose.
_LEAST_SHARED = 20
_CHUNK = 2000  # points whose pairs of observations are summed at once, to bound memory
_WINDOW_CHUNK = 500  # the same of a window: the images that see any of them count for each
# A direction of a point whose square counts less than this share is open: parallax below 1e-6 rad.
_OPEN = 1e-12
_WEAK = 1e-10  # square of a pivot of the scaled equations below which a window holds no poses


def eliminate_points(
    image: np.ndarray,
    point: np.ndarray,
    by_pose: np.ndarray,
    by_lens: np.ndarray,
    by_point: np.ndarray,
    images: int,
) -> tuple[np.ndarray, int]:
    """Eliminates the points from the normal equations (D images + F, same): Schur complement.

    Args:
        image, point: (S,) of the observations.
        by_pose: (S, 2, D), by_lens: (S, 2, F), by_point: (S, 2, 3) weighted derivatives.
        images: number of images.

    Returns:
        The matrix, and minus one for each direction in which a point is determined: what the points
        add to the freedom. Images of one place leave the distance of a point open.
    """
    order = np.argsort(point, kind="stable")
    image, point = image[order], point[order]
    by_pose, by_lens, by_point = by_pose[order], by_lens[order], by_point[order]
    count = by_lens.shape[2]
    unknowns = by_pose.shape[2]
    own = np.zeros((images, images, unknowns, unknowns))
    with_lens = np.zeros((images, unknowns, count))
    lens = np.einsum("nri,nrj->ij", by_lens, by_lens)
    np.add.at(own, (image, image), by_pose.transpose(0, 2, 1) @ by_pose)
    np.add.at(with_lens, image, by_pose.transpose(0, 2, 1) @ by_lens)
    starts = np.flatnonzero(np.r_[True, point[1:] != point[:-1]])
    lengths = np.diff(np.r_[starts, len(point)])
    determined = 0
    for length in np.unique(lengths):
        chosen = starts[lengths == length]
        for begin in range(0, len(chosen), _CHUNK):
            rows = chosen[begin : begin + _CHUNK, None] + np.arange(length)
            c = by_point[rows]  # (points, observations, 2, 3)
            pose_c = by_pose[rows].transpose(0, 1, 3, 2) @ c  # (points, observations, D, 3)
            lens_c = (by_lens[rows].transpose(0, 1, 3, 2) @ c).sum(axis=1)  # (points, F, 3)
            inverse, ranks = _invert_normals((c.transpose(0, 1, 3, 2) @ c).sum(axis=1))
            determined += ranks
            pose_i = pose_c @ inverse[:, None]
            at = image[rows]
            np.subtract.at(
                own,
                (at[:, :, None], at[:, None, :]),
                np.einsum("nsij,ntkj->nstik", pose_i, pose_c, optimize=True),
            )
            np.subtract.at(with_lens, at, pose_i @ lens_c.transpose(0, 2, 1)[:, None])
            lens -= np.einsum("nij,nkj->ik", lens_c @ inverse, lens_c)
    size = unknowns * images
    cross = with_lens.reshape(size, count)
    poses = own.transpose(0, 2, 1, 3).reshape(size, size)
    return np.block([[poses, cross], [cross.T, lens]]), -determined


def _invert_normals(normals: np.ndarray) -> tuple[np.ndarray, int]:
    """Inverts symmetric matrices (N, 3, 3) where they are determined; elsewhere the inverse is 0.

    Returns:
        The inverses, and the sum of their ranks.
    """
    scale = np.trace(normals, axis1=1, axis2=2) / 3
    is_open = ~(np.linalg.det(normals) > _OPEN * scale**3)
    inverse = np.empty_like(normals)
    inverse[~is_open] = np.linalg.inv(normals[~is_open])
    values, axes = np.linalg.eigh(normals[is_open])
    known = values > _OPEN * values[:, -1:]
    values = np.where(known, 1 / np.where(known, values, 1), 0)
    inverse[is_open] = (axes * values[:, None, :]) @ axes.transpose(0, 2, 1)
    return inverse, int(3 * np.count_nonzero(~is_open) + np.count_nonzero(known))


def split_windows(
    image: np.ndarray, point: np.ndarray, images: int, count: int | None = None
) -> list[np.ndarray]:
    """Splits images into windows that share many points.

    A window grows by the image that sees most of its points, and the next one begins beside it.

    Args:
        image, point: (S,) of the observations.
        images: number of images; those without observations are in no window.
        count: of windows; None: one for every 150 images or so.

    Returns:
        The sorted images of each window.
    """
    by_image, by_point = np.argsort(image, kind="stable"), np.argsort(point, kind="stable")
    begin_image = np.searchsorted(image[by_image], np.arange(images + 1))
    begin_point = np.searchsorted(point[by_point], np.arange(int(point.max(initial=-1)) + 2))
    is_open = np.diff(begin_image) > 0
    count = count or max(1, round(int(is_open.sum()) / _WINDOW))
    size = -(-int(is_open.sum()) // count)
    windows: list[np.ndarray] = []
    shared = np.zeros(images, np.int64)
    while is_open.any():
        own: list[int] = []
        following = int(np.argmax(np.where(is_open, shared, -1)))
        shared = np.zeros(images, np.int64)
        is_known = np.zeros(len(begin_point) - 1, bool)
        while len(own) < size and is_open[following]:
            own.append(following)
            is_open[following] = False
            seen = point[by_image[begin_image[following] : begin_image[following + 1]]]
            seen = np.unique(seen[~is_known[seen]])
            is_known[seen] = True
            lengths = begin_point[seen + 1] - begin_point[seen]
            steps = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
            rows = by_point[np.repeat(begin_point[seen], lengths) + steps]
            shared += np.bincount(image[rows], minlength=images)
            following = int(np.argmax(np.where(is_open, shared, -1)))
            if shared[following] < _LEAST_SHARED:
                break
        windows.append(np.sort(own))
    return windows


def eliminate_by_windows(
    image: np.ndarray,
    point: np.ndarray,
    centers: np.ndarray,
    differentiate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    prior: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Adds up the information of windows of images on what all share, see `split_windows`.

    Args:
        image, point: (S,) of the observations.
        centers: (N, 3) of the images.
        differentiate: returns `by_pose`, `by_shared` and `by_point` of some observations, see
            `eliminate_points`.
        prior: (D,) what is known beforehand of an image's unknowns, as their normal equations.

    Returns:
        The normal equations (F, F) of what all share, and minus the number of directions that poses
        and points take up.
    """
    total: np.ndarray | int = 0
    determined = 0
    for window in split_windows(image, point, len(centers)):
        chosen = np.flatnonzero(np.isin(image, window))
        own, taken = _eliminate_poses(
            np.searchsorted(window, image[chosen]), point[chosen], *differentiate(chosen),
            prior, centers[window],
        )  # fmt: skip
        total = total + own
        determined += taken
    return np.asarray(total), determined


def _eliminate_poses(
    image: np.ndarray,
    point: np.ndarray,
    by_pose: np.ndarray,
    by_shared: np.ndarray,
    by_point: np.ndarray,
    prior: np.ndarray,
    centers: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Eliminates the poses and points of a window of images from its normal equations.

    The first image is held, and one component of the farthest centre.

    Args:
        image, point: (S,) of the observations, images from 0.
        by_pose: (S, 2, D), by_shared: (S, 2, F), by_point: (S, 2, 3) weighted derivatives.
        prior: (D,) what is known beforehand of an image's unknowns, as their normal equations.
        centers: (N, 3) of the images.

    Returns:
        The normal equations (F, F) of what all windows share, zeros where the images do not hold
        together; and minus the number of directions that poses and points take up.
    """
    images, unknowns = len(centers), by_pose.shape[2]
    point = _number_by_images(image, point)
    poses = np.zeros((images, unknowns, images, unknowns))
    own = np.zeros((images, unknowns, unknowns))
    np.add.at(own, image, by_pose.transpose(0, 2, 1) @ by_pose)
    poses[np.arange(images), :, np.arange(images)] = own + np.diag(prior)
    size = images * unknowns
    normal = poses.reshape(size, size)
    cross = np.zeros((images, unknowns, by_shared.shape[2]))
    np.add.at(cross, image, by_pose.transpose(0, 2, 1) @ by_shared)
    shared = np.einsum("srf,srg->fg", by_shared, by_shared)
    roots, determined = _find_roots(point, by_point)
    whitened = by_point @ roots[point]
    tied = np.zeros((len(roots), by_shared.shape[2], 3))
    np.add.at(tied, point, by_shared.transpose(0, 2, 1) @ whitened)
    pose_point = by_pose.transpose(0, 2, 1) @ whitened
    for begin in range(0, len(roots), _WINDOW_CHUNK):
        rows = np.flatnonzero((point >= begin) & (point < begin + _WINDOW_CHUNK))
        seen, place = np.unique(image[rows], return_inverse=True)
        chunk = np.zeros((len(seen), unknowns, _WINDOW_CHUNK, 3))
        chunk[place, :, point[rows] - begin] = pose_point[rows]
        flat = chunk.reshape(len(seen) * unknowns, -1)
        at = (unknowns * seen[:, None] + np.arange(unknowns)).ravel()
        normal[np.ix_(at, at)] -= flat @ flat.T
        part = tied[begin : begin + _WINDOW_CHUNK].transpose(0, 2, 1).reshape(-1, tied.shape[1])
        cross[seen] -= (flat[:, : len(part)] @ part).reshape(len(seen), unknowns, -1)
        shared -= part.T @ part
    free = _find_free(centers, unknowns)
    length = 1 / np.sqrt(np.maximum(np.diag(normal)[free], 1e-300))
    small = normal[np.ix_(free, free)] * np.outer(length, length)
    try:
        weak = np.diag(np.linalg.cholesky(small)).min(initial=1.0) ** 2 < _WEAK
    except np.linalg.LinAlgError:
        weak = True
    if weak:
        return np.zeros_like(shared), -2 * len(image)
    tied_poses = cross.reshape(size, -1)[free] * length[:, None]
    shared -= tied_poses.T @ np.linalg.solve(small, tied_poses)
    return shared, -determined - len(free)


def _number_by_images(image: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Numbers points (S,) so that neighbours are seen by nearly the same images."""
    number = np.unique(point, return_inverse=True)[1]
    middle = np.bincount(number, image) / np.bincount(number)
    return np.argsort(np.argsort(middle, kind="stable"), kind="stable")[number]


def _find_roots(point: np.ndarray, by_point: np.ndarray) -> tuple[np.ndarray, int]:
    """Returns (P, 3, 3) roots R of the inverse normal equations of points, R R', and all ranks.

    Directions in which a point is not determined are left out.
    """
    normals = np.zeros((int(point.max(initial=-1)) + 1, 3, 3))
    np.add.at(normals, point, by_point.transpose(0, 2, 1) @ by_point)
    values, axes = np.linalg.eigh(normals)
    known = values > _OPEN * values[:, -1:]
    scales = np.where(known, 1 / np.sqrt(np.where(known, values, 1)), 0)
    return axes * scales[:, None, :], int(np.count_nonzero(known))


def _find_free(centers: np.ndarray, unknowns: int) -> np.ndarray:
    """Returns the indices of the unknowns of poses that the gauge leaves free."""
    away = centers - centers[0]
    second = int(np.argmax((away**2).sum(axis=1)))
    keep = np.ones(len(centers) * unknowns, bool)
    keep[:6] = False
    keep[unknowns * second + int(np.argmax(np.abs(away[second])))] = False
    return np.flatnonzero(keep)
