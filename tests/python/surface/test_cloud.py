"""Clouds of exact depths; what `gsut render` writes is read back."""

import json

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut.cli import main
from gsut.data.points import load_points_ply
from gsut.surface import DepthMap, load_mesh
from random_scenes import fisheye
from surface_scenes import (
    box_depth,
    directions,
    lines_of,
    looking,
    plane_run,
)

HALF = np.array([1.0, 0.8, 0.9])
UTM = np.array([691_234.5, 5_334_567.25, 519.125])


def move_pose(pose, offset):
    """The pose of a camera that moves with the world by an offset."""
    out = np.array(pose)
    out[:3, 3] -= out[:3, :3] @ offset
    return out


def room_maps(offset, count):
    """Exact depths of the inside of a box, through fisheyes beyond 90 degrees."""
    towards, camera, maps = directions(count), fisheye(120), []
    for d, e in zip(towards, towards[::-1], strict=True):
        pose = looking(0.25 * d, d + 0.2 * e)
        origins, rays, valid = lines_of(camera, pose)
        depth = np.where(valid, box_depth(origins, rays, HALF), np.nan).astype(np.float32)
        image = np.full((120, 120, 3), 51, np.uint8)
        maps.append(DepthMap(camera, move_pose(pose, offset), depth, None, image))
    return maps


@pytest.mark.parametrize("offset", [np.zeros(3), UTM], ids=["near", "utm"])
def test_cloud_has_a_point_a_voxel_on_the_walls(offset, tmp_path):
    cloud = gsut.surface.points_from_depth(room_maps(offset, 6), 0.05)
    gsut.save_mesh(tmp_path / "cloud.ply", cloud)
    points, colors = load_points_ply(tmp_path / "cloud.ply")  # as a dataset reads it
    assert len(points) > 3000
    off = np.abs((np.abs(points - offset) - HALF).max(axis=1))
    print(f"{off.max():.1e}")
    assert off.max() < tolerances.CLOUD_UNITS
    cells = np.floor((cloud.vertices - cloud.vertices[0]) / 0.05)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert (colors == 51).all()


@pytest.mark.parametrize("kind", ["ray", "z"])
def test_render_writes_depths_that_lead_back_to_the_plane(kind, tmp_path, capsys):
    run, out = plane_run(tmp_path), tmp_path / "out"
    words = ["render", str(run), "--path", "train", "--frames", "3", "-o", str(out), "--json"]
    words += ["--depth", kind, "--cloud", str(tmp_path / "cloud.ply")]
    assert main(words) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["points"] > 1000
    scene = gsut.load_dataset(out)  # transforms.json beside the images
    assert len(scene) == 3 and not scene.test_indices
    for index, view in enumerate(scene.views):
        camera, stem = scene.camera(index), view.name.rpartition("/")[2].partition(".")[0]
        depth = np.load(out / "depth" / f"{stem}.npy")
        assert (view.depth_path is not None) == (kind == "ray")
        rays, valid = camera.rays()
        rays = rays / rays[..., 2:] if kind == "z" else rays
        pose = view.camera_from_world
        points = (depth[..., None] * rays - pose[:3, 3]) @ pose[:3, :3]
        here = np.isfinite(depth) & valid
        assert here.mean() > 0.9
        assert np.abs(points[here][:, 2]).max() < tolerances.PLANE_POINTS
        levels = cv2.imread(str(out / "depth" / f"{stem}.png"), cv2.IMREAD_UNCHANGED)
        assert np.abs(levels * 1e-3 - depth)[here].max() < tolerances.DEPTH_LEVELS
    cloud = load_mesh(tmp_path / "cloud.ply")
    assert np.abs(cloud.vertices[:, 2]).max() < tolerances.PLANE_POINTS


def test_render_refuses_z_beyond_ninety_degrees(tmp_path, monkeypatch, capsys):
    run = plane_run(tmp_path)
    gsut.save_camera(fisheye(60), tmp_path / "wide.json")
    words = ["render", str(run), "--camera", str(tmp_path / "wide.json"), "-o"]
    assert main([*words, str(tmp_path / "out"), "--depth", "z"]) == 2
    assert "--depth ray" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    words = ["render", str(run), "--frames", "1", "-o", str(tmp_path / "two")]
    monkeypatch.setattr("gsut.cli._render_depth.UNIT", 1e-6)
    assert main([*words, "--depth", "ray"]) == 0
    assert "the .npy files hold them" in capsys.readouterr().err
