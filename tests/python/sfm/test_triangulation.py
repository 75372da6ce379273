"""Points with a dataset's own poses: exact geometry, any shutter, any origin; no file lost."""

import dataclasses

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut.cli import main
from gsut.data.points import format_points_ply, load_points_ply
from gsut.demo import make_demo_scene
from gsut.demo.hall import make_hall
from gsut.demo.tracing import Tracer
from gsut.sfm import PosesOptions
from gsut.sfm.points.flow import _sample_image, follow_pixels

DENSE = 6000


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("points") / "hall"
    return make_demo_scene(folder, views=16, test_views=1, size=160, progress=False)


@pytest.fixture(scope="module")
def without_points(hall, tmp_path_factory):
    """The hall, its photographs linked, naming no points."""
    folder = tmp_path_factory.mktemp("bare")
    for name in ("images", "mask.png", "depth"):
        (folder / name).symlink_to(hall / name)
    text = (hall / "transforms.json").read_text()
    (folder / "transforms.json").write_text(text.replace("ply_file_path", "once_ply_file_path"))
    return folder


def relative_errors(points, scene):
    """(P,) exact distance of the surface along the ray, from the camera that fits best."""
    tracer, best = Tracer(make_hall(0), 1), np.full(len(points), np.inf)
    for view in scene.views[::2]:
        rays = points - view.camera_center
        away = np.linalg.norm(rays, axis=1)
        exact = tracer.trace_depths(view.camera_center, rays / away[:, None])
        best = np.minimum(best, np.abs(exact - away) / away)
    return best


def test_triangulate_points_lie_on_the_surfaces(hall):
    scene = gsut.load_dataset(hall)
    sparse = gsut.poses.triangulate(scene)
    assert len(sparse) > 300
    errors = relative_errors(sparse.positions, scene)
    assert np.median(errors) < tolerances.POINTS_MEDIAN_RELATIVE
    assert np.quantile(errors, 0.9) < tolerances.POINTS_NINETY_RELATIVE
    dense = gsut.poses.triangulate(scene, dense=DENSE)
    assert len(dense) > len(sparse) + DENSE / 10
    np.testing.assert_array_equal(dense.positions[: len(sparse)], sparse.positions)
    errors = relative_errors(dense.positions[len(sparse) :], scene)
    assert np.median(errors) < tolerances.POINTS_DENSE_MEDIAN_RELATIVE
    assert dense.views[len(sparse) :].min() >= 3
    assert np.ptp(dense.colors) > 100


def test_triangulate_sponza_agrees_with_the_exact_depth_of_a_held_out_view(shared):
    scene = gsut.load_dataset(shared / "data" / "sponza_fisheye")
    view = scene.views[scene.test_indices[3]]
    away = [np.linalg.norm(scene.views[i].camera_center - view.camera_center)
            for i in scene.train_indices]  # fmt: skip
    nearest = [scene.views[scene.train_indices[i]] for i in np.argsort(away)[:10]]
    found = gsut.poses.triangulate(
        scene.replace(views=nearest, train_indices=range(10), test_indices=())
    )
    assert len(found) > 500
    depth = cv2.imread(str(view.depth_path), cv2.IMREAD_UNCHANGED) / 1000.0
    pose, camera = view.camera_from_world, scene.camera(scene.test_indices[3])
    relative = found.positions @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(relative)
    rows = np.flatnonzero(valid)
    column, row = pixels[rows].astype(int).T
    exact, away = depth[row, column], np.linalg.norm(relative[rows], axis=1)
    errors = (np.abs(exact - away) / away)[exact > 0]
    assert len(errors) > 300
    assert np.median(errors) < tolerances.POINTS_SPONZA_MEDIAN_RELATIVE


def test_triangulate_far_from_the_origin_gives_the_same_points(hall):
    scene = gsut.load_dataset(hall)
    shift = np.array([500_000.0, 5_400_000.0, 300.0])
    far = scene.move_origin(-shift).replace(world_offset=np.zeros(3))
    near = gsut.poses.triangulate(scene, PosesOptions(max_features=300))
    moved = gsut.poses.triangulate(far, PosesOptions(max_features=300))
    assert np.abs(moved.positions - shift - near.positions).max() < tolerances.POINTS_FAR_METRES


