"""Images coarser than the photographs: Gaussians as wide as their pixels, against the mean."""

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.gaussians import find_pixel_sizes
from gsut.render import PixelFilter
from random_scenes import fisheye, gaussians_in_view, pinhole, random_pose
from ray_model import covariances

FACTOR = 4


def scene_of(rng, camera):
    pose = random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 400, sh_degree=0, sizes=(0.004, 0.06), opacity=0.7)
    return g.to_dtype(np.float32), pose


@pytest.mark.parametrize("lens", [pinhole, fisheye])
def test_a_small_image_is_the_mean_of_the_large_one(rng, lens):
    large = lens(128)
    g, pose = scene_of(rng, large)
    truth = gsut.render(g, large, pose).image
    blocks = (large.height // FACTOR, FACTOR, large.width // FACTOR, FACTOR, 3)
    truth = truth.reshape(blocks).mean(axis=(1, 3))
    small = large.resize(blocks[2], blocks[0])
    whole = np.isfinite(large.rays()[0]).all(axis=2).reshape(blocks[:4]).all(axis=(1, 3))
    pixels = PixelFilter(g, [large], pose[None])
    plain, filtered = (
        gsut.psnr(gsut.render(drawn, small, pose).image.clip(0, 1), truth.clip(0, 1), whole)
        for drawn in (g, pixels.widen(small, pose))
    )
    print(f"{plain:.2f} dB, pixel filter {filtered:.2f}")
    assert filtered > plain + tol.PIXEL_FILTER_DB
    # At the photographs' own pixels, and finer ones, nothing changes.
    assert pixels.widen(large, pose) is g
    assert pixels.widen(large.resize(2 * large.width, 2 * large.height), pose) is g


def test_coarser_pixels_are_told_by_the_lens():
    large = pinhole(128)
    assert PixelFilter.is_coarser(large.resize(96, 96), [large, large.resize(64, 64)])
    assert not PixelFilter.is_coarser(large, [large, large.resize(64, 64)])
    assert not PixelFilter.is_coarser(large.resize(256, 256), [large])


def test_scales_grow_by_the_missing_variance_and_shadows_keep_their_light(rng):
    large = pinhole(64)
    g, pose = scene_of(rng, large)
    small = large.resize(large.width // FACTOR, large.height // FACTOR)
    found = PixelFilter(g, [large], pose[None]).widen(small, pose)
    coarse, fine = (find_pixel_sizes(g.means, [lens], pose[None]) for lens in (small, large))
    missing = (coarse**2 - fine**2) / 12.0
    grown = np.exp(2.0 * found.log_scales.astype(float)) - np.exp(2.0 * g.log_scales.astype(float))
    assert np.abs(grown / missing[:, None] - 1).max() < tol.PIXEL_FILTER_FLOAT
    light = []
    for each in (g, found):
        pushed = gsut.Gaussians(*(a.astype(float) for a in (
            each.means, each.quats, each.log_scales, each.opacity_logits, each.sh)))  # fmt: skip
        light.append(shadows(pushed, pose) / (1 + np.exp(-pushed.opacity_logits)))
    assert np.abs(light[1] / light[0] - 1).max() < tol.PIXEL_FILTER_FLOAT


def shadows(g, pose):
    """Areas (N,) across the ray to each centre: the covariance without the ray's direction."""
    center = -pose[:3, :3].T @ pose[:3, 3]
    areas = []
    for mean, inverse in zip(g.means, np.linalg.inv(covariances(g)), strict=True):
        ray = (mean - center) / np.linalg.norm(mean - center)
        # Drawn is the largest response along the ray: its precision across is the complement's.
        across = inverse - np.outer(inverse @ ray, inverse @ ray) / (ray @ inverse @ ray)
        values = np.linalg.eigvalsh(across)[1:]
        areas.append(1 / np.sqrt(values.prod()))
    return np.array(areas)
