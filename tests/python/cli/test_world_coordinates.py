"""Outputs of every command lie in the dataset's coordinates, near its zero and far from it."""

import json
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut.cli import main
from gsut.data.points import load_points_ply
from gsut.formats import list_formats
from gsut.render import PixelFilter, to_uint8, write_png
from random_scenes import pinhole
from rendered_dataset import poses, truth, write_dataset

UTM = np.array([691_234.5, 5_334_567.25, 519.125])
NEAR = np.array([3.0, -2.0, 1.5])
WORDS = ["--steps", "150", "--max-gaussians", "600", "--sh-degree", "0", "--quiet"]


def write_moved(folder, offset, rng):
    """The rendered dataset with poses and points moved by `offset`; the points in double."""
    write_dataset(folder, rng)
    file = folder / "transforms.json"
    points = gsut.load_dataset(folder).points
    values = json.loads(file.read_text())
    for frame in values["frames"]:
        for row, by in zip(frame["transform_matrix"], offset, strict=False):
            row[3] += by
    file.write_text(json.dumps(values))
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    rows = "".join("{:.17g} {:.17g} {:.17g}\n".format(*(point + offset)) for point in points)
    (folder / "points3D.ply").write_text(header + rows)
    return folder


@pytest.fixture(
    scope="module",
    params=[pytest.param(NEAR, id="near", marks=pytest.mark.slow), pytest.param(UTM, id="utm")],
)
def case(request, tmp_path_factory):
    """Offset, dataset and run."""
    folder = tmp_path_factory.mktemp("world")
    data = write_moved(folder / "data", request.param, np.random.default_rng(20260821))
    assert main(["train", str(data), "-o", str(folder / "run"), *WORDS]) == 0
    return request.param, data, folder / "run"


def moved_by(pose, offset):
    moved = pose.copy()
    moved[:3, 3] -= pose[:3, :3] @ offset
    return moved


def psnr_of(gaussians, data):
    """What the README's snippet gives: a file, the dataset's poses, `render`."""
    scene = gsut.load_dataset(data)
    found = []
    for index in scene.test_indices:
        image = gsut.render(gaussians, scene.camera(index), scene.views[index].motion).image
        photograph = scene.image(index).astype(np.float32) / 255
        found.append(gsut.psnr(np.clip(image, 0, 1), photograph, scene.mask(index)))
    return np.mean(found)


def test_scene_and_views_are_in_the_datasets_coordinates(case):
    offset, data, _ = case
    scene = gsut.load_dataset(data)
    assert not scene.world_offset.any()
    for view, pose in zip(scene.views, poses(), strict=True):
        atol = tolerances.DATA_UTM_POSITION
        np.testing.assert_allclose(view.camera_from_world, moved_by(pose, offset), atol=atol)
        center = -pose[:3, :3].T @ pose[:3, 3] + offset
        np.testing.assert_allclose(view.camera_center, center, atol=atol)
    assert np.linalg.norm(scene.points.mean(axis=0) - offset) < 1
    near = scene.centred
    np.testing.assert_allclose(near.points + near.world_offset, scene.points, rtol=1e-15)
    assert near.centred is near and near.move_origin((0, 0, 0)).centred is near
    half = scene.scale_images(0.5).replace(notes=())
    np.testing.assert_array_equal(
        half.centred.views[3].camera_from_world, near.views[3].camera_from_world
    )
    assert half.centred.cameras == half.cameras


def test_scene_file_with_the_datasets_poses_gives_the_psnr_of_the_run(case):
    offset, data, run = case
    metrics = json.loads((run / "metrics.json").read_text())
    gaussians = gsut.formats.load_ply(run / "scene.ply")
    assert abs(psnr_of(gaussians, data) - metrics["psnr"]) < tolerances.SAME_FRAME_DB
    middle = np.median(gaussians.means, axis=0) + gaussians.origin
    assert np.linalg.norm(middle - offset) < 1
    far = offset is UTM
    assert gaussians.origin.any() == far
    assert any("float32 cannot hold" in note for note in metrics["notes"]) == far
    header = (run / "scene.ply").read_bytes()[:2000]
    assert (b"comment gsut: dataset coordinates = these + " in header) == far


def test_render_along_a_path_of_the_datasets_poses_shows_these_views(case, tmp_path):
    _, data, run = case
    scene = gsut.load_dataset(data)
    pose = scene.views[3].camera_from_world
    (tmp_path / "path.json").write_text(json.dumps({"camera_from_world": [pose.tolist()]}))
    words = ["--path", str(tmp_path / "path.json"), "-o", str(tmp_path / "out")]
    words += ["--depth", "ray", "--cloud", str(tmp_path / "cloud.ply")]
    assert main(["render", str(run), *words]) == 0
    found = cv2.imread(str(tmp_path / "out" / "00000.png"))[..., ::-1]
    g, camera, train = (
        gsut.formats.load_ply(run / "scene.ply"),
        scene.camera(3),
        scene.train_indices,
    )
    pixels = PixelFilter(g, [scene.camera(row) for row in train], scene.poses(train))
    wanted = gsut.render(pixels.widen(camera, pose), camera, pose).image
    assert np.abs(found.astype(int) - to_uint8(wanted)).max() <= 2
    # Depths with the pose and lens beside them, and the cloud, lie where the points do.
    (view,) = gsut.load_dataset(tmp_path / "out").views
    atol = tolerances.DATA_UTM_POSITION
    np.testing.assert_allclose(view.camera_from_world, pose, rtol=0, atol=atol)
    depth = np.load(view.depth_path)
    seen = gsut.surface.points_from_depth(
        [gsut.surface.DepthMap(camera, view.camera_from_world, depth)]
    ).vertices
    cloud, colors = load_points_ply(tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud, seen, rtol=0, atol=tolerances.CLOUD_UNITS)
    assert len(colors) == len(cloud) > 500
    assert np.linalg.norm(np.median(cloud, axis=0) - np.median(scene.points, axis=0)) < 1


