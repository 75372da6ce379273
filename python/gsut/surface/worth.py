"""What depths and meshes are worth against a truth, in the field's figures."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.metrics import RING_EDGES_DEGREES
from gsut.surface.mesh import Mesh

_DELTAS = (1.25, 1.25**2, 1.25**3)
_AT = (0.01, 0.02, 0.05)  # of the F-score, in the truth's units
_SAMPLES = 200_000  # points drawn on each surface
_SEED = 20260821
_OCCLUDED = 1e-3  # share of the distance by which a nearer surface hides a point


def judge_depth(
    depth: np.ndarray, truth: np.ndarray, angles: np.ndarray | None = None
) -> dict[str, Any]:
    """Judges a depth map against the true one.

    Args:
        depth: (H, W) along the rays; NaN or infinite: none.
        truth: (H, W) likewise; 0 and NaN: not known.
        angles: (H, W) degrees from the lens' axis; None: no rings.

    Returns:
        dict abs_rel (mean of |depth - truth| / truth), abs_rel_median, sq_rel, rmse, rmse_log,
        delta1 .. delta3 (shares within factors 1.25, 1.25^2, 1.25^3 of the truth), coverage (share
        of the known pixels that have a depth), pixels, and with angles rings: list of dict
        from_degrees, to_degrees, abs_rel, abs_rel_median, coverage, pixels. None where no pixel has
        both.
    """
    known = np.isfinite(truth) & (truth > 0)
    both = known & np.isfinite(depth) & (depth > 0)
    figures = _judge_pixels(depth[both], truth[both])
    figures["coverage"] = float(both.sum() / known.sum()) if known.any() else None
    figures["pixels"] = int(both.sum())
    if angles is None:
        return figures
    figures["rings"] = [
        {
            "from_degrees": low,
            "to_degrees": high,
            **{
                name: _judge_pixels(depth[both & ring], truth[both & ring])[name]
                for name in ("abs_rel", "abs_rel_median")
            },
            "coverage": float(both[ring].sum() / known[ring].sum()) if known[ring].any() else None,
            "pixels": int(both[ring].sum()),
        }
        for low, high in itertools.pairwise(RING_EDGES_DEGREES)
        for ring in ((angles >= low) & (angles < high),)
    ]
    return figures


def _judge_pixels(depth: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    deltas = [f"delta{k + 1}" for k in range(len(_DELTAS))]
    names = ["abs_rel", "abs_rel_median", "sq_rel", "rmse", "rmse_log", *deltas]
    if not len(depth):
        return dict.fromkeys(names)
    depth, truth = depth.astype(np.float64), truth.astype(np.float64)
    error = np.abs(depth - truth)
    ratio = np.maximum(depth / truth, truth / depth)
    values = (
        np.mean(error / truth), np.median(error / truth), np.mean(error**2 / truth),
        np.sqrt(np.mean(error**2)), np.sqrt(np.mean(np.log(depth / truth) ** 2)),
        *(np.mean(ratio < delta) for delta in _DELTAS),
    )  # fmt: skip
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def sample_mesh(mesh: Mesh, count: int, seed: int = _SEED) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) spread evenly by area over a mesh, and unit normals (N, 3) of their faces.

    A cloud without faces gives at most `count` of its points, and normals of 0.
    """
    rng = np.random.default_rng(seed)
    if not len(mesh.faces):
        chosen = rng.permutation(len(mesh.vertices))[:count]
        return mesh.vertices[chosen], np.zeros((len(chosen), 3))
    vectors = mesh.compute_face_vectors()
    areas = np.linalg.norm(vectors, axis=1)
    face = np.searchsorted(np.cumsum(areas), rng.uniform(0, areas.sum(), count))
    face = np.minimum(face, len(mesh) - 1)
    u, v = rng.uniform(size=(2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = (mesh.vertices[mesh.faces[face, k]] for k in range(3))
    normals = vectors[face] / np.maximum(areas[face, None], 1e-300)
    return a + u * (b - a) + v * (c - a), normals


def build_tree(mesh: Mesh) -> _core.TriangleTree:
    """Searches a mesh, or the points of a cloud."""
    if len(mesh.faces):
        return _core.TriangleTree(mesh.vertices, mesh.faces)
    if not len(mesh.vertices):
        raise InputError("the truth has neither faces nor points")
    rows = np.arange(len(mesh.vertices), dtype=np.uint32)
    return _core.TriangleTree(mesh.vertices, np.stack([rows] * 3, axis=1))


def find_seen_points(points: np.ndarray, tree: _core.TriangleTree, scene: Any) -> np.ndarray:
    """Finds points (N,) that a training view sees: inside its image and not hidden by the truth.

    A rolling shutter is taken to stand still in its middle.
    """
    seen = np.zeros(len(points), bool)
    for index in list(scene.train_indices) or range(len(scene.views)):
        left = np.flatnonzero(~seen)
        camera, mask = scene.camera(index), scene.mask(index)
        pose = scene.views[index].camera_from_world
        pixels, valid = camera.project(points[left] @ pose[:3, :3].T + pose[:3, 3])
        place = np.nan_to_num(pixels, nan=-1.0)
        valid &= np.all((place >= 0) & (place < [camera.width, camera.height]), axis=1)
        left, place = left[valid], place[valid].astype(int)
        left = left[mask[place[:, 1], place[:, 0]]]
        center = -pose[:3, :3].T @ pose[:3, 3]
        rays = points[left] - center
        away = tree.cast(np.broadcast_to(center, rays.shape).copy(), rays)[0]
        seen[left[~(away < 1 - _OCCLUDED)]] = True
    return seen


def judge_mesh(
    mesh: Mesh, truth: Mesh, scene: Any = None, *, at: Sequence[float] = _AT
) -> dict[str, Any]:
    """Judges a mesh against the true one, from 200,000 points on each.

    Args:
        mesh: what is judged.
        truth: a mesh or a cloud of points.
        scene: leaves out of the truth what no training view sees; None: all of it counts.
        at: distances of the F-scores, world units.

    Returns:
        dict accuracy and completeness (mean distances from the mesh to the truth and back),
        chamfer (their mean), normal_consistency (mean |cosine| of the normals, both ways; None for
        a cloud), fscores: list of dict distance, precision, recall, fscore; points: of the truth.

    Raises:
        InputError: a mesh without faces, or no point of the truth is seen.
    """
    if not len(mesh):
        raise InputError("the mesh has no faces")
    truth_tree, mesh_tree = build_tree(truth), build_tree(mesh)
    points, normals = sample_mesh(mesh, _SAMPLES)
    true_points, true_normals = sample_mesh(truth, _SAMPLES, _SEED + 1)
    if scene is not None and len(truth.faces):
        seen = find_seen_points(true_points, truth_tree, scene)
        true_points, true_normals = true_points[seen], true_normals[seen]
        if not len(true_points):
            raise InputError("no training view sees the truth: are its coordinates the dataset's?")
    to_truth, of_truth = truth_tree.nearest(points)
    to_mesh, of_mesh = mesh_tree.nearest(true_points)
    consistency = None
    if len(truth.faces):
        one, other = (
            np.abs(np.sum(mine * _compute_face_normals(theirs, faces), axis=1))
            for mine, theirs, faces in (
                (normals, truth, of_truth),
                (true_normals, mesh, of_mesh),
            )
        )
        consistency = float((one.mean() + other.mean()) / 2)
    scores = []
    for distance in at:
        precision, recall = float(np.mean(to_truth < distance)), float(np.mean(to_mesh < distance))
        score = 2 * precision * recall / max(precision + recall, 1e-12)
        scores.append(
            {"distance": distance, "precision": precision, "recall": recall, "fscore": score}
        )
    return {
        "accuracy": float(to_truth.mean()),
        "completeness": float(to_mesh.mean()),
        "chamfer": float((to_truth.mean() + to_mesh.mean()) / 2),
        "normal_consistency": consistency,
        "fscores": scores,
        "points": len(true_points),
    }


def _compute_face_normals(mesh: Mesh, faces: np.ndarray) -> np.ndarray:
    vectors = mesh.compute_face_vectors()[faces]
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
