"""Meshes fitted to images as they are drawn without blending, through any lens and shutter."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError, _core
from gsut.surface import DepthMap, Mesh, MeshOptions, fuse_depth
from gsut.surface.fit import differentiate_pixels, draw_pixels, fit_mesh, gather_pixels
from gsut.surface.rays import cast_world_rays
from random_scenes import pinhole
from surface_scenes import directions, edge_counts, looking, make_ball, sphere_depth

pytestmark = pytest.mark.quick

FISHEYE = gsut.Camera("kannala_brandt", [14, 14, 20, 20, 0.05, -0.02, 0.0, 0.0], 40, 40)


def paint(points):
    """A smooth pattern on the unit sphere, whatever the distance from its centre."""
    unit = points / np.linalg.norm(points, axis=-1, keepdims=True)
    phases = np.array([[5.0, 1.0, 2.0], [-2.0, 6.0, 1.0], [3.0, -2.0, 5.0]])
    return 0.5 + 0.35 * np.sin(unit @ phases)


def look_at_ball(place, camera, motion):
    """A map of the unit sphere, painted."""
    view = DepthMap(camera, motion, np.zeros((camera.height, camera.width), np.float32))
    origins, rays = cast_world_rays(camera, motion)
    depth = sphere_depth(origins, rays, np.zeros(3), 1.0)
    seen = np.isfinite(depth)
    image = np.zeros((*depth.shape, 3))
    image[seen] = paint(origins[seen] + depth[seen, None] * rays[seen])
    depth = np.where(seen, depth, np.inf).astype(np.float32)
    return dataclasses.replace(view, depth=depth, image=np.round(255 * image).astype(np.uint8))


@pytest.fixture(scope="module")
def views():
    places = [2.5 * d for d in directions(14)]
    return [look_at_ball(place, pinhole(64, focal=70.0), looking(place)) for place in places]


@pytest.fixture(scope="module")
def ball():
    vertices, faces = make_ball(0.15, pinhole(80))
    return Mesh(vertices, faces, np.full(vertices.shape, 0.5))


def ignore(done, total): ...


@pytest.mark.parametrize("rolling", [False, True])
def test_derivatives_of_drawn_pixels_are_differences(ball, rolling):
    pose = looking(np.array([0.3, -0.2, 1.6]))
    motion = pose
    if rolling:
        later = looking(np.array([0.4, -0.1, 1.7]))
        motion = gsut.CameraMotion(pose, later, gsut.Shutter("top_to_bottom"))
    view = gather_pixels(look_at_ball(None, FISHEYE, motion))
    rng = np.random.default_rng(20261127)
    mesh = dataclasses.replace(ball, colors=rng.uniform(size=ball.vertices.shape))
    tree = _core.TriangleTree(mesh.vertices, mesh.faces)
    faces = tree.cast(view.origins, view.rays)[1]
    pixels = dataclasses.replace(
        view, **{f.name: getattr(view, f.name)[faces >= 0] for f in dataclasses.fields(view)}
    )
    faces = faces[faces >= 0]
    assert len(faces) > 100
    normals, moves = mesh.compute_normals(), rng.normal(size=len(mesh.vertices))
    weights, shown = draw_pixels(mesh, faces, pixels)
    assert np.all(weights > -1e-9) and np.all((shown >= 0) & (shown <= 1))
    slopes = differentiate_pixels(mesh, faces, pixels, weights, normals)
    step = 1e-6
    ends = [
        draw_pixels(Mesh(mesh.vertices + e * (moves[:, None] * normals), mesh.faces, mesh.colors),
                    faces, pixels)[1]
        for e in (-step, step)
    ]  # fmt: skip
    expected = (ends[1] - ends[0]) / (2 * step)
    found = np.einsum("nkc,nk->nc", slopes, moves[mesh.faces[faces]])
    steep = np.all(slopes == 0, axis=(1, 2))
    assert steep.mean() < 0.1
    assert (
        np.abs(found - expected)[~steep].max() < tolerances.MESH_FIT_SLOPES * np.abs(expected).max()
    )


def test_colors_are_found_again(ball, views):
    true = dataclasses.replace(ball, colors=paint(ball.vertices))
    tree, drawn = _core.TriangleTree(ball.vertices, ball.faces), []
    for view in views:
        pixels = gather_pixels(view)
        faces = tree.cast(pixels.origins, pixels.rays)[1]
        image, depth = view.image.copy(), view.depth.copy()
        colors = draw_pixels(true, faces, pixels)[1]
        known = np.isfinite(depth)
        image[known] = np.round(255 * np.clip(colors, 0, 1))
        depth[known] = np.where(faces >= 0, depth[known], np.inf)
        drawn.append(dataclasses.replace(view, depth=depth, image=image))
    before = np.abs(ball.colors - true.colors).mean()
    found = fit_mesh(ball, drawn, 0, ignore)
    assert np.array_equal(found.vertices, ball.vertices)
    assert np.abs(found.colors - true.colors).mean() < 0.1 * before


def test_rounds_move_vertices_to_the_surface_that_images_show(ball, views):
    wide = dataclasses.replace(ball, vertices=1.04 * ball.vertices)
    off = [
        np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).mean()
        for mesh in (wide, fit_mesh(wide, views, 4, ignore))
    ]
    assert off[0] == pytest.approx(0.04, abs=2e-3)
    assert off[1] < 0.5 * off[0]


def test_fused_mesh_is_closed_and_fitted(views):
    some = views[:9]  # leave a part of the ball unseen
    means = fuse_depth(some, MeshOptions(voxel=0.12, support=0))
    closed = fuse_depth(some, MeshOptions(voxel=0.12, support=0, holes=100))
    fitted = fuse_depth(some, MeshOptions(voxel=0.12, support=0, holes=100, fit=0))
    assert (edge_counts(means.faces) == 1).any()
    assert (edge_counts(closed.faces) == 2).all()
    assert np.array_equal(closed.faces[: len(means)], means.faces)
    assert np.array_equal(fitted.faces, closed.faces)
    errors = []
    for mesh in (closed, fitted):
        tree = _core.TriangleTree(mesh.vertices, mesh.faces)
        for view in map(gather_pixels, some):
            faces = tree.cast(view.origins, view.rays)[1]
            met = faces >= 0
            view = dataclasses.replace(view, origins=view.origins[met], rays=view.rays[met])
            errors.append(np.mean((draw_pixels(mesh, faces[met], view)[1] - view.colors[met]) ** 2))
    assert np.mean(errors[9:]) < 0.6 * np.mean(errors[:9])
    with pytest.raises(InputError, match="give every depth map one"):
        fuse_depth([dataclasses.replace(some[0], image=None)], MeshOptions(fit=0))
