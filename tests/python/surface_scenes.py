"""Exact depth maps of spheres, boxes and planes through any lens, and what a mesh is worth."""

from __future__ import annotations

import collections

import numpy as np

import gsut
import small_datasets
from gsut import _core
from gsut.run import RunFile, RunFolder, describe_environment
from random_scenes import fisheye, pinhole, random_pose, roll, small_camera


def lines_of(camera, motion):
    """Origins and unit rays (H, W, 3) in the world, each line from its own pose; (H, W) valid."""
    rays, valid = camera.rays()
    origins, world = np.empty_like(rays), np.empty_like(rays)
    for row in range(camera.height):
        pose = motion if isinstance(motion, np.ndarray) else motion.at((row + 0.5) / camera.height)
        rotation, shift = pose[:3, :3], pose[:3, 3]
        origins[row] = (camera.origins()[row] - shift) @ rotation
        world[row] = rays[row] @ rotation
    return origins, world, valid


CAMERAS = {
    "pinhole": lambda: pinhole(12),
    "fisheye": lambda: fisheye(24),
    "moving pupil": lambda: small_camera("cahvore", width=12),
    "rolling shutter": lambda: pinhole(12),
}


def put_camera(rng, kind, cameras=CAMERAS):
    """A camera of a kind, its pose or motion, and its pose in the middle of that."""
    camera, pose = cameras[kind](), random_pose(rng)
    if kind != "rolling shutter":
        return camera, pose, pose
    return camera, roll(pose, (0.1, -0.05, 0.08, 0.05, 0.08, -0.04)), pose


def sphere_depth(origins, rays, center, radius):
    """Distance to a sphere, from outside or inside; NaN: missed."""
    offset = origins - np.asarray(center)
    b = np.sum(offset * rays, -1)
    root = b * b - np.sum(offset * offset, -1) + radius**2
    with np.errstate(invalid="ignore"):
        near, far = -b - np.sqrt(root), -b + np.sqrt(root)
    return np.where(near > 0, near, np.where(far > 0, far, np.nan))


def box_depth(origins, rays, half):
    """Distance to an axis-parallel box about the origin, from outside or inside; NaN: missed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - origins) / rays, (half - origins) / rays
    near = np.minimum(one, other).max(-1)
    far = np.maximum(one, other).min(-1)
    hit = (near <= far) & (far > 0)
    return np.where(hit, np.where(near > 0, near, far), np.nan)


def looking(place, target=(0, 0, 0)):
    """(4, 4) camera_from_world at a place, towards a target."""
    forward = np.asarray(target, float) - place
    forward /= np.linalg.norm(forward)
    side = np.cross(forward, [0.3, 1, 0.2])
    side /= np.linalg.norm(side)
    rotation = np.stack([side, np.cross(forward, side), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ place
    return pose


def directions(count):
    """(count, 3) unit vectors spread evenly."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], 1)


def fused(cameras, motions, depth_of, voxel, *, center=(0, 0, 0), inner=np.inf, truncation=4):
    """The distance field of exact depths; depth_of(origins, rays) -> (H, W)."""
    views = _core.DepthViews(list(center))
    for camera, motion in zip(cameras, motions, strict=True):
        origins, rays, valid = lines_of(camera, motion)
        depth = np.where(valid, depth_of(origins, rays), np.nan).astype(np.float32)
        views.add(camera, motion, depth, None, None)
    return views.fuse(voxel, inner, truncation, 0.1, 0)


def make_ball(voxel, camera):
    """Vertices and faces of a unit sphere, fused from 12 views of its exact depths."""

    def depth(origins, rays):
        found = sphere_depth(origins, rays, np.zeros(3), 1.0)
        return np.where(np.isnan(found), np.inf, found)

    return fused([camera] * 12, [looking(3 * d) for d in directions(12)], depth, voxel).mesh()


def edge_counts(faces):
    """(E,) number of triangles at each edge."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def fans(faces, vertices):
    """(V,) number of separate fans of triangles around each vertex: 1 on a manifold."""
    around = collections.defaultdict(list)
    for a, b, c in faces.tolist():
        around[a].append((b, c))
        around[b].append((c, a))
        around[c].append((a, b))
    counts = np.zeros(vertices, int)
    for vertex, links in around.items():
        following = dict(links)
        while following:
            _, after = following.popitem()
            while after in following:
                after = following.pop(after)
            counts[vertex] += 1
    return counts


def volume(vertices, faces):
    """Signed volume of a closed mesh: positive if its faces look outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.sum(np.cross(a, b) * c) / 6)


def plane_run(folder):
    """A finished run on the small dataset of the plane z = 0: flat opaque Gaussians on it."""
    data = small_datasets.write_nerfstudio(folder / "data")
    run = RunFolder.create(
        folder / "run", gsut.TrainOptions(), environment=describe_environment(data)
    )
    side = np.linspace(-4, 4, 41)
    xy = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    count = len(xy)
    discs = gsut.Gaussians(
        np.concatenate([xy, np.zeros((count, 1))], 1).astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        np.tile(np.log([0.15, 0.15, 1e-3]).astype(np.float32), (count, 1)),
        np.full(count, 5, np.float32),
        np.zeros((count, 1, 3), np.float32),
    )
    gsut.formats.save_ply(run.path / RunFile.SCENE, discs)
    return run.path
