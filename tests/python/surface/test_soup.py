"""Triangles of a model as a mesh: they cover what the render hides at least by half."""

import dataclasses

import cv2
import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.gaussians import SH_C0
from gsut.surface import load_mesh, make_soup, save_mesh
from random_scenes import pinhole

pytestmark = pytest.mark.quick

COLORS = np.array([[0.9, 0.2, 0.4], [0.1, 0.7, 0.5]])


@pytest.fixture
def model():
    """Two triangles that do not overlap as the views see them, and one too faint for a mesh."""
    means = np.array([[-0.8, 0.1, 3.0], [0.7, -0.2, 3.4], [0.0, 0.5, 3.2]])
    quats = np.array([[0.9, 0.2, -0.3, 0.4], [0.7, -0.1, 0.2, -0.8], [1.0, 0, 0, 0]])
    scales = np.log([[0.25, 0.18, 1.0], [0.2, 0.3, 1.0], [0.1, 0.1, 1.0]])
    sh = (np.concatenate([COLORS, [[0.5] * 3]]) - 0.5)[:, None] / SH_C0
    return gsut.Gaussians(
        means, quats, scales, np.array([3.0, 2.0, -0.5]), sh, primitive="triangle"
    ).to_dtype(np.float32)


@pytest.fixture
def scene():
    poses = np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, 0, 3] = (-0.1, 0.0, 0.1)
    images = [np.zeros((160, 160, 3), np.uint8)] * 3
    return gsut.scene_from_arrays(images, [pinhole(160, 160, focal=150.0)] * 3, poses, test_every=0)


def test_soup_covers_the_pixels_that_triangles_hide_by_half(model, scene):
    mesh = make_soup(model, scene)
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert np.allclose(mesh.colors, np.repeat(COLORS, 3, axis=0), atol=1e-6)
    camera = scene.camera(0)
    for number, corners in enumerate(mesh.vertices.reshape(-1, 3, 3)):
        alpha = gsut.render(model[number : number + 1], camera, np.eye(4)).alpha
        pixels, _ = camera.project(corners)
        drawn = np.zeros(alpha.shape, np.uint8)
        cv2.fillPoly(drawn, [np.rint(16 * (pixels - 0.5)).astype(np.int32)], 1, shift=4)
        rim = cv2.dilate(drawn, np.ones((3, 3))) != cv2.erode(drawn, np.ones((3, 3)))
        assert drawn.sum() > 100
        assert np.array_equal((alpha > 0.5)[~rim], (drawn == 1)[~rim])


def test_soup_goes_through_files(model, scene, tmp_path):
    mesh = make_soup(model, scene)
    for suffix in (".off", ".ply", ".obj"):
        save_mesh(tmp_path / f"a{suffix}", mesh)
        found = load_mesh(tmp_path / f"a{suffix}")
        assert np.allclose(found.vertices, mesh.vertices, atol=1e-6)
        assert np.array_equal(found.faces, mesh.faces)
    text = (tmp_path / "a.off").read_text().split("\n")
    assert text[0] == "COFF" and text[2].endswith(" 230 51 102 255")
    (tmp_path / "b.off").write_text("OFF 3 1 0\n0 0 0 # a corner\n1 0 0\n0 1 0\n\n3 0 1 2\n")
    assert load_mesh(tmp_path / "b.off").faces.tolist() == [[0, 1, 2]]
    (tmp_path / "b.off").write_text("OFF\n3 1 0\n0 0 0\n")
    with pytest.raises(InputError, match="1 rows for 3 vertices and 1 faces"):
        load_mesh(tmp_path / "b.off")


def test_soup_of_other_primitives_or_of_nothing_opaque_is_refused(model, scene):
    with pytest.raises(InputError, match="found primitive gaussian; train with --primitive tri"):
        make_soup(model.to_primitive("gaussian"), scene)
    faint = dataclasses.replace(model, opacity_logits=model.opacity_logits - 5)
    with pytest.raises(InputError, match="none of the 3 triangles hides half"):
        make_soup(faint, scene)
