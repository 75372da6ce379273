"""Meshes: files that others read, parts, cuts, fewer faces; nearest points and rays."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError, _core
from gsut.surface import Mesh, load_mesh, render_depth_maps, save_mesh
from random_scenes import pinhole
from surface_scenes import (
    edge_counts,
    make_ball,
    plane_run,
    volume,
)


@pytest.fixture(scope="module")
def ball():
    vertices, faces = make_ball(0.1, pinhole(80))
    colors = (0.5 + 0.4 * vertices).astype(np.float32)
    return Mesh(vertices, faces, colors)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_mesh_file_is_read_by_trimesh(tmp_path, ball, suffix):
    trimesh = pytest.importorskip("trimesh")
    save_mesh(tmp_path / f"a{suffix}", ball)
    found = trimesh.load(tmp_path / f"a{suffix}", process=False, force="mesh")
    assert found.is_watertight and found.faces.shape == ball.faces.shape
    assert np.abs(np.asarray(found.vertices) - ball.vertices).max() < tolerances.MESH_FILE
    if suffix != ".glb":  # trimesh files glTF's colours away
        colors = np.asarray(found.visual.vertex_colors)[:, :3] / 255
        assert np.abs(colors - ball.colors).max() < tolerances.MESH_COLORS
    assert found.volume == pytest.approx(volume(ball.vertices, ball.faces), rel=1e-4)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_colors_are_read_back(tmp_path, ball, suffix):
    save_mesh(tmp_path / f"a{suffix}", ball)
    found = load_mesh(tmp_path / f"a{suffix}").colors
    assert found.dtype == np.float32
    assert np.abs(found - ball.colors).max() < tolerances.MESH_COLORS
    save_mesh(tmp_path / f"b{suffix}", Mesh(ball.vertices, ball.faces))
    assert load_mesh(tmp_path / f"b{suffix}").colors is None


def test_gltf_colors_are_linear(tmp_path, ball):
    levels = np.array([[0, 10, 128], [188, 255, 1]], np.uint8)
    colors = levels[np.arange(len(ball.vertices)) % 2] / np.float32(255)
    save_mesh(tmp_path / "a.glb", Mesh(ball.vertices, ball.faces, colors))
    content = (tmp_path / "a.glb").read_bytes()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    number = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    view = document["bufferViews"][document["accessors"][number]["bufferView"]]
    begin = 28 + length + view["byteOffset"]
    linear = np.frombuffer(content, "<f4", 6, begin).reshape(2, 3)
    # IEC 61966-2-1 in 16-bit tables of others: 128 is 0.2159, 188 is 0.5029.
    expected = [[0, 10 / 255 / 12.92, 0.21586], [0.50289, 1, 1 / 255 / 12.92]]
    assert np.abs(linear - expected).max() < tolerances.LINEAR_COLORS


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_mesh_file_far_from_zero_keeps_its_digits(tmp_path, ball, suffix):
    far = Mesh(ball.vertices + np.array([5e5, 5.5e6, 300]), ball.faces)
    save_mesh(tmp_path / f"a{suffix}", far)
    found = load_mesh(tmp_path / f"a{suffix}")
    assert np.array_equal(found.faces, far.faces)
    precision = tolerances.MESH_FILE if suffix == ".ply" else tolerances.MESH_OBJ_FAR
    assert np.abs(found.vertices - far.vertices).max() < precision


def test_obj_with_quads_is_read_and_text_ply_is_refused(tmp_path):
    corners = ("0 0 0", "1 0 0", "1 1 0", "0 1 0")
    (tmp_path / "a.obj").write_text("".join(f"v {each}\n" for each in corners) + "f 1 2 3 -1\n")
    assert load_mesh(tmp_path / "a.obj").faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nend_header\n0 0 0\n"
    )
    with pytest.raises(InputError, match="save it as a binary PLY"):
        load_mesh(tmp_path / "a.ply")


def test_bad_mesh_files_are_refused(tmp_path, ball):
    with pytest.raises(InputError, match=r"\.ply, \.obj, \.glb"):
        save_mesh(tmp_path / "a.stl", ball)
    with pytest.raises(InputError, match="No such file"):
        load_mesh(tmp_path / "absent.ply")
    save_mesh(tmp_path / "a.ply", ball)
    content = (tmp_path / "a.ply").read_bytes()
    for cut in (10, 300, len(content) - 5):
        (tmp_path / "b.ply").write_bytes(content[:cut])
        with pytest.raises(InputError, match=r"damaged|ends before end_header|truncated"):
            load_mesh(tmp_path / "b.ply")


def test_parts_and_crop_keep_whole_meshes(ball):
    small = ball.crop([-2, -2, 0.8], [2, 2, 2])
    both = Mesh(
        np.concatenate([small.vertices + 5, ball.vertices]),
        np.concatenate([small.faces, ball.faces + np.uint32(len(small.vertices))]),
    )
    assert 0 < len(small) < 0.2 * len(ball)
    kept = both.without_small_parts(0.5)
    assert np.array_equal(kept.vertices, ball.vertices)
    assert np.array_equal(kept.faces, ball.faces)
    assert len(both.without_small_parts(1e-3)) == len(both)


def test_normals_of_a_ball_point_outwards(ball):
    outwards = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    assert np.sum(ball.compute_normals() * outwards, axis=1).min() > 0.9


def test_holes_are_closed_and_other_faces_stay(ball):
    place = np.array([0.0, 0.0, 1.0])
    some = ball.with_faces(ball.vertices[ball.faces].mean(axis=1) @ place < 0.9)
    bare = Mesh(some.vertices, some.faces)
    assert (edge_counts(bare.faces) == 1).any()
    closed = bare.close_holes(100)
    assert (edge_counts(closed.faces) == 2).all()
    assert np.array_equal(closed.faces[: len(bare)], bare.faces)
    assert len(bare.close_holes(3)) == len(bare)


def test_nearest_and_rays_equal_all_triangles_one_by_one(rng):
    vertices, faces = rng.normal(size=(60, 3)), rng.integers(0, 60, (40, 3)).astype(np.uint32)
    faces[0] = 7  # a point
    tree = _core.TriangleTree(vertices, faces)
    queries = 1.5 * rng.normal(size=(200, 3))
    away, number = tree.nearest(queries)
    # Against a fine sampling of every triangle: never nearer, and nearly as near.
    u, v = np.meshgrid(np.linspace(0, 1, 60), np.linspace(0, 1, 60))
    inside = u + v <= 1 + 1e-9
    u, v = u[inside], v[inside]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    points = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
    sampled = np.linalg.norm(queries[:, None, None] - points, axis=-1).min(axis=2)
    assert np.all(away <= sampled.min(axis=1) + 1e-12)
    assert np.abs(away - sampled.min(axis=1)).max() < 0.1
    assert np.abs(away - sampled[np.arange(200), number]).max() < 0.1
    rays = rng.normal(size=(200, 3))
    hit, face = tree.cast(queries, rays)
    matrices = np.stack([b - a, c - a], axis=2)[None] * np.ones((200, 1, 1, 1))
    matrices = np.concatenate(
        [matrices, -np.broadcast_to(rays[:, None, :, None], (200, 40, 3, 1))], axis=3
    )
    valid = np.abs(np.linalg.det(matrices)) > 1e-12
    matrices[~valid] = np.eye(3)
    solved = np.linalg.solve(matrices, (queries[:, None] - a)[..., None])[..., 0]
    meets = valid & (solved[..., 0] >= 0) & (solved[..., 1] >= 0)
    meets &= (solved[..., 0] + solved[..., 1] <= 1) & (solved[..., 2] > 0)
    expected = np.where(meets, solved[..., 2], np.inf).min(axis=1)
    assert np.array_equal(np.isnan(hit), np.isinf(expected)) and np.isfinite(hit).sum() > 20
    assert np.allclose(hit[face >= 0], expected[face >= 0])


def test_mesh_command_writes_the_plane_and_refuses_what_it_cannot(tmp_path, capsys, monkeypatch):
    from gsut.cli import main

    run, out = str(plane_run(tmp_path)), tmp_path / "a.ply"
    assert main(["mesh", run, "-o", str(out), "--json", "--voxel", "0.05"]) == 0
    figures = json.loads(capsys.readouterr().out)
    mesh = load_mesh(out)
    assert len(mesh) == figures["faces"] > 1000
    seen_well = np.all(np.abs(mesh.vertices[:, :2]) < 1, axis=1)
    assert seen_well.sum() > 1000
    assert np.abs(mesh.vertices[seen_well, 2]).max() < tolerances.MESH_VOXELS * 0.05
    assert mesh.compute_normals()[seen_well, 2].min() > 0.9  # towards the cameras, which are above
    assert main(["mesh", run, "-o", str(out)]) == 2
    assert "nothing was overwritten" in capsys.readouterr().err
    assert main(["mesh", run, "-o", str(tmp_path / "a.stl")]) == 2
    assert main(["mesh", run, "-o", str(tmp_path / "b.ply"), "--voxel", "0"]) == 2
    far = ["--crop", "1000", "1000", "1000", "1001", "1001", "1001"]
    capsys.readouterr()
    assert main(["mesh", run, "-o", str(tmp_path / "b.ply"), *far]) == 2
    assert "no surface" in capsys.readouterr().err
    assert main(["mesh", run, "-o", str(tmp_path / "b.ply"), "--voxel", "1e-9"]) == 2
    assert "memory is allowed for; take larger voxels" in capsys.readouterr().err
    monkeypatch.setattr("gsut.run.memory._SMALL", 0)
    monkeypatch.setattr("gsut.run.memory.free_memory", lambda: 1000)
    with pytest.raises(InputError, match=r"of \d+ views takes about .* \(--max-side\)"):
        render_depth_maps(None, gsut.load_dataset(tmp_path / "data"))
