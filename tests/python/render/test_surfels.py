"""Surfels through the kernels of Gaussians: against the ray's intersection with a disc's plane."""

import numpy as np
import pytest

import gsut
import surface_scenes
import tolerances
from gsut.gaussians import press_surfels, quaternion_from_rotation, rotations_from_quaternions
from random_scenes import (
    central_differences,
    gaussians_in_view,
    open_rule,
    random_weights,
    relative_error,
    small_camera,
)
from surface_scenes import lines_of, put_camera

STEP = 1e-6
LEAST_COSINE = 0.02  # between a ray and the normals of the discs that are looked at edge-on
CAMERAS = {
    **surface_scenes.CAMERAS,
    "splined": lambda: small_camera("splined_stereographic", width=32),
}
SHAPES = {
    "plain": {},
    "edge-on": {"edge_on": True},
    "small": {"sizes": (5e-3, 3e-2)},
    "large and near": {"sizes": (0.3, 2.0), "distances": (0.2, 1.0)},
    "far": {"distances": (1e3, 1e4)},
    "needles": {"aspect": 2.0},
}


def surfels_in_view(rng, camera, pose, count, *, edge_on=False, **shape):
    g = gaussians_in_view(rng, camera, pose, count, sh_degree=0, opacity=1.0, **shape)
    if edge_on:  # normals nearly across the ray to the middle
        ray = g.means - (-pose[:3, :3].T @ pose[:3, 3])
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        across = np.cross(ray, rng.normal(size=ray.shape))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        cosine = rng.choice([-1, 1], (count, 1)) * rng.uniform(0.02, 0.1, (count, 1))
        normal = cosine * ray + np.sqrt(1 - cosine**2) * across
        side = np.cross(normal, rng.normal(size=ray.shape))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        g.quats[:] = quaternion_from_rotation(
            np.stack([side, np.cross(normal, side), normal], axis=2)
        )
    press_surfels(g.log_scales)
    return g


def hit_planes(g, origins, rays):
    """Distances and responses (N, P) of 2DGS, cosines (N, P) of rays with normals."""
    axes = rotations_from_quaternions(g.quats / np.linalg.norm(g.quats, axis=1, keepdims=True))
    cosine = np.einsum("pc,nc->np", rays, axes[:, :, 2])
    relative = g.means[:, None] - origins
    along = np.einsum("npc,nc->np", relative, axes[:, :, 2]) / cosine
    place = along[..., None] * rays - relative
    u, v = (
        np.einsum("npc,nc->np", place, axes[:, :, k]) / np.exp(g.log_scales[:, k, None])
        for k in range(2)
    )
    return along, np.exp(-0.5 * (u * u + v * v)), cosine


def blend(g, center, origins, rays):
    """image (P, 3), alpha and depth (P,) over black, nearest first."""
    along, response, _ = hit_planes(g, origins, rays)
    alpha = np.minimum(0.99, response / (1 + np.exp(-g.opacity_logits[:, None])))
    alpha = np.where(along > 0, alpha, 0.0)
    order = np.argsort(np.linalg.norm(g.means - center, axis=1), kind="stable")
    color = np.maximum(0.5 + 0.28209479177387814 * g.sh[:, 0], 0)
    image, depth, light = np.zeros((len(rays), 3)), np.zeros(len(rays)), np.ones(len(rays))
    for i in order:
        weight = light * alpha[i]
        image += weight[:, None] * color[i]
        depth += weight * along[i]
        light = light * (1 - alpha[i])
    return image, 1 - light, depth


def scene_of(rng, kind, shape, count=16):
    """Camera, surfels, motion, centre; origins, rays and pixels not too edge-on to any surfel."""
    camera, motion, pose = put_camera(rng, kind, CAMERAS)
    g = surfels_in_view(rng, camera, pose, count, **SHAPES[shape])
    center = -pose[:3, :3].T @ pose[:3, 3]
    origins, rays, valid = lines_of(camera, motion)
    flat = origins[valid], rays[valid]
    clear = np.abs(hit_planes(g.to_dtype(np.float64), *flat)[2]).min(axis=0) > LEAST_COSINE
    pixels = np.flatnonzero(valid)[clear]
    return camera, g, motion, center, flat[0][clear], flat[1][clear], pixels


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", CAMERAS)
def test_surfels_equal_the_intersection_of_rays_and_planes(rng, kind, shape):
    camera, g, motion, center, origins, rays, pixels = scene_of(rng, kind, shape)
    image, alpha, depth = blend(g.to_dtype(np.float64), center, origins, rays)
    assert len(pixels) > 20 and alpha.max() > 0.05
    for dtype in ("float64", "float32"):
        seen = gsut.render(g.to_dtype(dtype), camera, motion, dtype=dtype, blend=open_rule())
        assert np.abs(seen.alpha.ravel()[pixels] - alpha).max() < tolerances.SURFEL
        assert np.abs(seen.image.reshape(-1, 3)[pixels] - image).max() < tolerances.SURFEL
        assert relative_error(seen.depth.ravel()[pixels], depth) < tolerances.SURFEL


def differences(g, loss):
    """Central differences of loss() over all but the third scales."""
    numeric = g.make_zeros()
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        array = getattr(g, name)
        step = STEP * (np.abs(array).max() if name == "means" else 1)
        getattr(numeric, name)[:] = central_differences(loss, array, step=step)
    numeric.log_scales[:, 2] = 0
    return numeric


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("kind", CAMERAS)
def test_gradients_of_surfels_equal_differences_of_the_intersection(rng, kind, shape):
    camera, g, motion, center, origins, rays, pixels = scene_of(rng, kind, shape, 5)
    inside = np.zeros((camera.height, camera.width))
    inside.ravel()[pixels] = 1
    to_image, to_alpha, to_depth = random_weights(rng, camera)
    to = (to_image * inside[..., None], to_alpha * inside, to_depth * inside)
    weights = [w.reshape(inside.size, *w.shape[2:])[pixels] for w in to]
    exact = g.to_dtype(np.float64)
    numeric = differences(
        exact,
        lambda: sum(
            float(np.sum(w * m))
            for w, m in zip(weights, blend(exact, center, origins, rays), strict=True)
        ),
    )
    for dtype in ("float64", "float32"):
        seen = gsut.render(g.to_dtype(dtype), camera, motion, dtype=dtype, blend=open_rule())
        found = gsut.render_backward(seen, *to).gaussians
        third = found.log_scales[:, 2].copy()
        found.log_scales[:, 2] = 0
        for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
            error = relative_error(getattr(found, name), getattr(numeric, name))
            assert error < tolerances.SURFEL_GRADIENTS, (dtype, name)
        # The thickness does not matter.
        assert np.linalg.norm(third) < tolerances.SURFEL * np.linalg.norm(numeric.log_scales)
