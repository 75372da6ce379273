"""Normals that agree with the depth, distortion, known distances: values and gradients."""

import numpy as np
import pytest

import tolerances
from gsut import _core
from random_scenes import central_differences, fisheye, relative_error

STEP = 1e-6
WEIGHTS = {"normal": (1.0, 0, 0, 2), "distortion": (0, 1.0, 0, 2), "known": (0, 0, 1.0, 2)}
OUT = ("alpha", "depth", "distortion", "normals")


def maps_of(rng, normal=(0.3, -0.4, -0.8), rough=0.02):
    """Of a rough plane seen through a fisheye, from moving origins."""
    camera = fisheye(24)
    rays, valid = camera.rays()
    rays = np.where(valid[..., None], rays, 0.0)
    normal = np.array(normal) / np.linalg.norm(normal)
    origins = 0.02 * rng.normal(size=rays.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (-3.0 - origins @ normal) / (rays @ normal)
    distance = np.where((distance > 0) & (distance < 20) & valid, distance, 0.0)
    distance *= 1 + rough * rng.normal(size=distance.shape)
    alpha = np.where(distance > 0, rng.uniform(0.6, 1.0, distance.shape), 0.0)
    noisy = alpha[..., None] * normal + 0.1 * rng.normal(size=rays.shape)
    known = np.where(rng.uniform(size=alpha.shape) < 0.3, distance * 1.1, 0.0)
    return {
        "directions": rays, "origins": origins, "alpha": alpha, "depth": alpha * distance,
        "distortion": rng.uniform(size=alpha.shape), "normals": 0.5 + 0.5 * noisy, "known": known,
    }, alpha, normal  # fmt: skip


def loss_of(maps, weights):
    out = [np.zeros_like(maps[name]) for name in OUT]
    return _core.surface_loss(maps, weights, *out), dict(zip(OUT, out, strict=True))


@pytest.mark.parametrize("term", WEIGHTS)
def test_gradients_of_a_surface_term_equal_central_differences(rng, term):
    maps, alpha, _ = maps_of(rng)
    weights = WEIGHTS[term]
    values, found = loss_of(maps, weights)
    assert sum(values) != 0
    # The distortion is over a distance that counts as a constant.
    fields = ("distortion",) if term == "distortion" else OUT
    for name in fields:
        array = maps[name]
        chosen = rng.permutation(np.flatnonzero((alpha > 0).ravel()))[:40]
        chosen = chosen * (array.size // alpha.size)
        numeric = central_differences(lambda: sum(loss_of(maps, weights)[0]), array, chosen, STEP)
        got = found[name].ravel()[chosen]
        if not np.any(numeric):
            assert not np.any(got), name
        else:
            assert relative_error(got, numeric) < tolerances.SURFACE_LOSS_DIFFERENCES, name
    in_float = {name: np.ascontiguousarray(array, np.float32) for name, array in maps.items()}
    rounded, slopes = loss_of(in_float, weights)
    assert rounded == pytest.approx(values, rel=tolerances.SURFACE_LOSS_FLOAT)
    for name in OUT:
        assert relative_error(slopes[name], found[name]) < tolerances.SURFACE_LOSS_FLOAT


def test_a_smooth_plane_with_its_own_normals_costs_nothing(rng):
    maps, alpha, normal = maps_of(rng, rough=0.0)
    maps["normals"] = 0.5 + 0.5 * alpha[..., None] * normal
    assert loss_of(maps, WEIGHTS["normal"])[0][0] == pytest.approx(0, abs=1e-12)
    maps["normals"] = 0.5 - 0.5 * alpha[..., None] * normal  # turned away: all of it
    assert loss_of(maps, WEIGHTS["normal"])[0][0] > 0.1


def test_neighbours_on_two_sides_of_an_edge_ask_nothing_of_each_other(rng):
    maps, alpha, _ = maps_of(rng, rough=0.0)
    columns = np.arange(alpha.shape[1]) % 2 == 0
    maps["depth"] = maps["depth"] * np.where(columns, 1.5, 1.0)
    values, found = loss_of(maps, WEIGHTS["normal"])
    assert values == [0, 0, 0] and not any(map(np.any, found.values()))
