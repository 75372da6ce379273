"""Exact depth maps through real lenses become meshes within a quarter voxel of the truth."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError, _core
from random_scenes import fisheye, pinhole, small_camera
from surface_scenes import (
    box_depth,
    directions,
    edge_counts,
    fans,
    fused,
    lines_of,
    looking,
    sphere_depth,
    volume,
)

CENTER, RADIUS, VOXEL = np.array([0.03, 0.02, 0.01]), 1.0, 0.06
HALF = np.array([1.0, 0.8, 0.9])


def ball(origins, rays):
    depth = sphere_depth(origins, rays, CENTER, RADIUS)
    return np.where(np.isnan(depth), np.inf, depth)  # nothing is behind it


def shutter_motions(poses):
    """Each pose with a turn and a shift during the exposure."""
    twist = np.array([0.06, -0.05, 0.04, 0.03, 0.05, -0.06])
    how = gsut.Shutter("top_to_bottom")
    return [_core.CameraMotion(pose, gsut.exp_pose(twist) @ pose, how) for pose in poses]


LENSES = {
    "pinhole": lambda: pinhole(160),
    "kannala_brandt of 190 degrees": lambda: fisheye(220),
    "splined": lambda: small_camera("splined_stereographic", width=200),
    "moving pupil": lambda: small_camera("cahvore", width=200),
    "rolling shutter": lambda: pinhole(160),
}


@pytest.mark.parametrize("lens", LENSES)
def test_ball_from_outside_is_watertight_and_within_a_quarter_voxel(lens):
    camera = LENSES[lens]()
    rays, valid = camera.rays()
    width = np.arccos(np.clip(rays[valid][:, 2].min(), -1, 1))
    away = max(1.6, min(3.0, 1.35 / np.sin(min(width, np.pi / 2))))
    poses = [looking(CENTER + away * d) for d in directions(24)]
    motions = shutter_motions(poses) if lens == "rolling shutter" else poses
    vertices, faces = fused([camera] * len(poses), motions, ball, VOXEL).mesh()
    assert np.all(edge_counts(faces) == 2)
    assert fans(faces, len(vertices)).max() == 1
    assert len(vertices) - 3 * len(faces) // 2 + len(faces) == 2  # Euler: a ball
    error = np.abs(np.linalg.norm(vertices - CENTER, axis=1) - RADIUS) / VOXEL
    assert error.max() < tolerances.MESH_VOXELS
    assert abs(volume(vertices, faces) / (4 / 3 * np.pi * RADIUS**3) - 1) < tolerances.MESH_VOLUME


@pytest.mark.parametrize("lens", ["kannala_brandt of 190 degrees", "splined", "rolling shutter"])
def test_room_from_within_is_closed_and_its_walls_within_a_quarter_voxel(lens):
    camera = fisheye(220) if lens == "rolling shutter" else LENSES[lens]()
    towards = directions(16)
    poses = [looking(0.25 * d, d + 0.2 * e) for d, e in zip(towards, towards[::-1], strict=True)]
    motions = shutter_motions(poses) if lens == "rolling shutter" else poses

    def room(origins, rays):
        return box_depth(origins, rays, HALF)

    vertices, faces = fused([camera] * len(poses), motions, room, VOXEL).mesh()
    assert np.all(edge_counts(faces) == 2)
    assert fans(faces, len(vertices)).max() == 1
    outside = np.abs(vertices) - HALF
    error = np.abs(outside.max(axis=1)) / VOXEL
    # A field of distances rounds edges: there the nearest wall is the wrong question.
    flat = np.sort(outside, axis=1)[:, 1] < -2 * VOXEL
    assert flat.mean() > 0.5
    assert error[flat].max() < tolerances.MESH_VOXELS
    assert volume(vertices, faces) < 0  # it looks inwards


def test_open_scene_lets_voxels_grow_and_stays_exact():
    camera = fisheye(220)
    poses = [looking(0.2 * d, d) for d in directions(14)]

    def shells(origins, rays):
        return sphere_depth(origins, rays, np.zeros(3), 5.0)

    field = fused([camera] * len(poses), poses, shells, 0.03, inner=1.0)
    vertices, faces = field.mesh()
    assert np.all(edge_counts(faces) == 2)
    grown = 0.03 * 5.0**2  # along a ray at 5 times the radius of even voxels
    assert np.abs(np.linalg.norm(vertices, axis=1) - 5).max() / grown < tolerances.MESH_VOXELS
    even = 4 * np.pi * (5 / 0.03) ** 2 / 64  # blocks that voxels of one size would take
    assert len(field) < even / 2


def test_fusion_has_the_same_bits_on_any_threads():
    camera = pinhole(64)
    poses = shutter_motions([looking(3 * d) for d in directions(5)])
    found = []
    for threads in (1, 2, 3):
        gsut.set_num_threads(threads)
        field = fused([camera] * 5, poses, ball, 0.1)
        vertices, faces = field.mesh()
        found.append((field.values.tobytes(), vertices.tobytes(), faces.tobytes()))
    gsut.set_num_threads(0)
    assert found[0] == found[1] == found[2]


def test_views_confirm_true_depths_and_reject_false_ones():
    camera = pinhole(80)
    poses = [looking(3 * d) for d in directions(40)[:6]]
    views, wrong = _core.DepthViews([0, 0, 0]), np.zeros((80, 80), bool)
    wrong[35:45, 35:45] = True
    for number, pose in enumerate(poses):
        origins, rays, _ = lines_of(camera, pose)
        depth = ball(origins, rays).astype(np.float32)
        views.add(camera, pose, np.where(wrong & (number == 0), depth * 0.9, depth), None, None)
    support = views.support(0, [1, 2, 3, 4, 5], 0.01)
    assert np.all(support[wrong] == 0)
    assert np.median(support[30:34, 30:50]) >= 4


def test_colours_come_from_the_views_that_see_a_point():
    camera = pinhole(80)
    poses = [looking(np.array([0.0, 0, side * 3])) for side in (-1, 1)]
    views = _core.DepthViews([0, 0, 0])
    for pose, level in zip(poses, (51, 204), strict=True):
        origins, rays, _ = lines_of(camera, pose)
        image = np.full((80, 80, 3), level, np.uint8)
        views.add(camera, pose, ball(origins, rays).astype(np.float32), None, image)
    near, far, side = CENTER + RADIUS * np.array([[0, 0, -1.0], [0, 0, 1], [1, 0, 0]])
    colors = views.colors(np.stack([near, far, side]), 0.05)
    assert np.allclose(colors[0], 0.2) and np.allclose(colors[1], 0.8)
    assert np.all(np.isnan(colors[2]))  # neither sees it


def test_marching_cubes_equals_scikit_image_on_a_dense_grid(rng):
    measure = pytest.importorskip("skimage.measure")
    side = 24
    grid = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1)  # x, y, z
    values = np.linalg.norm(grid - 11.3, axis=-1) - 8.2
    values += 0.6 * np.sin(grid[..., 0]) * np.cos(1.3 * grid[..., 1] + grid[..., 2])
    values = values.astype(np.float32)
    blocks = [(x, y, z) for x in range(3) for y in range(3) for z in range(3)]
    cut = [
        values[8 * x : 8 * x + 8, 8 * y : 8 * y + 8, 8 * z : 8 * z + 8].transpose(2, 1, 0).ravel()
        for x, y, z in blocks
    ]
    field = _core.DistanceField(np.array(blocks, np.int32), np.stack(cut), [0, 0, 0], 1.0)
    vertices, faces = field.mesh()
    expected = measure.marching_cubes(values, 0.0, method="lorensen", allow_degenerate=True)[0]
    ours = vertices[np.lexsort(np.round(vertices, 4).T)]
    theirs = expected[np.lexsort(np.round(expected, 4).T)]
    assert ours.shape == theirs.shape
    assert np.abs(ours - theirs).max() < tolerances.MARCHING_CUBES
    assert np.all(edge_counts(faces) == 2)


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_every_sign_pattern_is_manifold(seed):
    rng = np.random.default_rng(seed)
    values = np.ones((3, 3, 3, 8, 8, 8), np.float32)
    values[...] = rng.choice([-1.0, 1.0], values.shape) * rng.uniform(0.1, 1, values.shape)
    outer = np.zeros((24, 24, 24), bool)
    outer[2:-2, 2:-2, 2:-2] = True
    inner = outer.reshape(3, 8, 3, 8, 3, 8).transpose(0, 2, 4, 1, 3, 5)
    values = np.where(inner, values, 1.0).astype(np.float32)  # free all around: closed
    blocks = np.argwhere(np.ones((3, 3, 3))).astype(np.int32)
    cut = values.transpose(0, 1, 2, 5, 4, 3).reshape(27, 512)
    vertices, faces = _core.DistanceField(blocks, cut, [0, 0, 0], 1.0).mesh()
    assert len(faces) > 10_000
    assert np.all(edge_counts(faces) == 2)
    assert fans(faces, len(vertices)).max() == 1


def test_bad_calls_are_refused():
    views = _core.DepthViews([0, 0, 0])
    with pytest.raises(InputError, match="depth must have shape"):
        views.add(pinhole(8), np.eye(4), np.zeros((4, 4), np.float32), None, None)
    with pytest.raises(InputError, match="positive"):
        views.fuse(0.0, np.inf, 4, 0.1, 0)
    views.add(pinhole(8), np.eye(4), np.ones((8, 8), np.float32), None, None)
    with pytest.raises(InputError, match="larger voxels"):
        views.fuse(0.001, np.inf, 4, 0.1, 10)
    with pytest.raises(InputError, match="more than the 1000000 blocks"):  # of 10^33
        views.fuse(1e-12, np.inf, 4, 0.1, 1_000_000)
    with pytest.raises(InputError, match="no such view"):
        views.support(0, [1], 0.01)
    unordered = np.array([[1, 0, 0], [0, 0, 0]], np.int32)
    with pytest.raises(InputError, match="increasing"):
        _core.DistanceField(unordered, np.zeros((2, 512), np.float32), [0, 0, 0], 1.0)
