"""Eliminates points, or poses and points, from normal equations: what is left is what they share.

Equations of many images at once are large. A window of images with poses and points of its own is
an independent estimate: windows together know a little less than all images at once, because a
point that two windows see counts as two.
"""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from gsut import _core

_Result = TypeVar("_Result")
_WINDOW = 150  # images, about
# Points that an image must share with a window to join it: fewer do not hold its pose.
_LEAST_SHARED = 20
_CHUNK = 2000  # points of one number of observations that are eliminated at once
_PAIRS = 50_000  # of observations whose products are in memory at once
_WINDOW_CHUNK = 500  # the same of a window: the images that see any of them count for each
_BESIDE = 8  # chunks of a window at once: the product of each takes up to 60 MB
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
            _subtract_pairs(own, at, pose_i, pose_c)
            np.subtract.at(with_lens, at, pose_i @ lens_c.transpose(0, 2, 1)[:, None])
            lens -= np.einsum("nij,nkj->ik", lens_c @ inverse, lens_c)
    size = unknowns * images
    cross = with_lens.reshape(size, count)
    poses = own.transpose(0, 2, 1, 3).reshape(size, size)
    return np.block([[poses, cross], [cross.T, lens]]), -determined


def _subtract_pairs(
    own: np.ndarray, images: np.ndarray, left: np.ndarray, right: np.ndarray
) -> None:
    """Subtracts what points tie together from `own` (N, N, D, D), in place.

    Args:
        images: (P, L) that see each point.
        left, right: (P, L, D, 3); left right' of each two of its images is subtracted.
    """
    points, length = images.shape
    step = max(1, _PAIRS // length**2)
    for begin in range(0, points, step):
        a, b = (rows[begin : begin + step].reshape(-1, length * len(own[0, 0]), 3)
                for rows in (left, right))  # fmt: skip
        _core.subtract_blocks(own, images[begin : begin + step], b @ a.transpose(0, 2, 1))


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
    poses = np.zeros((images, images, unknowns, unknowns))
    own = np.zeros((images, unknowns, unknowns))
    np.add.at(own, image, by_pose.transpose(0, 2, 1) @ by_pose)
    poses[np.arange(images), np.arange(images)] = own + np.diag(prior)
    cross = np.zeros((images, unknowns, by_shared.shape[2]))
    np.add.at(cross, image, by_pose.transpose(0, 2, 1) @ by_shared)
    shared = np.einsum("srf,srg->fg", by_shared, by_shared)
    roots, determined = _find_roots(point, by_point)
    whitened = by_point @ roots[point]
    tied = np.zeros((len(roots), by_shared.shape[2], 3))
    np.add.at(tied, point, by_shared.transpose(0, 2, 1) @ whitened)
    pose_point = by_pose.transpose(0, 2, 1) @ whitened

    def multiply_chunk(begin: int) -> tuple[np.ndarray, ...]:
        rows = np.flatnonzero((point >= begin) & (point < begin + _WINDOW_CHUNK))
        seen, place = np.unique(image[rows], return_inverse=True)
        chunk = np.zeros((len(seen), unknowns, _WINDOW_CHUNK, 3))
        chunk[place, :, point[rows] - begin] = pose_point[rows]
        flat = chunk.reshape(len(seen) * unknowns, -1)
        part = tied[begin : begin + _WINDOW_CHUNK].transpose(0, 2, 1).reshape(-1, tied.shape[1])
        return seen, flat @ flat.T, flat[:, : len(part)] @ part, part.T @ part

    for seen, of_poses, of_both, of_shared in _run_beside(
        multiply_chunk, range(0, len(roots), _WINDOW_CHUNK)
    ):
        _core.subtract_blocks(poses, seen[None], of_poses[None])
        cross[seen] -= of_both.reshape(len(seen), unknowns, -1)
        shared -= of_shared
    free = _find_free(centers, unknowns)
    size = images * unknowns
    normal = poses.transpose(0, 2, 1, 3).reshape(size, size)
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


def _run_beside(work: Callable[[int], _Result], begins: Sequence[int]) -> Iterator[_Result]:
    """Yields the results of `work` in order; a few are made beside each other."""
    few = min(_BESIDE, _core.num_threads())
    with concurrent.futures.ThreadPoolExecutor(few, "gsut-windows") as pool:
        for first in range(0, len(begins), few):
            yield from pool.map(work, begins[first : first + few])


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
