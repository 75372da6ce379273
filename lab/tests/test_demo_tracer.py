"""Tests the demo's tracer: its data sets are complete, reproducible, and true to their geometry."""

import json

import cv2
import numpy as np
import pytest

import lab_tolerances
from gsut.lens import Camera
from gsut.surface.rays import cast_onto
from gsut.surface.worth import build_tree
from lab.demo_tracer import dataset, make_demo_scene
from lab.demo_tracer import views as demo_views
from lab.demo_tracer.__main__ import main as pack
from lab.demo_tracer.hall import HALF_X, HALF_Y, HEIGHT, make_hall
from lab.demo_tracer.hall_mesh import build_hall_mesh
from lab.demo_tracer.shapes import Box, Cylinder, Rays, Sphere
from lab.demo_tracer.texture import Material
from surface_scenes import edge_counts

VIEWS, TEST_VIEWS, SIZE, SEED = 6, 2, 64, 3
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def demo_folder(tmp_path_factory):
    """A small demo data set."""
    folder = tmp_path_factory.mktemp("demo") / "data"
    assert make_demo_scene(folder, VIEWS, TEST_VIEWS, SIZE, SEED, progress=False) == folder
    return folder


@pytest.fixture(scope="module")
def transforms(demo_folder):
    return json.loads((demo_folder / "transforms.json").read_text())


def poses_of(transforms):
    """World-from-camera with OpenCV axes, by file name."""
    return {
        frame["file_path"]: np.array(frame["transform_matrix"]) @ OPENCV_FROM_OPENGL
        for frame in transforms["frames"]
    }


def read_points(path):
    header, data = path.read_bytes().split(b"end_header\n")
    count = int(header.split(b"element vertex ")[1].split(b"\n")[0])
    layout = [("xyz", "<f8", 3), ("rgb", "u1", 3)]
    vertices = np.frombuffer(data, dtype=layout)
    assert len(vertices) == count
    return vertices["xyz"], vertices["rgb"]


def read_image(path):
    return cv2.imread(str(path))[..., ::-1]


def test_demo_scene_points_lie_on_surfaces_with_their_colour(demo_folder, transforms):
    points, colors = read_points(demo_folder / "points3D.ply")
    assert len(points) == 4000
    hall, camera = make_hall(SEED), demo_views.make_camera(SIZE)
    off_surface = np.full(len(points), np.inf)
    off_color = np.full(len(points), np.inf)
    for name, pose in poses_of(transforms).items():
        if name not in transforms["train_filenames"]:
            continue
        in_camera = (points - pose[:3, 3]) @ pose[:3, :3]
        away = np.linalg.norm(in_camera, axis=1)
        pixels, valid = camera.project(in_camera)
        exact = dataset.measure_distances(hall, pose, in_camera / away[:, None])
        off_surface = np.minimum(off_surface, np.where(valid, np.abs(exact - away), np.inf))
        image = np.pad(read_image(demo_folder / name).astype(int), ((2, 2), (2, 2), (0, 0)))
        column, row = np.clip(np.nan_to_num(pixels), 0, SIZE - 1).astype(int).T
        for dy in (1, 2, 3):  # the perturbed point may project beside its pixel
            for dx in (1, 2, 3):
                difference = np.abs(image[row + dy, column + dx] - colors).max(axis=1)
                off_color = np.minimum(off_color, np.where(valid, difference, np.inf))
    assert np.median(off_surface) < lab_tolerances.DEMO_POINT_MEDIAN
    assert np.quantile(off_surface, 0.99) < lab_tolerances.DEMO_POINT_FAR
    assert np.mean(off_color == 0) > lab_tolerances.DEMO_POINT_COLOR_SHARE


def test_demo_scene_labels_name_the_surface_at_the_depth_of_each_pixel(demo_folder, transforms):
    rays, valid = demo_views.make_camera(SIZE).rays()
    hall = make_hall(SEED)
    checked, found = 0, set()
    for name, pose in poses_of(transforms).items():
        labels = cv2.imread(
            str(demo_folder / name.replace("images", "labels")), cv2.IMREAD_UNCHANGED
        )
        assert labels.dtype == np.uint8
        assert np.all((labels == dataset.NO_LABEL) == ~valid)
        found |= set(labels[valid].tolist())
        away = dataset.measure_distances(hall, pose, rays[valid])
        points = away[:, None] * (rays[valid] @ pose[:3, :3].T) + pose[:3, 3]
        sides = np.stack([points[:, 0] + HALF_X, HALF_X - points[:, 0], points[:, 1] + HALF_Y,
                          HALF_Y - points[:, 1], points[:, 2], HEIGHT - points[:, 2]])  # fmt: skip
        on_side = labels[valid] < len(sides)
        to_its_side = sides[labels[valid][on_side], np.flatnonzero(on_side)]
        assert np.abs(to_its_side).max() < lab_tolerances.DEMO_DEPTH
        checked += 1
    assert checked == VIEWS + TEST_VIEWS
    assert 20 < len(found) <= len(hall.room.sides) + len(hall.shapes)


