"""Median and strongest distance, normals, spread: against a scalar double model of one ray."""

from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError
from gsut.render import measure_depth, z_from_distance
from random_scenes import (
    blob,
    central_differences,
    fisheye,
    gaussians_in_view,
    open_rule,
    pinhole,
    random_pose,
    relative_error,
)
from ray_model import covariances, rotations
from surface_scenes import CAMERAS, lines_of, put_camera


def rays_of(camera, motion):
    """`lines_of`, one row a pixel."""
    return [part.reshape(-1, *part.shape[2:]) for part in lines_of(camera, motion)]


def blended(g, center, origins, rays):
    """(weights, distances, transmittances (N, P), normals (N, P, 3)), nearest Gaussian first."""
    order = np.argsort(np.linalg.norm(g.means - center, axis=1), kind="stable")
    transmittance = np.ones(len(rays))
    rows, precisions = [], np.linalg.inv(covariances(g))
    for i in order:
        inverse = precisions[i]
        relative = g.means[i] - origins
        along = np.sum(relative @ inverse * rays, 1) / np.sum(rays @ inverse * rays, 1)
        miss = along[:, None] * rays - relative
        response = np.exp(-0.5 * np.sum(miss @ inverse * miss, 1))
        alpha = np.minimum(0.99, response / (1 + np.exp(-g.opacity_logits[i])))
        alpha = np.where(along > 0, alpha, 0.0)
        normal = -(2 * along[:, None] * rays - relative) @ inverse
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        rows.append((alpha * transmittance, along, transmittance, normal))
        transmittance = transmittance * (1 - alpha)
    return [np.stack(column) for column in zip(*rows, strict=True)]


def sum_of_normals(g, center, origins, rays):
    weights, _, _, normals = blended(g, center, origins, rays)
    return np.einsum("np,npc->pc", weights, normals)


def first_true(mask):
    return np.where(mask.any(0), mask.argmax(0), -1)


def take(values, row):
    return np.where(row >= 0, values[row, np.arange(values.shape[1])], np.nan)


def scene_of(rng, kind, count=20):
    camera, motion, pose = put_camera(rng, kind)
    g = gaussians_in_view(rng, camera, pose, count, opacity=1.0)
    return camera, g, motion, -pose[:3, :3].T @ pose[:3, 3]


@pytest.mark.parametrize("kind", CAMERAS)
def test_surface_maps_equal_a_scalar_double_model(rng, kind):
    camera, g, motion, center = scene_of(rng, kind)
    surface = gsut.render_surface(gsut.render(g, camera, motion, blend=open_rule()))
    origins, rays, valid = rays_of(camera, motion)
    origins, rays = origins[valid], rays[valid]
    g = g.to_dtype(np.float64)
    weights, along, before, normals = blended(g, center, origins, rays)
    crossed = first_true((before >= 0.5) & (before - weights < 0.5))
    mean = (weights * along).sum(0) / weights.sum(0)
    spread = np.sqrt((weights * (along - mean) ** 2).sum(0) / weights.sum(0))
    expected = {
        "median": take(along, crossed),
        "strongest": take(along, weights.argmax(0)),
        "expected": mean,
        "spread": spread,
        "normals": np.einsum("np,npc->pc", weights, normals),
    }
    assert np.isfinite(expected["median"]).sum() > 20
    for name, values in expected.items():
        found = getattr(surface, name).reshape(camera.height * camera.width, -1)[valid]
        # Where two Gaussians weigh the same to rounding, either may be named: few pixels.
        if name in ("expected", "spread"):  # in float a ratio of nothing to nothing
            solid = weights.sum(0) > 1e-3
            found, values = found[solid], values[solid]
        error = np.abs(found.reshape(values.shape) - values) / (1 + np.abs(values))
        wrong = (error > tolerances.SURFACE_MAPS) | (
            np.isnan(found.reshape(values.shape)) != np.isnan(values)
        )
        assert wrong.sum() == 0, (name, np.nanmax(error))


@pytest.mark.parametrize("kind", CAMERAS)
def test_gradient_of_normals_equals_central_differences(rng, kind):
    camera, g, motion, center = scene_of(rng, kind, 12)
    result = gsut.render(g, camera, motion, blend=open_rule())
    origins, rays, valid = rays_of(camera, motion)
    to = rng.normal(size=(camera.height, camera.width, 3)).astype(np.float32)
    to[~valid.reshape(to.shape[:2])] = 0
    found = gsut.loop.render_surface_backward(result, to)
    exact, weights = g.to_dtype(np.float64), to.reshape(-1, 3)[valid].astype(np.float64)

    def loss():
        return (weights * sum_of_normals(exact, center, origins[valid], rays[valid])).sum()

    for name in ("means", "quats", "log_scales", "opacity_logits"):
        numeric = central_differences(loss, getattr(exact, name))
        error = relative_error(getattr(found, name), numeric)
        assert error < tolerances.SURFACE_GRADIENTS, name
    assert not found.sh.any()