def test_mesh_and_cut_scene_lie_where_the_points_do(case, tmp_path):
    _, data, run = case
    middle = np.median(gsut.load_dataset(data).points, axis=0)
    words = ["--voxel", "0.1", "--support", "0", "--quiet"]
    assert main(["mesh", str(run), "-o", str(tmp_path / "mesh.ply"), *words]) == 0
    vertices = gsut.load_mesh(tmp_path / "mesh.ply").vertices
    assert np.linalg.norm(np.median(vertices, axis=0) - middle) < 1
    box = [f"{value:.17g}" for value in (*(middle - 0.3), *(middle + 0.3))]
    words = ["edit", str(run), "-o", str(tmp_path / "cut.ply"), "--crop-box", *box]
    assert main(words) == 0
    whole, cut = (
        gsut.formats.load_ply(run / "scene.ply"),
        gsut.formats.load_ply(tmp_path / "cut.ply"),
    )
    assert 0 < len(cut) < len(whole)
    assert np.abs(cut.means + cut.origin - middle).max() < 0.3 + tolerances.FORMATS_IN_PLACE


def test_compacted_run_and_file_stay_in_place(case, tmp_path):
    _, data, run = case
    before = json.loads((run / "metrics.json").read_text())["psnr"]
    for source, out in ((run, tmp_path / "fewer"), (run / "scene.ply", tmp_path / "fewer.ply")):
        assert main(["compact", str(source), "-o", str(out), "--keep", "0.9", "--quiet"]) == 0
        file = out if out.is_file() else out / "scene.ply"
        assert psnr_of(gsut.formats.load_ply(file), data) > before - tolerances.COMPACT_IN_PLACE_DB


def test_localize_gives_the_datasets_pose(case, tmp_path, capsys):
    offset, _, run = case
    pose = gsut.exp_pose([0.1, -0.05, 0.1, 0.03, -0.05, 0.02]) @ poses()[4]
    g = truth(np.random.default_rng(20260821))
    image = tmp_path / "photo.png"
    write_png(image, to_uint8(gsut.render(g, pinhole(48), pose).image))
    assert main(["localize", str(image), "--run", str(run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    center = offset - pose[:3, :3].T @ pose[:3, 3]
    assert np.linalg.norm(found["center"] - center) < tolerances.LOCALIZED_ROUGHLY
    matrix = np.array(found["camera_from_world"])
    np.testing.assert_allclose(-matrix[:3, :3].T @ matrix[:3, 3], found["center"], atol=1e-8)


def test_refined_poses_lie_beside_the_given_ones(case, tmp_path):
    offset, data, _ = case
    run = tmp_path / "run"
    assert main(["train", str(data), "-o", str(run), *WORDS, "--refine-poses"]) == 0
    scene = gsut.load_dataset(run / "transforms.json")
    rows = json.loads((run / "refined.json").read_text())["views"]
    for view, row, pose in zip(scene.views, rows, poses(), strict=True):
        center = offset - pose[:3, :3].T @ pose[:3, 3]
        assert np.linalg.norm(view.camera_center - center) < tolerances.REFINED_IN_PLACE
        matrix = np.array(row["camera_from_world"])
        np.testing.assert_allclose(matrix, view.camera_from_world, atol=1e-8)
    metrics = json.loads((run / "metrics.json").read_text())
    found = gsut.evaluate(gsut.formats.load_ply(run / "scene.ply"), scene, scene.test_indices)
    assert abs(found["psnr"] - metrics["psnr"]) < tolerances.SAME_FRAME_DB


def test_origin_of_a_file_comes_back_and_a_damaged_one_is_refused(tmp_path, rng):
    g = truth(rng).translate(UTM)
    file = tmp_path / "scene.ply"
    gsut.formats.save_ply(file, g)
    np.testing.assert_array_equal(gsut.formats.load_ply(file).origin, UTM)
    np.testing.assert_array_equal(gsut.formats.load_ply(file).means, g.means)
    file.write_bytes(file.read_bytes().replace(b"691234.5 ", b"east "))
    with pytest.raises(gsut.InputError, match="must end in three numbers"):
        gsut.formats.load_ply(file)


def test_every_format_keeps_the_place_or_says_that_it_cannot(case, tmp_path, capsys):
    offset, _, run = case
    source = gsut.formats.load_ply(run / "scene.ply")
    kept = lost = 0
    for each in list_formats():
        if each.read is None or (each.name == "USD" and find_spec("pxr") is None):
            continue
        out = tmp_path / f"scene{each.suffixes[0]}"
        status, told = main(["convert", str(run), str(out), "--json"]), capsys.readouterr()
        if "pip install" in told.err:  # an optional library that is not here
            continue
        assert status == 0
        said = " ".join(json.loads(told.out)["left_out"])
        found = gsut.load_gaussians(out)
        away = np.median(found.means, axis=0) - np.median(source.means, axis=0)
        assert np.linalg.norm(away) < tolerances.FORMATS_IN_PLACE
        if (found.origin == source.origin).all():
            kept += 1
            assert "where the scene lies" not in said
        else:
            lost += 1
            assert "where the scene lies" in said and f"{source.origin[1]:.10g}" in said
    assert kept >= 2 and (lost == 0 or offset is UTM)
