"""Fits a mesh to images as engines draw it, the nearest hit a pixel without blending."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut.surface.mesh import Mesh
from gsut.surface.rays import cast_world_rays

_EVENNESS = 0.3  # weight of colours' differences along edges, in pixels: for vertices unseen
_SMOOTHNESS = 1.0  # weight of a second difference of the surface as long as the edges, in pixels
_STAY = 1e-3  # weight of the old colour and place, likewise: no vertex is free
_OUTLIER = 0.2  # RGB error at which a pixel weighs half in a step that moves vertices (Cauchy)
_FARTHEST = 0.5  # lengths of a vertex' edges that it moves in a step
_GRAZING = 0.1  # cosine below which a pixel moves nothing
_ITERATIONS = 60  # of conjugate gradients
_ENOUGH = 1e-6  # of the residual, at which they end


@dataclasses.dataclass(frozen=True)
class Pixels:
    """The pixels of a view that a mesh is fitted to: rays in the world, and colours.

    Attributes:
        origins, rays: (N, 3) float64.
        colors: (N, 3) in [0, 1].
    """

    origins: np.ndarray
    rays: np.ndarray
    colors: np.ndarray


def gather_pixels(view: Any) -> Pixels:
    """Gathers the pixels of a `DepthMap` whose depth is known, each with its own line's pose."""
    origins, rays = cast_world_rays(view.camera, view.motion)
    known = np.isfinite(view.depth) & np.isfinite(rays[..., 0])
    return Pixels(origins[known], rays[known], view.image[known] / 255.0)


def fit_mesh(
    mesh: Mesh,
    views: Sequence[Any],
    rounds: int,
    progress: Callable[[int, int], None],
) -> Mesh:
    """Fits colours by least squares, in each round together with vertices along their normals.

    A round finds the first face along each ray and takes a Gauss-Newton step on the squared errors
    of all pixels and on the second differences of the surface. Derivatives are those inside faces:
    what moves at outlines is not seen by them.

    Args:
        mesh: with colours.
        views: `DepthMap`s with images, which it shall look like where their depth is known.
        rounds: steps that move vertices; 0: colours only.
        progress: called with (done, total) before each step.

    Returns:
        A mesh of the same faces. Rounds end where errors grow. Memory: 1 kB a face, and 250 bytes
        a pixel of one view.
    """
    best, least = mesh, np.inf
    for done in range(rounds + 1):
        progress(done, rounds + 1)
        fitted = _step(mesh, _Sums(mesh, views, None), 0.0)
        if not rounds:
            best = fitted
            break
        sums = _Sums(fitted, views, fitted.compute_normals() if done < rounds else None)
        if sums.error >= least:
            break
        best, least = fitted, sums.error
        if done < rounds:
            mesh = _step(fitted, sums, _SMOOTHNESS)
    progress(rounds + 1, rounds + 1)
    colors = np.clip(_get_colors(best), 0, 1).astype(np.float32)
    return dataclasses.replace(best, colors=colors)


def draw_pixels(mesh: Mesh, faces: np.ndarray, pixels: Pixels) -> tuple[np.ndarray, np.ndarray]:
    """Draws faces (N,) that rays meet.

    Returns:
        Weights (N, 3) of the corners where the rays meet the planes, and colours (N, 3).
    """
    corners = mesh.vertices[mesh.faces[faces]] - pixels.origins[:, None]
    turned = np.cross(corners[:, (1, 2, 0)], corners[:, (2, 0, 1)])
    weights = np.einsum("ni,nki->nk", pixels.rays, turned)
    weights /= weights.sum(axis=1, keepdims=True)
    return weights, np.einsum("nk,nkc->nc", weights, _get_colors(mesh)[mesh.faces[faces]])


