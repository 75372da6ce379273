"""Fusion beside Open3D's, where a Python has it: a pinhole, exact depths."""

import os
import subprocess

import numpy as np
import pytest

import lab_tolerances
from gsut.surface import Mesh
from gsut.surface.worth import build_tree
from random_scenes import pinhole
from surface_scenes import box_depth, directions, fused, lines_of, looking, sphere_depth

# A Python of its own: what comes with Open3D does not go with these tests.
PYTHON = os.environ.get("GSUT_OPEN3D_PYTHON")
pytestmark = pytest.mark.skipif(
    PYTHON is None, reason="GSUT_OPEN3D_PYTHON does not name a Python with open3d"
)
VOXEL, TRUNCATION = 0.03, 4
HALF = np.array([1.0, 0.8, 0.9])
FUSE = """
import sys
import numpy as np
import open3d as o3d

given = np.load(sys.argv[1])
voxel, truncation, fx, fy, cx, cy = given["numbers"]
integration = o3d.pipelines.integration
# Not its scalable volume, which in 0.20.0 opens no block and stays empty.
side = 3.0
kind, corner = integration.TSDFVolumeColorType.RGB8, np.full(3, -side / 2)
volume = integration.UniformTSDFVolume(side, round(side / voxel), truncation, kind, corner)
height, width = given["depths"].shape[1:]
lens = o3d.camera.PinholeCameraIntrinsic(width, height, fx, fy, cx, cy)
grey = o3d.geometry.Image(np.zeros((height, width, 3), np.uint8))
for depth, pose in zip(given["depths"], given["poses"]):
    image = o3d.geometry.RGBDImage.create_from_color_and_depth(
        grey, o3d.geometry.Image(depth), 1.0, 100.0, False
    )
    volume.integrate(image, lens, pose)
mesh = volume.extract_triangle_mesh()
np.savez(sys.argv[2], vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.triangles))
"""


def fused_by_open3d(folder, camera, poses, depth_of):
    """Vertices and faces of its TSDF volume, which takes depths along the axis, 0: nothing."""
    depths = []
    for pose in poses:
        origins, rays, _ = lines_of(camera, pose)
        depths.append(np.nan_to_num(depth_of(origins, rays)) * camera.rays()[0][..., 2])
    fx, fy, cx, cy = camera.params
    numbers = [VOXEL, TRUNCATION * VOXEL, fx, fy, cx - 0.5, cy - 0.5]
    np.savez(folder / "in.npz", numbers=numbers, depths=np.float32(depths), poses=poses)
    words = [PYTHON, "-c", FUSE, str(folder / "in.npz"), str(folder / "out.npz")]
    subprocess.run(words, check=True)
    found = np.load(folder / "out.npz")
    return found["vertices"], found["faces"].astype(np.uint32)


def both(folder, depth_of):
    """Our mesh and Open3D's: vertices, faces."""
    camera = pinhole(160)
    poses = [looking(3.0 * d) for d in directions(24)]
    ours = fused([camera] * 24, poses, depth_of, VOXEL, truncation=TRUNCATION).mesh()
    return ours, fused_by_open3d(folder, camera, poses, depth_of)


def test_ball_through_a_pinhole_lies_on_that_of_open3d(tmp_path):
    ours, theirs = both(
        tmp_path, lambda origins, rays: sphere_depth(origins, rays, np.full(3, 0.02), 1.0)
    )
    for (points, _), other in ((ours, theirs), (theirs, ours)):
        away = build_tree(Mesh(*other)).nearest(points)[0] / VOXEL
        print("voxels apart: mean", away.mean(), "worst", away.max())
        assert away.mean() < lab_tolerances.OPEN3D_MEAN_VOXELS


def test_faces_of_a_box_are_nearer_to_the_truth_than_those_of_open3d(tmp_path):
    errors = []
    for points, _ in both(tmp_path, lambda origins, rays: box_depth(origins, rays, HALF)):
        outside = np.abs(points) - HALF
        flat = np.sort(outside, axis=1)[:, 1] < -2 * VOXEL  # edges are round in both
        errors.append(np.abs(outside.max(axis=1))[flat].mean() / VOXEL)
    print("voxels from the faces: ours", errors[0], "Open3D's", errors[1])
    assert errors[0] < errors[1] and errors[0] < lab_tolerances.OPEN3D_MEAN_VOXELS