def test_triangulate_a_rolling_shutter_keeps_its_motion(hall):
    """Each view turns while it is read; the truth is as if each feature had its own pose."""
    from gsut import _core

    rng = np.random.default_rng(0)
    camera = gsut.Camera("pinhole", [300, 300, 160, 120], 320, 240)
    points = rng.uniform([-2, -2, 4], [2, 2, 7], (120, 3))
    poses, ends, pixels = [], [], []
    shutter = gsut.Shutter("top_to_bottom")
    for x in (-0.6, 0.0, 0.5):
        start, end = (gsut.exp_pose([x + s, 0, 0, 0, s, 0.5 * s]) for s in (-0.05, 0.05))
        motion = gsut.CameraMotion(start, end, shutter)
        at = np.full((len(points), 2), 120.0)
        for _ in range(20):
            turned = [motion.at(float(y / 240)) for y in at[:, 1]]
            seen = np.array([p[:3, :3] @ q + p[:3, 3] for p, q in zip(turned, points, strict=True)])
            at = camera.project(seen)[0]
        poses.append(np.asarray(motion.at(0.5)))
        ends.append((start, end))
        pixels.append(at)
    every = np.repeat(np.arange(len(points), dtype=np.int32)[:, None], 2, axis=1)
    pairs = [(a, b, every, np.eye(4), 0, 0.0) for a, b in ((0, 1), (0, 2), (1, 2))]
    settings = {"max_error": 1.0, "min_angle": 0.01, "shutter": "top_to_bottom"}
    found = _core.triangulate_structure(
        [camera], [0, 0, 0], pixels, pairs, poses, ends, settings, None
    )
    assert len(found["points"]) == len(points)
    off = np.abs(found["points"] - points).max()
    assert off < tolerances.POINTS_ROLLING
    still = _core.triangulate_structure(
        [camera], [0, 0, 0], pixels, pairs, poses, [], {"max_error": 1.0, "min_angle": 0.01}, None
    )
    assert np.abs(still["points"] - points).max() > 100 * tolerances.POINTS_ROLLING


def test_triangulate_wrong_poses_says_so(hall):
    scene = gsut.load_dataset(hall)
    views = [
        dataclasses.replace(v, camera_from_world=np.linalg.inv(v.camera_from_world))
        for v in scene.views
    ]
    with pytest.raises(gsut.InputError, match="matches fit the given poses"):
        gsut.poses.triangulate(scene.replace(views=views), PosesOptions(max_features=300))


def test_flow_of_views_without_common_points_is_empty(hall):
    scene = gsut.load_dataset(hall)
    none = np.zeros((0, 3), np.int32)
    pixels = [np.zeros((0, 2))] * len(scene)
    flow = follow_pixels(scene, np.zeros((0, 3)), none, pixels, 500, lambda *a: None)
    assert flow.matches == []


def test_points_command_writes_what_train_starts_from(without_points, capsys):
    data = str(without_points)
    assert main(["points", data]) == 0
    said = capsys.readouterr().out
    assert "points, each in" in said and "triangulated.ply" in said and "gsut train" in said
    before = (without_points / "triangulated.ply").read_bytes()
    scene = gsut.load_dataset(data)
    assert len(scene.points) > 300
    assert any("points of `gsut points` are used" in note for note in scene.notes)
    assert main(["points", data]) == 2
    assert "give another file" in capsys.readouterr().err
    assert (without_points / "triangulated.ply").read_bytes() == before


def test_points_command_overwrites_nothing_and_leaves_the_datasets_points(hall, tmp_path, capsys):
    assert main(["points", str(hall)]) == 2
    assert "has 4,000 points, which stay in use" in capsys.readouterr().err
    out = tmp_path / "new.ply"
    out.write_text("mine")
    assert main(["points", str(hall), "-o", str(out)]) == 2
    assert out.read_text() == "mine"
    assert main(["points", str(hall), "-o", str(tmp_path / "new.txt")]) == 2
    assert main(["points", str(hall), "--dense", "-5"]) == 2


def test_points_command_colours_a_cloud(hall, tmp_path, capsys):
    scene = gsut.load_dataset(hall)
    cloud = tmp_path / "lidar.ply"
    hidden = np.array([[0.0, 0.0, -50.0]])
    cloud.write_bytes(
        format_points_ply(
            np.concatenate([scene.points, hidden]), np.full((len(scene.points) + 1, 3), 128)
        )
    )
    assert main(["points", str(hall), "--colour", str(cloud)]) == 0
    assert "points coloured" in capsys.readouterr().out
    points, colors = load_points_ply(tmp_path / "lidar_coloured.ply")
    np.testing.assert_array_equal(points[:-1], scene.points)
    off = np.abs(colors[:-1].astype(float) - scene.point_colors).mean(axis=1)
    assert np.median(off) < tolerances.POINTS_COLOUR_LEVELS
    empty = tmp_path / "empty.ply"
    empty.write_bytes(format_points_ply(np.zeros((0, 3)), np.zeros((0, 3))))
    assert main(["points", str(hall), "--colour", str(empty)]) == 2
    assert "coordinates and unit" in capsys.readouterr().err


def test_train_colours_points_that_have_none(hall, tmp_path, capsys):
    scene = gsut.load_dataset(hall)
    grey = scene.replace(point_colors=np.full_like(scene.point_colors, 128))
    assert not gsut.data.points.has_colors(grey)
    options = gsut.TrainOptions(steps=1, max_gaussians=2000, sh_degree=0)
    found = [gsut.train(s, options, progress=False).gaussians.sh[:, 0] for s in (scene, grey)]
    same = np.corrcoef(found[0].ravel(), found[1].ravel())[0, 1]
    assert same > 0.8


def test_flow_at_more_places_than_opencv_takes_at_once(rng):
    ramp = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0)), axis=-1).astype(np.float32)
    places = rng.integers(0, 6, (70_000, 2)) + 0.5
    assert np.array_equal(_sample_image(ramp, places), places - 0.5)
