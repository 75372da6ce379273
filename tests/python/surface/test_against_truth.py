"""Depths and meshes against truths that are known: figures by hand, exact depths, the hall."""

import json

import cv2
import numpy as np
import pytest

import gsut
import small_datasets
import tolerances
from gsut import InputError, _core
from gsut.cli import main
from gsut.surface import Mesh, save_mesh
from gsut.surface.rays import cast_onto
from gsut.surface.worth import build_tree, judge_depth, judge_mesh
from random_scenes import pinhole
from surface_scenes import box_depth, lines_of, plane_run


def sheet(height, half=4.0):
    """A square at z = height."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    vertices = np.concatenate([corners, np.full((4, 1), height)], axis=1)
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


def test_depth_figures_of_known_errors():
    truth = np.array([[1.0, 2.0, 4.0, 0.0, 5.0]])
    depth = np.array([[1.1, 2.0, 8.0, 3.0, np.nan]])
    figures = judge_depth(depth, truth, np.array([[0.0, 40.0, 70.0, 0.0, 0.0]]))
    assert figures["abs_rel"] == pytest.approx((0.1 + 0 + 1) / 3)
    assert figures["abs_rel_median"] == pytest.approx(0.1)
    assert figures["rmse"] == pytest.approx(np.sqrt((0.01 + 16) / 3))
    assert figures["delta1"] == pytest.approx(2 / 3) and figures["delta3"] == pytest.approx(2 / 3)
    assert figures["coverage"] == pytest.approx(3 / 4) and figures["pixels"] == 3
    assert [ring["pixels"] for ring in figures["rings"]] == [1, 1, 1, 0]
    assert figures["rings"][2]["abs_rel"] == pytest.approx(1.0)
    assert judge_depth(truth * np.nan, truth)["abs_rel"] is None


def test_mesh_figures_of_shifted_sheets():
    figures = judge_mesh(sheet(0.03), sheet(0.0), at=(0.02, 0.05))
    for name in ("accuracy", "completeness", "chamfer"):
        assert figures[name] == pytest.approx(0.03, rel=1e-6)
    assert figures["normal_consistency"] == pytest.approx(1.0)
    assert [row["fscore"] for row in figures["fscores"]] == [0.0, pytest.approx(1.0)]
    half = sheet(0.0, 2.0)  # a quarter of the truth
    row = judge_mesh(half, sheet(0.0), at=(1e-6,))["fscores"][0]
    assert row["precision"] == 1.0 and row["recall"] == pytest.approx(0.25, abs=0.01)


def test_cloud_as_truth_has_no_normals():
    cloud = Mesh(sheet(0.0).vertices, np.zeros((0, 3), np.uint32))
    figures = judge_mesh(sheet(0.0), cloud)
    assert figures["completeness"] == pytest.approx(0.0, abs=1e-12)
    assert figures["normal_consistency"] is None and figures["points"] == 4


def test_what_no_view_sees_of_the_truth_does_not_count(tmp_path):
    scene = gsut.load_dataset(small_datasets.write_nerfstudio(tmp_path))
    top, below = sheet(0.0), sheet(-0.5)
    both = Mesh(
        np.concatenate([top.vertices, below.vertices]),
        np.concatenate([top.faces, below.faces + np.uint32(4)]),
    )
    assert judge_mesh(top, both)["completeness"] == pytest.approx(0.25, abs=0.01)
    assert judge_mesh(top, both, scene)["completeness"] < 1e-9
    with pytest.raises(InputError, match="coordinates"):
        judge_mesh(top, sheet(1000.0), scene)


@pytest.mark.parametrize("direction", ["global", "top_to_bottom", "left_to_right"])
def test_cast_distances_are_exact(direction):
    half = np.array([1.0, 0.8, 0.9])
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) * 2 - 1
    quads = np.array(
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    )
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.uint32)
    camera, motion = pinhole(24), np.eye(4)
    if direction != "global":
        end = gsut.exp_pose(np.array([0.1, 0.2, -0.1, 0.1, 0.2, 0.3]))
        motion = _core.CameraMotion(motion, end, gsut.Shutter(direction))
    found = cast_onto(build_tree(Mesh(bits * half, faces)), camera, motion)[0]
    if direction == "left_to_right":  # line 12 is a column
        pose = motion.at((12 + 0.5) / 24)
        origins, rays, _ = lines_of(camera, pose)
        assert np.allclose(found[:, 12], box_depth(origins, rays, half)[:, 12], atol=1e-9)
        return
    origins, rays, _ = lines_of(camera, motion)
    assert np.allclose(found, box_depth(origins, rays, half), atol=1e-9)


def test_eval_judges_depth_and_mesh_against_a_mesh_and_files(tmp_path, capsys):
    run = plane_run(tmp_path)
    save_mesh(tmp_path / "truth.ply", sheet(0.0))
    words = ["eval", str(run), "--split", "all", "--json"]
    assert main([*words, "--geometry", str(tmp_path / "truth.ply")]) == 0
    geometry = json.loads(capsys.readouterr().out)["geometry"]
    for kind in ("expected", "median", "strongest"):
        assert geometry["depth"][kind]["abs_rel"] < tolerances.PLANE_DEPTH
        assert geometry["depth"][kind]["coverage"] > 0.99
    assert geometry["mesh"]["fscores"][1]["precision"] > 0.95
    scene = gsut.load_dataset(tmp_path / "data")
    (tmp_path / "depth").mkdir()
    tree = build_tree(sheet(0.0))
    for index, view in enumerate(scene.views[:4]):
        true = np.nan_to_num(cast_onto(tree, scene.camera(index), view.motion)[0])
        name = view.name.removeprefix("images/")
        picture = np.round(true * 1000).astype(np.uint16)
        assert cv2.imwrite(str(tmp_path / "depth" / name), picture)
    assert main([*words, "--geometry", str(tmp_path / "depth")]) == 0
    geometry = json.loads(capsys.readouterr().out)["geometry"]
    assert "mesh" not in geometry and geometry["depth"]["views"] == 4
    assert geometry["depth"]["median"]["abs_rel"] < tolerances.PLANE_DEPTH
    assert main([*words, "--geometry"]) == 2
    assert "no depth of these views" in capsys.readouterr().err
    assert main([*words, "--geometry", str(tmp_path / "absent")]) == 2
    assert "no such file or folder" in capsys.readouterr().err