def differentiate_pixels(
    mesh: Mesh, faces: np.ndarray, pixels: Pixels, weights: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Differentiates drawn colours by moves of the corners along their normals.

    As a corner moves, a point of its face moves with it by the corner's weight w, and what the ray
    meets is behind or before it: a colour of gradient g in the face's plane changes by
    -w (g - n (g d) / (n d)) of the move, for a ray d and a face's normal n.

    Returns:
        (N, 3 corners, 3 channels).
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    square = np.maximum(np.sum(across * across, axis=1), 1e-300)
    by_place = np.stack([np.cross(across, edge) for edge in (c - b, a - c, b - a)], axis=1)
    by_place /= square[:, None, None]
    slopes = np.einsum("fki,fkc->fci", by_place, _get_colors(mesh)[mesh.faces])[faces]
    across = across[faces]
    along = np.sum(across * pixels.rays, axis=1)
    moved = np.einsum("nci,ni->nc", slopes, pixels.rays) / along[:, None]
    slopes = moved[:, :, None] * across[:, None] - slopes
    slopes[np.abs(along) < _GRAZING * np.sqrt(square[faces])] = 0.0
    return np.einsum("nci,nki,nk->nkc", slopes, normals[mesh.faces[faces]], weights)


def _get_colors(mesh: Mesh) -> np.ndarray:
    return np.asarray(mesh.colors, np.float64)


class _Sums:
    """Sums over the pixels of each face (F, 3 corners, ...) that the normal equations consist of.

    Attributes:
        error: sum of all squared errors.
        weights, colors: of corners by corners, and of corners by what colours lack.
        mixed, moves, pulls: of corners by moves, of moves by moves, of moves by what colours lack.
    """

    def __init__(self, mesh: Mesh, views: Sequence[Any], normals: np.ndarray | None) -> None:
        count, self.error = len(mesh.faces), 0.0
        tree = _core.TriangleTree(mesh.vertices, mesh.faces)
        self.weights, self.colors = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        self.mixed, self.moves = np.zeros((count, 3, 3, 3)), np.zeros((count, 3, 3))
        self.pulls = np.zeros((count, 3))
        for view in map(gather_pixels, views):
            faces = tree.cast(view.origins, view.rays)[1]
            met = np.argsort(faces, kind="stable")[np.count_nonzero(faces < 0) :]
            faces = faces[met]
            pixels = Pixels(view.origins[met], view.rays[met], view.colors[met])
            weights, shown = draw_pixels(mesh, faces, pixels)
            lack = pixels.colors - shown
            squares = np.sum(lack * lack, axis=1)
            self.error += float(squares.sum())
            trust = np.ones(len(faces)) if normals is None else 1 / (1 + squares / _OUTLIER**2)
            trusted = trust[:, None] * weights
            _add(self.weights, faces, trusted[:, :, None] * weights[:, None])
            _add(self.colors, faces, trusted[:, :, None] * lack[:, None])
            if normals is None:
                continue
            slopes = differentiate_pixels(mesh, faces, pixels, weights, normals)
            _add(self.mixed, faces, trusted[:, :, None, None] * slopes[:, None])
            by_trust = trust[:, None, None] * slopes
            _add(self.moves, faces, np.einsum("nkc,nmc->nkm", by_trust, slopes))
            _add(self.pulls, faces, np.einsum("nkc,nc->nk", by_trust, lack))


def _add(sums: np.ndarray, faces: np.ndarray, values: np.ndarray) -> None:
    """Adds values (N, ...) of pixels to the sums of their faces (N,), which are in order."""
    begins = np.flatnonzero(np.diff(faces, prepend=-1))
    sums[faces[begins]] += np.add.reduceat(values, begins, axis=0)


class _Edges:
    """The edges of a mesh, and differences along them."""

    def __init__(self, mesh: Mesh) -> None:
        count = len(mesh.vertices)
        pairs = np.sort(mesh.list_edges(), axis=1)
        self._ends = np.stack(np.divmod(np.unique(pairs[:, 0] * count + pairs[:, 1]), count))
        self.degrees = np.maximum(np.bincount(self._ends.ravel(), minlength=count), 1)[:, None]
        one, other = mesh.vertices[self._ends]
        lengths = np.linalg.norm(one - other, axis=1)
        self.lengths = self._sum(lengths[:, None], lengths[:, None]) / self.degrees

    def _sum(self, ones: np.ndarray, others: np.ndarray) -> np.ndarray:
        columns = [
            sum(np.bincount(e, v, len(self.degrees)) for e, v in zip(self._ends, both, strict=True))
            for both in zip(ones.T, others.T, strict=True)
        ]
        return np.stack(columns, axis=1)

    def sum_differences(self, values: np.ndarray) -> np.ndarray:
        """Sums (V, C) each vertex' differences from its neighbours."""
        apart = values[self._ends[0]] - values[self._ends[1]]
        return self._sum(apart, -apart)


def _to_vertices(mesh: Mesh, of_corners: np.ndarray) -> np.ndarray:
    """Sums (F, 3, C) over the faces of each vertex."""
    columns = [
        sum(np.bincount(mesh.faces[:, k], part[:, k], len(mesh.vertices)) for k in range(3))
        for part in np.moveaxis(of_corners, 2, 0)
    ]
    return np.stack(columns, axis=1)


def _step(mesh: Mesh, sums: _Sums, smoothness: float) -> Mesh:
    """Solves the normal equations of colours and, in edges' lengths, of moves along normals."""
    edges, faces, normals = _Edges(mesh), mesh.faces, mesh.compute_normals()
    lengths = edges.lengths[faces, 0]
    mixed = np.moveaxis(sums.mixed, 2, 3) * lengths[:, None, None]
    mixed = mixed.reshape(-1, 9, 3)  # corners and channels by moves
    moves = sums.moves * lengths[:, :, None] * lengths[:, None]

    def measure_bends(values: np.ndarray) -> np.ndarray:
        return edges.sum_differences(values) / edges.degrees

    def add_smoothing(values: np.ndarray) -> np.ndarray:
        return smoothness * edges.sum_differences(values / edges.degrees)

    def multiply(x: np.ndarray) -> np.ndarray:
        at = x[faces]
        colors, away = at[:, :, :3], at[:, :, 3:]
        by_corner = np.empty_like(at)
        by_corner[:, :, :3] = sums.weights @ colors + (mixed @ away).reshape(colors.shape)
        by_corner[:, :, 3:] = moves @ away + mixed.transpose(0, 2, 1) @ colors.reshape(-1, 9, 1)
        product = _to_vertices(mesh, by_corner)
        product[:, :3] += _EVENNESS * edges.sum_differences(x[:, :3])
        product[:, 3:] += add_smoothing(measure_bends(x[:, 3:]))
        return product + _STAY * x

    old = _get_colors(mesh)
    rough = np.sum(measure_bends(mesh.vertices) * normals, axis=1, keepdims=True)
    rough /= np.maximum(edges.lengths, 1e-300)
    pulls = (sums.pulls * lengths)[:, :, None]
    right = _to_vertices(mesh, np.concatenate([sums.colors, pulls], axis=2))
    right[:, :3] -= _EVENNESS * edges.sum_differences(old)
    right[:, 3:] -= add_smoothing(rough)
    own = np.concatenate(
        [np.repeat(np.einsum("fkk->fk", sums.weights)[:, :, None], 3, axis=2),
         np.einsum("fkk->fk", moves)[:, :, None]], axis=2,
    )  # fmt: skip
    diagonal = _to_vertices(mesh, own) + _STAY
    diagonal[:, :3] += _EVENNESS * edges.degrees
    diagonal[:, 3:] += smoothness * (1 + 1 / edges.degrees)
    x = _solve_symmetric(multiply, right, 1 / diagonal)
    away = np.clip(x[:, 3:], -_FARTHEST, _FARTHEST) * edges.lengths
    return Mesh(mesh.vertices + away * normals, faces, old + x[:, :3])


def _solve_symmetric(
    multiply: Callable[[np.ndarray], np.ndarray], right: np.ndarray, inverse: np.ndarray
) -> np.ndarray:
    """Solves multiply(x) = right, preconditioned by the inverse diagonal (Hestenes, Stiefel)."""
    x, rest = np.zeros_like(right), right.copy()
    ahead = inverse * rest
    square = first = np.sum(rest * ahead)
    for _ in range(_ITERATIONS):
        if square <= _ENOUGH**2 * first:
            break
        product = multiply(ahead)
        share = square / np.sum(ahead * product)
        x += share * ahead
        rest -= share * product
        better = inverse * rest
        before, square = square, np.sum(rest * better)
        ahead = better + square / before * ahead
    return x
