"""Clouds and grids of exact depths; what `gsut render` and `gsut mesh` write is read back."""

import json

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError
from gsut.cli import main
from gsut.data.points import load_points_ply
from gsut.surface import DepthMap, load_mesh
from random_scenes import fisheye, pinhole
from surface_scenes import (
    box_depth,
    directions,
    lines_of,
    looking,
    plane_run,
    sphere_depth,
)

HALF = np.array([1.0, 0.8, 0.9])
UTM = np.array([691_234.5, 5_334_567.25, 519.125])


def moved(pose, offset):
    out = np.array(pose)
    out[:3, 3] -= out[:3, :3] @ offset
    return out


def room_maps(offset, count=16):
    """Exact depths of the inside of a box, through fisheyes beyond 90 degrees."""
    towards, camera, maps = directions(count), fisheye(120), []
    for d, e in zip(towards, towards[::-1], strict=True):
        pose = looking(0.25 * d, d + 0.2 * e)
        origins, rays, valid = lines_of(camera, pose)
        depth = np.where(valid, box_depth(origins, rays, HALF), np.nan).astype(np.float32)
        image = np.full((120, 120, 3), 51, np.uint8)
        maps.append(DepthMap(camera, moved(pose, offset), depth, None, image))
    return maps


@pytest.mark.parametrize("offset", [np.zeros(3), UTM], ids=["near", "utm"])
def test_grid_of_a_room_is_free_inside_and_exact_at_any_offset(offset, tmp_path):
    voxel = 0.08
    grid = gsut.surface.grid_from_depth(
        room_maps(offset), gsut.surface.MeshOptions(voxel=voxel, support=0)
    )
    steps = np.stack(np.indices(grid.distances.shape), axis=-1)
    places = grid.origin - offset + voxel * steps
    exact = (HALF - np.abs(places)).min(axis=-1)  # inside: the nearest wall
    inside = (exact > 0) & (np.linalg.norm(places, axis=-1) > 0.4)  # the cameras look outwards
    assert np.isfinite(grid.distances[inside]).all()
    flat = inside & (np.sort(HALF - np.abs(places), axis=-1)[..., 1] > 2 * voxel)  # edges are round
    assert flat.sum() > 0.5 * inside.sum()
    worst = np.abs(grid.distances - exact)[flat].max() / voxel
    print(f"{grid}: worst {worst:.3f} voxels")
    assert worst < tolerances.GRID_VOXELS
    assert (grid.occupancy[inside & (exact > 1.5 * voxel)] == 0).all()
    assert (grid.occupancy[np.abs(exact) < 0.25 * voxel] == 100).all()
    gsut.surface.save_grid(tmp_path / "room.npy", grid, occupancy=True)
    told = json.loads((tmp_path / "room.json").read_text())
    levels = np.load(tmp_path / "room.npy")
    assert levels.dtype == np.int8 and list(levels.shape) == told["shape"]
    np.testing.assert_array_equal(told["origin"], grid.origin)
    assert (told["occupied"], told["free"], told["unknown"]) == (100, 0, -1)
    cell = np.floor((offset - told["origin"]) / told["voxel"] + 0.5 + [0.6 / told["voxel"], 0, 0])
    assert levels[tuple(cell.astype(int))] == 0


def test_rays_that_meet_nothing_make_free_space():
    camera, poses, voxel = pinhole(80), [looking(3 * d) for d in directions(14)], 0.1
    maps = []
    for pose in poses:
        origins, rays, _ = lines_of(camera, pose)
        depth = sphere_depth(origins, rays, np.zeros(3), 1.0)
        maps.append(DepthMap(camera, pose, np.nan_to_num(depth, nan=np.inf).astype(np.float32)))
    box = np.array([[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]])
    grid = gsut.surface.grid_from_depth(
        maps, gsut.surface.MeshOptions(voxel=voxel, support=0, crop=box)
    )
    places = grid.origin + voxel * np.stack(np.indices(grid.distances.shape), axis=-1)
    exact = np.linalg.norm(places, axis=-1) - 1
    assert grid.distances.shape == (30, 30, 30)
    known = np.isfinite(grid.distances)
    assert known[exact > 0].mean() > 0.99
    assert np.abs(grid.distances - exact)[known].max() / voxel < tolerances.GRID_VOXELS
    assert not known[exact < -5 * voxel].any()
    with pytest.raises(InputError, match="--voxel"):
        gsut.surface.grid_from_depth(
            maps, gsut.surface.MeshOptions(voxel=1e-4, support=0, crop=box)
        )
    with pytest.raises(InputError, match="nothing to make a grid"):
        gsut.surface.grid_from_depth(
            [DepthMap(camera, poses[0], np.full((80, 80), np.nan, np.float32))]
        )


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


def test_render_refuses_z_beyond_ninety_degrees_and_depths_of_a_film(tmp_path, monkeypatch, capsys):
    run = plane_run(tmp_path)
    gsut.save_camera(fisheye(60), tmp_path / "wide.json")
    words = ["render", str(run), "--camera", str(tmp_path / "wide.json"), "-o"]
    assert main([*words, str(tmp_path / "out"), "--depth", "z"]) == 2
    assert "--depth ray" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["render", str(run), "-o", str(tmp_path / "a.mp4"), "--depth", "ray"]) == 2
    assert "a film has no depths" in capsys.readouterr().err
    words = ["render", str(run), "--frames", "1", "-o", str(tmp_path / "two")]
    monkeypatch.setattr("gsut.cli._render_depth.UNIT", 1e-6)
    assert main([*words, "--depth", "ray"]) == 0
    assert "the .npy files hold them" in capsys.readouterr().err


def test_mesh_writes_a_grid_in_the_datasets_coordinates(tmp_path, capsys):
    run, out = plane_run(tmp_path), tmp_path / "grid.npy"
    words = ["mesh", str(run), "-o", str(out), "--voxel", "0.1", "--json"]
    assert main([*words, "--crop", "-1", "-1", "-0.5", "1", "1", "0.5"]) == 0
    assert json.loads(capsys.readouterr().out)["shape"] == [20, 20, 10]
    values, told = np.load(out), json.loads(out.with_suffix(".json").read_text())
    heights = told["origin"][2] + told["voxel"] * np.arange(10)
    near = np.abs(heights) < 0.1
    off = np.abs(np.abs(values[5:15, 5:15, near]) - np.abs(heights[near]))
    assert off.max() < tolerances.GRID_VOXELS * told["voxel"]
    assert np.isnan(values).any() and (values > 0).any()
    assert main(words) == 2
    assert "exists" in capsys.readouterr().err
    assert main(["mesh", str(run), "-o", str(tmp_path / "a.ply"), "--occupancy"]) == 2
    assert "grids are written as .npy" in capsys.readouterr().err
