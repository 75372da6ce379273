"""A model carries its primitive: through files, rows, merges, compaction."""

import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.gaussians import rotations_from_quaternions
from random_scenes import random_gaussians


def make_model(rng, count=40):
    return random_gaussians(rng, count).to_primitive("triangle")


@pytest.mark.parametrize("suffix", [".pt", ".pth", ".ckpt", ".ingp"])
def test_load_checkpoints_of_other_programs_are_refused_with_the_kernels_known(tmp_path, suffix):
    (tmp_path / f"scene{suffix}").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"export a PLY.*kernel_degree was 2; no primitive"):
        gsut.load_gaussians(tmp_path / f"scene{suffix}")


@pytest.mark.parametrize("suffix", [".splat", ".glb", ".compressed.ply"])
def test_save_other_formats_hold_gaussians_of_the_same_width_and_say_so(rng, tmp_path, suffix):
    path, g = tmp_path / f"scene{suffix}", make_model(rng)
    left_out = gsut.save_gaussians(path, g).left_out
    assert any("primitive triangle: the file holds Gaussians" in each for each in left_out)
    plain = tmp_path / f"plain{suffix}"
    gsut.save_gaussians(plain, g.to_primitive("gaussian"))
    assert plain.read_bytes() == path.read_bytes()


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


def test_compaction_that_merges_refuses_triangles(rng):
    g = make_model(rng)
    with pytest.raises(InputError, match=r'"ghap" merges .* triangle .* by lightgaussian, pup, or'):
        gsut.compact(g, 0.5)
