"""Places a capture in the frame of a laser scanner's cloud: similarity, by what both measured.

Distances that photographs show have a direction, and free space before them. Rotations are
those that lay the normals of both on each other; scale and shift are the maxima of a correlation
(surface where rays end, none before it), refined by trimmed least squares. Which is right is
decided by the distances of the cloud along the rays; what is as good elsewhere is ambiguous.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.bounds import name_wrong_kinds
from gsut.data import Scene
from gsut.data.points import find_usable_points
from gsut.gaussians import rotations_from_quaternions
from gsut.judge import Matches, Structure, prefer
from gsut.refine.captures.alignment import CaptureAlignment
from gsut.surface.stereo import sample_distances

_RAYS = 6000  # whose distances are compared
_SEEKING = 1500  # of them, by which positions are sought: enough to separate them
_VOXELS = 500  # across the cloud, of which each keeps one point
_MOST_POINTS = 150_000  # for which voxels grow: as fine as the search needs
_STRAY = 10  # medians of the distance from the middle, beyond which points lie by mistake
_AROUND = 12  # neighbours that a normal is fitted to
_NORMALS = 500  # of what photographs show, by which rotations are rated
_ROTATIONS = 20_000  # that are tried: 7 degrees apart
_APART = 9.0  # degrees between rotations that are kept
_MOST_ROTATIONS = 64  # that are kept: of a box, 24 are alike
_SPREADS = (0.05, 0.025, 0.012)  # radians by which rotations are varied, round by round
_VARIED = 40  # rotations of a round
_DIRECTIONS = 24  # bins of a normal's coordinate
_CELLS = 64  # of the correlation's side
_FILLED = 0.7  # share of that side that the cloud takes: the rest is margin
_SMALLEST = 0.15  # size of what photographs show, relative to the cloud
_LARGEST = 1.3  # likewise
_STEP = 1.08  # ratio of one size to the next
_FREE = (0.4, 0.65, 0.85)  # places before the surface, as shares of the distance
_STARTS = 40  # similarities that are refined
_QUICK = 15  # rounds of refining each of them
_ROUNDS = 30  # rounds of refining the best
_AGAIN = 6  # rounds for each part that the jackknife leaves out
_BANDS = 6  # of distances, of which the jackknife leaves one out
_AGREES = 0.05  # relative difference of distances that agree
_LEAST = 0.75  # share that agrees where the cloud has a surface: of wrong places up to 0.74 does
_LEAST_HIT = 0.3  # share of rays along which the cloud has to have a surface
_DIFFERS = 0.1  # shift relative to the distance, from which two similarities are two places
_WORST = 0.02  # largest relative standard deviation of the scale that is an answer
_SHARED = 0.003  # relative error that distances of small pictures may share
_HUNDRED = 100.0  # errors are in percent: 0.01 is then little, as it is of pixels
_INDEX = {"algorithm": 4, "leaf_max_size": 10}  # a tree whose nearest points are exact


@dataclasses.dataclass(frozen=True)
class _Rays:
    """What photographs show: starts and ends (n, 3) of rays; (n,) views."""

    starts: np.ndarray
    ends: np.ndarray
    views: np.ndarray

    def take(self, rows: np.ndarray) -> _Rays:
        return _Rays(self.starts[rows], self.ends[rows], self.views[rows])


class _Surface:
    """A cloud about its middle: finds its nearest points and cuts rays."""

    def __init__(self, points: np.ndarray) -> None:
        points = points[find_usable_points(points)[0]]
        self.middle = np.median(points, axis=0)
        points = points - self.middle
        away = np.linalg.norm(points, axis=1)
        points = points[away < _STRAY * np.median(away)]
        self.low, high = np.percentile(points, (0.5, 99.5), axis=0)
        self.size, self.side = float(np.linalg.norm(high - self.low)), (high - self.low).max()
        voxel, of_point = self.size / _VOXELS, np.arange(_MOST_POINTS + 1)
        while of_point.max() >= _MOST_POINTS:
            cells = np.floor(points / voxel).astype(np.int64)
            of_point = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
            voxel *= 1.25
        sums = [np.bincount(of_point, column) for column in points.T]
        self.points = np.stack(sums, axis=1) / np.bincount(of_point)[:, None]
        self._index = _make_index(self.points)
        self.normals, reach = _fit_normals(self.points, self.find_nearest(self.points, _AROUND))
        side = np.roll(np.eye(3)[np.abs(self.normals).argmin(axis=1)], 1, axis=1)
        across = np.cross(self.normals, side)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        along = np.cross(self.normals, across)
        corners = [
            self.points + reach[:, None] * (np.cos(a) * across + np.sin(a) * along)
            for a in 2 * np.pi * np.arange(3) / 3
        ]
        faces = np.arange(3 * len(self.points), dtype=np.uint32).reshape(-1, 3)
        self._tree = _core.TriangleTree(np.stack(corners, axis=1).reshape(-1, 3), faces)

    def find_nearest(self, points: np.ndarray, count: int = 1) -> np.ndarray:
        """Returns the numbers (n, count) of the nearest points."""
        return _find_nearest(self._index, points, count)

    def measure_distances(self, rays: _Rays, pose: _Pose) -> np.ndarray:
        """Measures (n,) distances along rays over those that photographs show; NaN without."""
        starts, ends = pose.apply(rays.starts), pose.apply(rays.ends)
        shown = np.linalg.norm(ends - starts, axis=1)
        distances, _ = self._tree.cast(starts, (ends - starts) / shown[:, None])
        return distances / shown


def _make_index(points: np.ndarray) -> Any:
    import cv2

    return cv2.flann_Index(points.astype(np.float32), _INDEX)  # type: ignore[attr-defined]


def _find_nearest(index: Any, points: np.ndarray, count: int) -> np.ndarray:
    """Returns the numbers (n, count) of the points of an index that are nearest."""
    return index.knnSearch(points.astype(np.float32), count, params={"checks": -1})[0]


def _fit_normals(points: np.ndarray, nearest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits normals (n, 3) to the nearest points, and returns how far half of these lie."""
    around = points[nearest] - points[nearest].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    apart = np.linalg.norm(points[nearest[:, nearest.shape[1] // 2]] - points, axis=1)
    return vectors[:, :, 0], apart


@dataclasses.dataclass(frozen=True)
class _Pose:
    """x -> scale rotation x + shift."""

    scale: float
    rotation: np.ndarray
    shift: np.ndarray

    def apply(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + self.shift


@name_wrong_kinds
def align_to_cloud(points: np.typing.ArrayLike, scene: Scene) -> CaptureAlignment:
    """Finds the similarity from a dataset's coordinates to those of a cloud of the same place.

    Args:
        points: (M, 3) of a laser scanner, a depth camera or a mesh's vertices, in any frame.
        scene: photographs with poses of any frame and scale; some are decoded.

    Returns:
        The similarity with its standard deviations; `rejected` photographs show something else.

    Raises:
        SolveError: photographs show too little, another place, or fit in several places alike.
    """
    points = np.asarray(points, np.float64)
    if len(points) < _SEEKING:
        raise SolveError(f"a cloud of {len(points)} points is too small: {_SEEKING} are needed")
    found = sample_distances(scene, _RAYS)
    if found is None:
        raise SolveError(f"{scene.path}: neighbouring photographs show too little alike")
    offset = scene.world_offset
    rays = _Rays(found[0] + offset, found[1] + offset, found[3])
    surface = _Surface(points)
    few = rays.take(np.random.default_rng(0).permutation(len(rays.views))[:_SEEKING])
    results = [_Result(pose, surface, few) for pose in _find_poses(surface, few)]
    best, rival = _choose(results)
    if rival is not None:
        raise SolveError(
            f"{scene.path} fits the cloud in several places, such as at scales "
            f"{best.pose.scale:.4g} and {rival.pose.scale:.4g}: the place repeats itself, or the "
            "photographs show too little of it; give the part of the cloud that they show, and let "
            "the scanner's program leave out points mixed at edges"
        )
    pose = _refine(surface, rays, best.pose, _AGREES / 2)
    best = _Result(pose, surface, rays)
    if not best.share > _LEAST:
        raise SolveError(
            f"{scene.path} does not fit the cloud: at best {best.share:.0%} of the distances that "
            f"photographs show agree with it; do they show the same place, and at least "
            f"{_SMALLEST:.0%} of its size?"
        )
    sigmas = _measure_sigmas(surface, rays, pose)
    if not sigmas[0] < _WORST:
        raise SolveError(
            f"{scene.path}: the scale in the cloud is known to {sigmas[0]:.0%} only; photographs "
            "from more places, or a cloud of more than one surface, would decide it"
        )
    names: list[str] = []
    rejected: list[str] = []
    for view in np.unique(rays.views):
        errors = best.errors[(rays.views == view) & np.isfinite(best.errors)]
        agrees = len(errors) > 0 and np.median(errors) < _HUNDRED * _AGREES
        (names if agrees else rejected).append(scene.views[view].name)
    shift = pose.shift + surface.middle
    return CaptureAlignment(
        pose.scale, pose.rotation, shift, *sigmas, tuple(names), tuple(rejected)
    )


class _Result:
    """What one similarity explains: errors of distances in percent, NaN where nothing is hit."""

    def __init__(self, pose: _Pose, surface: _Surface, rays: _Rays) -> None:
        self.pose, ratio = pose, surface.measure_distances(rays, pose)
        self.errors = _HUNDRED * np.abs(np.log(ratio))
        hit = np.isfinite(ratio)
        agrees = self.errors < _HUNDRED * _AGREES
        self.share = float(agrees.sum() / max(hit.sum(), _LEAST_HIT * len(hit)))
        self._matches = np.stack([rays.views] * 2, axis=1)
        self.ends = pose.apply(rays.ends)
        self.reach = np.linalg.norm(self.ends - pose.apply(rays.starts), axis=1)

    def is_surer_than(self, other: _Result) -> bool:
        """Returns whether it explains the distances surely better: all, or, if these do not
        decide, those along which both have a surface.
        """
        extent, both = _HUNDRED * np.log(10), np.isfinite(self.errors + other.errors)

        def is_better(one: np.ndarray, two: np.ndarray, rows: Any = slice(None)) -> bool:
            matches = Matches(self._matches[rows], extent)
            return prefer(Structure(two[rows]), Structure(one[rows]), matches).is_rival

        if is_better(self.errors, other.errors) or is_better(other.errors, self.errors):
            return is_better(self.errors, other.errors)
        return is_better(self.errors, other.errors, both)

    def is_elsewhere(self, other: _Result) -> bool:
        off = np.linalg.norm(self.ends - other.ends, axis=1)
        return float(np.median(off / np.minimum(self.reach, other.reach))) > _DIFFERS


def _choose(results: list[_Result]) -> tuple[_Result, _Result | None]:
    """Returns the best result, and a different one that it does not beat, or None."""
    results = sorted(results, key=lambda each: -np.mean(each.errors < _HUNDRED * _AGREES))
    best = results[0]
    for each in results[1:]:
        if each.is_elsewhere(best) and each.is_surer_than(best):
            best = each
    others = (each for each in results if each.is_elsewhere(best) and not best.is_surer_than(each))
    return best, next(others, None)


def _find_poses(surface: _Surface, rays: _Rays) -> list[_Pose]:
    """Finds the similarities at which rays end on the surface and meet none before, refined."""
    found = []
    for rotation in _find_rotations(surface, rays):
        found += list(_correlate(surface, rays, rotation))
    found.sort(key=lambda each: -each[0])
    kept: list[_Pose] = []
    for _, pose in found:
        ends = pose.apply(rays.ends)
        reach = np.linalg.norm(ends - pose.apply(rays.starts), axis=1)
        off = (np.linalg.norm(each.apply(rays.ends) - ends, axis=1) / reach for each in kept)
        if all(np.median(each) > 2 * _DIFFERS for each in off):
            kept.append(pose)
        if len(kept) == _STARTS:
            break
    return [_refine(surface, rays, pose, 3 * _AGREES, _QUICK) for pose in kept]


def _find_rotations(surface: _Surface, rays: _Rays) -> list[np.ndarray]:
    """Finds rotations that lay the normals of what photographs show on those of the cloud."""
    ends = rays.ends - rays.ends.mean(axis=0)
    nearest = _find_nearest(_make_index(ends), ends, _AROUND)
    normals = _fit_normals(ends, nearest)[0][:_NORMALS]
    both = np.concatenate([surface.normals, -surface.normals])
    cells = np.minimum(((both + 1) / 2 * _DIRECTIONS).astype(np.int64), _DIRECTIONS - 1)
    size = (_DIRECTIONS,) * 3
    table = np.bincount(np.ravel_multi_index(tuple(cells.T), size), minlength=_DIRECTIONS**3)
    table = np.sqrt(_smooth_grid(table.reshape(size).astype(np.float32)))

    def rate(turns: np.ndarray) -> np.ndarray:
        turned = np.einsum("rij,nj->rni", turns, normals)
        at = np.minimum(((turned + 1) / 2 * _DIRECTIONS).astype(np.int64), _DIRECTIONS - 1)
        return table[at[..., 0], at[..., 1], at[..., 2]].mean(axis=1)

    rng = np.random.default_rng(0)
    turns = _make_rotations(rng.standard_normal((_ROTATIONS, 4)))
    rates = np.concatenate([rate(part) for part in np.array_split(turns, 20)])
    least = (rates.mean() + rates.max()) / 2
    kept: list[np.ndarray] = []
    for number in np.argsort(-rates):
        if rates[number] < least or len(kept) == _MOST_ROTATIONS:
            break
        turn = turns[number]
        cosine = [(np.trace(each.T @ turn) - 1) / 2 for each in kept]
        if all(c < np.cos(np.radians(_APART)) for c in cosine):
            kept.append(turn)
    return [_climb(turn, rate, rng) for turn in kept]


def _climb(
    turn: np.ndarray, rate: Callable[[np.ndarray], np.ndarray], rng: np.random.Generator
) -> np.ndarray:
    """Climbs to a better rotation: varies it at random, less each round, and keeps the best."""
    for spread in _SPREADS:
        near = np.tile([1.0, 0.0, 0.0, 0.0], (_VARIED, 1))
        near[1:, 1:] = spread * rng.standard_normal((_VARIED - 1, 3)) / 2
        turns = _make_rotations(near) @ turn
        turn = turns[int(np.argmax(rate(turns)))]
    return turn


def _make_rotations(quaternions: np.ndarray) -> np.ndarray:
    return rotations_from_quaternions(
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    )


def _smooth_grid(grid: np.ndarray) -> np.ndarray:
    for axis in range(3):
        grid = (np.roll(grid, 1, axis) + 2 * grid + np.roll(grid, -1, axis)) / 4
    return grid


def _correlate(
    surface: _Surface, rays: _Rays, rotation: np.ndarray
) -> Iterator[tuple[float, _Pose]]:
    """Yields scores and similarities: for each scale the two best shifts."""
    low, cell = surface.low, float(surface.side) / (_FILLED * _CELLS)
    size = (_CELLS,) * 3
    at = np.floor((surface.points - low) / cell).astype(np.int64)
    at = at[((at >= 0) & (at < _CELLS)).all(axis=1)]
    there = np.zeros(size, np.float32)
    there[tuple(at.T)] = 1
    spectrum = np.fft.rfftn(_smooth_grid(there))
    turned_starts, turned = rays.starts @ rotation.T, rays.ends @ rotation.T
    along = [turned_starts + share * (turned - turned_starts) for share in _FREE]
    spread = np.linalg.norm(np.subtract(*np.percentile(turned, (95, 5), axis=0)))
    weights = np.repeat([1.0, -1 / len(_FREE)], [len(turned), len(_FREE) * len(turned)])
    places = np.concatenate([turned, *along])
    corner = np.percentile(turned, 2, axis=0)
    number = int(np.log(_LARGEST / _SMALLEST) / np.log(_STEP))
    for share in _SMALLEST * _STEP ** np.arange(number + 1):
        scale = share * surface.size / spread
        at = np.floor(scale * (places - corner) / cell).astype(np.int64) % _CELLS
        grid = np.bincount(np.ravel_multi_index(tuple(at.T), size), weights, _CELLS**3)
        seen = np.fft.rfftn(grid.reshape(size).astype(np.float32))
        score = np.fft.irfftn(spectrum * seen.conj())
        for _ in range(2):
            peak = np.array(np.unravel_index(int(score.argmax()), size))
            value = float(score[tuple(peak)]) / len(turned)
            around = np.ix_(*((p + np.arange(-3, 4)) % _CELLS for p in peak))
            score[around] = -np.inf
            peak = np.where(peak > _FILLED * _CELLS, peak - _CELLS, peak)
            yield value, _Pose(scale, rotation, low + cell * peak - scale * corner)


def _refine(
    surface: _Surface, rays: _Rays, pose: _Pose, widest: float, rounds: int = _ROUNDS
) -> _Pose:
    """Refines a similarity by distances to the surface's planes, far ones weighed less."""
    for tolerance in np.geomspace(widest, _AGREES / 4, rounds):
        ends = pose.apply(rays.ends)
        reach = tolerance * np.linalg.norm(ends - pose.apply(rays.starts), axis=1)
        nearest = surface.find_nearest(ends)[:, 0]
        normals, off = surface.normals[nearest], surface.points[nearest] - ends
        error = np.einsum("ni,ni->n", normals, off)
        weight = 1 / (1 + (off**2).sum(axis=1) / (2 * reach) ** 2) ** 2
        weight /= reach * (1 + (error / reach) ** 2) ** 2
        middle = ends.mean(axis=0)
        arms = ends - middle
        rows = np.column_stack([(arms * normals).sum(axis=1), np.cross(arms, normals), normals])
        weighted = rows.T * weight**2
        step = np.linalg.lstsq(weighted @ rows, weighted @ error, rcond=1e-12)[0]
        grown = np.exp(np.clip(step[0], -0.1, 0.1))
        (turn,) = _make_rotations(np.array([[1.0, *(step[1:4] / 2)]]))
        pose = _Pose(
            grown * pose.scale, turn @ pose.rotation,
            grown * turn @ (pose.shift - middle) + middle + step[4:],
        )  # fmt: skip
    return pose


def _measure_sigmas(surface: _Surface, rays: _Rays, pose: _Pose) -> tuple[float, float, float]:
    """Measures the standard deviations of `CaptureAlignment`: scale, rotation, positions.

    By the jackknife, over photographs and over bands of distances: what photographs show near and
    far is wrong by different shares where the lens or the comparison of pictures errs.
    """
    away = np.linalg.norm(rays.ends - rays.starts, axis=1)
    bands = np.searchsorted(np.quantile(away, np.linspace(0, 1, _BANDS + 1)[1:-1]), away)
    middle = rays.starts.mean(axis=0)
    variances = np.zeros(3)
    for groups in (rays.views, bands):
        values = []
        for group in np.unique(groups):
            fit = _refine(surface, rays.take(groups != group), pose, _AGREES / 4, _AGAIN)
            values.append([fit.scale / pose.scale, *fit.rotation.ravel(), *fit.apply(middle)])
        off = np.square(np.array(values) - np.mean(values, axis=0)).sum(axis=0)
        off *= 1 - 1 / len(values)
        variances += [off[0], off[1:10].sum() / 2, off[10:].sum()]
    scale, turned, moved = np.sqrt(variances).tolist()
    return float(np.hypot(scale, _SHARED)), float(np.degrees(turned)), moved
