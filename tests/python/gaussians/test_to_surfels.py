"""Surfels: which axis becomes the normal, what they are told by, first ones on points."""

import numpy as np

from gsut.gaussians import (
    merge_gaussians,
    press_surfels,
    rotations_from_quaternions,
    seed_from_points,
    transform_gaussians,
)
from random_scenes import random_gaussians


def axes_of(g):
    """(N, 3, 3), axes in columns."""
    quats = g.quats.astype(np.float64)
    return rotations_from_quaternions(quats / np.linalg.norm(quats, axis=1, keepdims=True))


def test_to_surfels_makes_the_shortest_axis_the_normal_and_keeps_the_others(rng):
    g = random_gaussians(rng, 60, dtype=np.float64)
    flat = g.to_surfels()
    rows, shortest = np.arange(60), np.argmin(g.log_scales, axis=1)
    assert set(shortest) == {0, 1, 2}
    before, after = axes_of(g), axes_of(flat)
    cosines = np.abs(np.einsum("nci,ncj->nij", before, after))
    assert np.allclose(cosines[rows, shortest, 2], 1)
    for k in range(2):  # the same axes with the same scales
        same = np.argmax(cosines[:, :, k], axis=1)
        assert np.allclose(cosines[rows, same, k], 1)
        assert np.array_equal(g.log_scales[rows, same], flat.log_scales[:, k])
    assert flat.are_surfels and not g.are_surfels
    assert np.array_equal(g.means, flat.means)


def test_surfels_are_told_after_moves_and_in_float32_not_beside_others(rng):
    g = random_gaussians(rng, 20)
    press_surfels(g.log_scales)
    assert g.are_surfels and g[3:5].are_surfels and not g[:0].are_surfels
    turned = transform_gaussians(g, np.eye(3), 123.4, translation=np.array([5.0, 0, 0]))
    assert turned.are_surfels
    assert not merge_gaussians([g, random_gaussians(rng, 1)]).are_surfels


def test_first_surfels_lie_in_the_surface_of_the_points(rng):
    points = rng.normal(size=(4000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    flat = seed_from_points(points).to_surfels()
    cosine = np.abs(np.sum(axes_of(flat)[:, :, 2] * points, axis=1))
    assert np.median(cosine) > 0.99 and flat.are_surfels
    assert seed_from_points(points[:3]).to_surfels().are_surfels
