"""A model carries its primitive and its shapes: through files, rows, merges, compaction."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.edit import merge_gaussians
from gsut.formats import open_ply
from gsut.formats.ply import read_comments
from gsut.gaussians import rotations_from_quaternions
from random_scenes import random_gaussians


def make_model(rng, primitive="beta", count=40):
    g = dataclasses.replace(random_gaussians(rng, count), primitive=primitive)
    if g.shapes is not None:
        g.shapes[:] = rng.normal(size=count)
    return g


def test_primitive_and_shapes_stay_with_rows_copies_types_and_origins(rng):
    g = make_model(rng)
    moved = g.translate((1e6, 0, 0))
    for same in (g.copy(), g.to_dtype(np.float64), moved, moved.with_origin((0, 0, 0))):
        assert same.primitive == "beta"
        assert np.array_equal(same.shapes, g.shapes)
    assert np.array_equal(g[3:5].shapes, g.shapes[3:5])
    assert g.make_zeros().primitive == "beta"
    assert not g.make_zeros().shapes.any()


@pytest.mark.parametrize("primitive", ["beta", "power4"])
def test_save_ply_names_the_primitive_and_load_ply_reads_it(rng, tmp_path, primitive):
    g, path = make_model(rng, primitive), tmp_path / "scene.ply"
    assert not gsut.save_gaussians(path, g).left_out
    assert f"gsut: primitive {primitive}" in read_comments(path)
    found = gsut.load_gaussians(path)
    assert found.primitive == open_ply(path, memory=1).primitive == primitive
    assert found.means.tobytes() == g.means.tobytes()
    assert primitive == "power4" or found.shapes.tobytes() == g.shapes.tobytes()
    gsut.save_gaussians(path, g.to_primitive("gaussian"))
    assert not any("primitive" in comment for comment in read_comments(path))


def test_load_ply_of_an_unknown_primitive_or_without_shapes_is_refused(rng, tmp_path):
    path = tmp_path / "scene.ply"
    gsut.save_gaussians(path, make_model(rng))
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"primitive beta", b"primitive cube"))
    with pytest.raises(InputError, match=r"names an unknown primitive; known: gaussian, beta, po"):
        gsut.load_gaussians(path)
    path.write_bytes(whole.replace(b"property float shape", b"property float other"))
    with pytest.raises(InputError, match=r'scene\.ply: property "shape" is missing, which prim'):
        gsut.load_gaussians(path)


@pytest.mark.parametrize("suffix", [".pt", ".pth", ".ckpt", ".ingp"])
def test_load_checkpoints_of_other_programs_are_refused_with_the_kernels_known(tmp_path, suffix):
    (tmp_path / f"scene{suffix}").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"export a PLY.*kernel_degree was 2 or.*power4.* 4; no "):
        gsut.load_gaussians(tmp_path / f"scene{suffix}")


@pytest.mark.parametrize("suffix", [".splat", ".glb", ".compressed.ply"])
def test_save_other_formats_hold_gaussians_of_the_same_width_and_say_so(rng, tmp_path, suffix):
    path, g = tmp_path / f"scene{suffix}", make_model(rng, "power4")
    left_out = gsut.save_gaussians(path, g).left_out
    assert any("primitive power4: the file holds Gaussians" in each for each in left_out)
    plain = tmp_path / f"plain{suffix}"
    gsut.save_gaussians(plain, g.to_primitive("gaussian"))
    assert plain.read_bytes() == path.read_bytes()
    # exp(-D^4 / 18) is a half at D = 1.879, a Gaussian at 1.177.
    wider = g.to_primitive("gaussian").log_scales - g.log_scales
    assert np.allclose(wider, np.log((18 * np.log(2)) ** 0.25 / np.sqrt(2 * np.log(2))))


def test_to_primitive_of_flat_ones_drops_the_shortest_axis_and_gives_surfels_back(rng):
    g = random_gaussians(rng, 40)
    flat = g.to_primitive("triangle")
    axes = rotations_from_quaternions(flat.quats / np.linalg.norm(flat.quats, axis=1)[:, None])
    old = rotations_from_quaternions(g.quats / np.linalg.norm(g.quats, axis=1)[:, None])
    shortest = np.take_along_axis(old, g.log_scales.argmin(axis=1)[:, None, None], axis=2)
    assert np.abs(np.sum(shortest[..., 0] * axes[..., 2], axis=1)).min() > 0.999
    back = flat.to_primitive("gaussian")
    assert flat.are_surfels and back.are_surfels
    # A linear fall is as large at its half as a Gaussian, to 1 %.
    assert np.abs(back.log_scales[:, :2] - flat.log_scales[:, :2]).max() < 0.01


def test_merge_and_compaction_refuse_what_is_undefined(rng):
    g = make_model(rng)
    with pytest.raises(InputError, match="one primitive, found beta, gaussian"):
        merge_gaussians([g, g.to_primitive("gaussian")])
    both = merge_gaussians([g, g])
    assert np.array_equal(both.shapes, np.tile(g.shapes, 2))
    with pytest.raises(InputError, match=r'"ghap" merges .* beta .* by lightgaussian, pup, or fit'):
        gsut.compact(g, 0.5)