@pytest.mark.parametrize("central", [True, False])
def test_demo_scene_colour_is_the_same_from_another_view(central, demo_folder, tmp_path):
    # Depth of a test view carries its pixels into the training views that see the same point.
    hall, camera = make_hall(SEED), demo_views.make_camera(SIZE)
    if not central:  # a window of three metres, every ray of which starts elsewhere
        camera = Camera("orthographic", [SIZE / 3, SIZE / 3, SIZE / 2, SIZE / 2], SIZE, SIZE)
        demo_folder = make_demo_scene(
            tmp_path / "data", VIEWS, TEST_VIEWS, SIZE, SEED, False, camera
        )
    (rays, _), origins = camera.rays(), camera.origins()
    mask = cv2.imread(str(demo_folder / "mask.png"), cv2.IMREAD_UNCHANGED) > 0
    transforms = json.loads((demo_folder / "transforms.json").read_text())
    poses = poses_of(transforms)
    differences = []
    for name in transforms["test_filenames"]:
        depth = cv2.imread(str(demo_folder / name.replace("images", "depth")), cv2.IMREAD_UNCHANGED)
        points = origins[mask] + rays[mask] * (depth[mask] / 1000.0)[:, None]
        points = points @ poses[name][:3, :3].T + poses[name][:3, 3]
        color = read_image(demo_folder / name)[mask].astype(int)
        for other in transforms["train_filenames"]:
            in_camera = (points - poses[other][:3, 3]) @ poses[other][:3, :3]
            pixels, seen = camera.project(in_camera)
            there, _ = camera.unproject(pixels)
            starts, _ = camera.ray_origins(pixels)
            away = np.sum((in_camera - starts) * there, axis=1)
            exact = dataset.measure_distances(hall, poses[other], there, starts)
            seen &= np.abs(exact - away) < 0.02
            column, row = np.clip(np.nan_to_num(pixels), 0, SIZE - 1).astype(int).T
            seen &= mask[row, column]
            there = read_image(demo_folder / other)[row, column].astype(int)
            differences.append(np.abs(there - color).mean(axis=1)[seen])
    together = np.concatenate(differences)
    assert len(together) > 5000
    limit = (
        lab_tolerances.DEMO_VIEW_GREY_LEVELS
        if central
        else lab_tolerances.DEMO_SHARP_VIEW_GREY_LEVELS
    )
    assert np.median(together) < limit


@pytest.mark.parametrize("name", ["box", "sphere", "cylinder"])
def test_shape_hits_lie_on_the_surface_and_face_the_ray(name, rng):
    material = Material(np.zeros((1, 1, 3), np.float32))
    shape = {
        "box": Box((-0.3, -0.2, 0.1), (0.4, 0.5, 0.9), material),
        "sphere": Sphere((0.1, 0.0, 0.4), 0.45, material),
        "cylinder": Cylinder((0.0, 0.1), 0.35, 0.0, 0.8, material),
    }[name]
    count = 20000
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # From all sides towards a ball around the shape.
    origins = rng.uniform((-0.6, -0.6, -0.2), (0.6, 0.6, 1.0), (count, 3)) - 3 * directions
    rays = Rays(tuple(origins.T.astype(np.float32)), tuple(directions.T.astype(np.float32)))
    distance = shape.intersect(rays)
    hit = np.isfinite(distance)
    assert 0.1 < hit.mean() < 0.9
    points = tuple(p[hit].astype(np.float64) for p in rays.locate(np.where(hit, distance, 0)))
    normal = shape.compute_normals(points)
    facing = sum(n * d[hit] for n, d in zip(normal, directions.T, strict=True))
    assert np.all(facing < 0)
    x, y, z = points
    if name == "box":
        outside = np.max(
            [
                np.abs(p - 0.5 * (a + b)) - 0.5 * (b - a)
                for p, a, b in zip(points, shape.low, shape.high, strict=True)
            ],
            axis=0,
        )
    elif name == "sphere":
        outside = np.sqrt((x - 0.1) ** 2 + y**2 + (z - 0.4) ** 2) - 0.45
    else:
        outside = np.maximum(np.hypot(x, y - 0.1) - 0.35, np.abs(z - 0.4) - 0.4)
    np.testing.assert_allclose(outside, 0, rtol=0, atol=lab_tolerances.DEMO_SURFACE)
    # Marched: nothing of the way to the hit lies inside, nor anything of a missing ray.
    steps = np.linspace(0, 6, 200, dtype=np.float32)[:, None]
    marched = rays.locate(np.minimum(steps, np.where(hit, distance, 6) - np.float32(1e-3)))
    x, y, z = (m.astype(np.float64) for m in marched)
    inside = {
        "box": np.all([(m > a) & (m < b) for m, a, b in
                       zip((x, y, z), shape.low, shape.high, strict=True)], axis=0),
        "sphere": (x - 0.1) ** 2 + y**2 + (z - 0.4) ** 2 < 0.45**2,
        "cylinder": (x**2 + (y - 0.1) ** 2 < 0.35**2) & (np.abs(z - 0.4) < 0.4),
    }[name]  # fmt: skip
    assert not inside.any()


def test_hall_as_a_mesh_is_the_hall_that_is_drawn():
    hall = make_hall(0)
    mesh = build_hall_mesh(hall)
    assert np.all(edge_counts(mesh.faces) == 2)
    camera, pose = demo_views.make_camera(100), demo_views.plan_walk(35, 0)[3]
    rays, valid = camera.rays()
    found = cast_onto(build_tree(mesh), camera, np.linalg.inv(pose))[0][valid]
    error = np.abs(found - dataset.measure_distances(hall, pose, rays[valid]))
    assert np.isfinite(found).all()
    # At an edge of a shape one of them may just miss it.
    assert np.mean(error > lab_tolerances.HALL_MESH) < 1e-3


def test_demo_scenes_that_come_with_gsut_are_what_is_traced(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["demo_tracer", "--check"])
    assert pack() == 0, capsys.readouterr().out
