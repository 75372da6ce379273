"""Tests what viewers draw: EWA splats by discs, against a direct one, and their gradients."""

import numpy as np
import pytest

import gsut
from gsut import Gaussians, InputError, _core
from gsut.gaussians import rotations_from_quaternions
from gsut.training.tuning.ewa import EwaSplats, make_viewer_rule, render_ewa
from random_scenes import central_differences
from tolerances import EWA_DISCS, EWA_FLOAT, EWA_GRADIENTS

FOCAL, WIDTH, HEIGHT = 20.0, 32, 24
CAMERA = gsut.Camera("pinhole", [FOCAL, FOCAL, 15.0, 13.0], WIDTH, HEIGHT)
FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")


@pytest.fixture
def scene(rng):
    """Six Gaussians before a camera that is turned, and one at the edge of the affine map."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose = np.eye(4)
    pose[:3, :3] = turn * np.linalg.det(turn)
    pose[:3, 3] = [0.1, -0.2, 3.5]
    g = Gaussians(
        rng.uniform(-1, 1, (7, 3)), rng.normal(size=(7, 4)), rng.uniform(-2.5, -1, (7, 3)),
        rng.uniform(-1, 2, 7), rng.normal(0, 0.3, (7, 4, 3)),
    )  # fmt: skip
    g.means[6] = pose[:3, :3].T @ (np.array([4.4, 0.3, 3.5]) - pose[:3, 3])  # slope 1.26 > 1.04
    g.log_scales[6] = -0.5
    return g, pose


def direct(g, pose):
    """EWA splats written down pixel by pixel, without discs (Kerbl et al. 2023)."""
    at = g.means @ pose[:3, :3].T + pose[:3, 3]
    image, left = np.zeros((HEIGHT, WIDTH, 3)), np.ones((HEIGHT, WIDTH))
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    center = -pose[:3, :3].T @ pose[:3, 3]
    for i in np.argsort(np.linalg.norm(at, axis=1)):
        z = at[i, 2]
        x, y = (np.clip(at[i, k] / z, -m, m) * z for k, m in enumerate(1.3 * np.array([0.8, 0.6])))
        jacobian = np.array([[FOCAL, 0, -FOCAL * x / z], [0, FOCAL, -FOCAL * y / z]]) / z
        q = g.quats[i : i + 1] / np.linalg.norm(g.quats[i])
        root = jacobian @ pose[:3, :3] @ rotations_from_quaternions(q)[0] * np.exp(g.log_scales[i])
        inverse = np.linalg.inv(root @ root.T + 0.3 * np.eye(2))
        at_pixel = CAMERA.project(at[i : i + 1])[0][0]
        d = np.stack([u, v], axis=-1) - at_pixel
        response = np.exp(-0.5 * np.einsum("...i,ij,...j", d, inverse, d))
        alpha = np.minimum(0.99, response / (1 + np.exp(-g.opacity_logits[i])))
        alpha[alpha < 1 / 255] = 0
        ray = (g.means[i] - center)[None] / np.linalg.norm(g.means[i] - center)
        color = np.maximum(0, 0.5 + _core.harmonics_basis(1, ray)[0] @ g.sh[i])
        image += (left * alpha)[..., None] * color
        left *= 1 - alpha
    return image


def test_discs_draw_what_an_affine_splat_draws(scene):
    g, pose = scene
    exact = render_ewa(g, CAMERA, pose, dtype="float64").image
    np.testing.assert_allclose(exact, direct(g, pose), atol=EWA_DISCS)
    assert np.abs(exact - gsut.render(g, CAMERA, pose, dtype="float64").image).max() > 0.01
    assert np.abs(render_ewa(g, CAMERA, pose).image - exact).max() <= EWA_FLOAT


def test_gradients_are_those_of_central_differences(scene, rng):
    g, pose = scene
    weight = rng.normal(size=(HEIGHT, WIDTH, 3))
    splats = EwaSplats(g, CAMERA, pose)
    drawn = gsut.render(splats.discs, CAMERA, pose, blend=make_viewer_rule(), dtype="float64")
    found = gsut.render_backward(drawn, weight).gaussians
    splats.backpropagate(found)

    def loss():
        return np.sum(render_ewa(g, CAMERA, pose, dtype="float64").image * weight)

    checked = 0
    for name in FIELDS:
        numeric = central_differences(loss, getattr(g, name))
        checked += numeric.size
        error = np.abs(getattr(found, name) - numeric).max()
        assert error <= EWA_GRADIENTS * np.abs(numeric).max()
    assert checked == 7 * (3 + 4 + 3 + 1 + 12)


def test_origin_of_gaussians_is_heeded(scene):
    g, pose = scene
    far = np.array([1e6, -2e6, 3e5])
    moved = pose.copy()
    moved[:3, 3] -= pose[:3, :3] @ far
    before = render_ewa(g, CAMERA, pose).image
    np.testing.assert_allclose(
        render_ewa(g.translate(far), CAMERA, moved).image, before, atol=EWA_FLOAT
    )


def test_other_lenses_are_refused(scene):
    g, pose = scene
    for camera in (
        gsut.Camera("opencv4", [20, 20, 16, 12, 0.1, 0, 0, 0], 32, 24),
        gsut.Camera("pinhole", [20, 21, 16, 12], 32, 24),
    ):
        with pytest.raises(InputError, match="square pixels"):
            EwaSplats(g, camera, pose)