def test_normal_of_a_disc_is_its_axis_towards_the_camera():
    camera, pose = pinhole(16), np.eye(4)
    tilt = np.array([np.cos(0.3), np.sin(0.3), 0, 0], np.float32)
    g = blob((0, 0, 3), (1, 1, 1e-3), 0.9997, quat=tilt).to_dtype(np.float32)
    surface = gsut.render_surface(gsut.render(g, camera, pose))
    axis = rotations(tilt[None].astype(float))[0, :, 2]
    middle = surface.normals[8, 8] / np.linalg.norm(surface.normals[8, 8])
    assert np.abs(middle + axis).max() < tolerances.SURFACE_DISC
    # On the plane of the disc, along every ray.
    rays = camera.rays()[0]
    plane = (axis @ [0, 0, 3]) / (rays @ axis)
    seen = np.isfinite(surface.median)
    assert seen.sum() > 100
    assert np.abs(surface.median / plane - 1)[seen].max() < tolerances.SURFACE_DISC


def test_normals_of_gaussians_add_up_to_the_same_bits_on_any_threads(rng):
    camera, pose = fisheye(64), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 300)
    to = rng.normal(size=(64, 64, 3)).astype(np.float32)
    found = []
    for threads in (1, 2, 3):
        gsut.set_num_threads(threads)
        result = gsut.render(g, camera, pose)
        found.append(
            (gsut.render_surface(result).normals.tobytes(),
             gsut.loop.render_surface_backward(result, to).means.tobytes())
        )  # fmt: skip
    gsut.set_num_threads(0)
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("model", ["pinhole", "orthographic"])
def test_depth_by_name_is_that_of_the_gaussians_along_the_ray_or_the_axis(rng, model):
    camera = pinhole(32)
    if model == "orthographic":  # where z is not the distance times a cosine: origins differ
        camera = gsut.Camera(model, [8, 8, 16, 16], 32, 32)
    pose = random_pose(rng)
    g = gaussians_in_view(rng, pinhole(32), pose, 200)
    result = gsut.render(g, camera, pose)
    surface = gsut.render_surface(result)
    rays, origins = camera.rays()[0][..., 2], camera.origins()[..., 2]
    same = {"mean": surface.expected, "median": surface.median, "strongest": surface.strongest}
    for kind, distance in same.items():
        assert np.array_equal(measure_depth(result, kind), distance, equal_nan=True), kind
        error = measure_depth(result, kind, "z") - (distance * rays + origins)
        known = np.isfinite(distance)
        assert known.any()
        assert np.array_equal(np.isfinite(error), known)
        assert np.abs(error[known]).max() < tolerances.Z_ROUNDING
    assert np.array_equal(measure_depth(result, "sum"), result.depth)
    mean, total = (measure_depth(result, kind, "z") for kind in ("mean", "sum"))
    error = np.nan_to_num(mean) * result.alpha - total
    assert np.abs(error).max() < tolerances.Z_ROUNDING
    with pytest.raises(InputError, match="known: mean, median, smooth, strongest, sum"):
        measure_depth(result, "expected")
    with pytest.raises(InputError, match="known: ray, z"):
        measure_depth(result, "mean", "x")


def test_smooth_depth_averages_within_a_surface_and_not_across_its_edge(rng):
    wall = np.where(np.arange(40) < 20, 2.0, 3.0) * np.ones((30, 1))
    noisy = wall * (1 + 0.01 * rng.normal(size=wall.shape))
    noisy[3, 3] = np.nan
    image = SimpleNamespace(
        renderer=SimpleNamespace(surface=lambda: (noisy.astype(np.float32), None, None, None)),
        gaussians=None,
    )
    error = measure_depth(image, "smooth") / wall - 1
    assert np.array_equal(np.isnan(error), np.isnan(noisy))
    assert np.nanstd(error) < 0.3 * np.nanstd(noisy / wall - 1)
    assert np.nanmax(np.abs(error)) < 0.02


def test_z_is_refused_where_the_lens_sees_beyond_90_degrees():
    camera = pinhole(8)
    z = z_from_distance(np.full((8, 8), 2.0), camera)
    assert np.allclose(z, 2 * camera.rays()[0][..., 2])
    with pytest.raises(InputError, match="--depth ray"):
        z_from_distance(np.ones((16, 16)), fisheye(16))
