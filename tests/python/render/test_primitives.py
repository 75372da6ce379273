"""Triangles and the extinction: gradients by differences, kernels against double, tiles."""

import dataclasses

import numpy as np
import pytest

import flips
import gsut
import tolerances
from gsut import InputError, _core
from random_scenes import (
    fisheye,
    gaussians_in_view,
    hold_to_differences,
    open_rule,
    pinhole,
    random_pose,
    random_weights,
    relative_error,
)

pytestmark = pytest.mark.quick

PRIMITIVES = gsut.Gaussians.PRIMITIVES
KINDS = ("extinction", "triangle")  # what is not the Gaussian's largest response along the ray


def make_scene(rng, camera, pose, count=150, dtype=np.float32, kind="triangle", **options):
    shape = {"sizes": (0.01, 0.3), "opacity": 0.5, **options}
    g = gaussians_in_view(rng, camera, pose, count, **shape).to_dtype(dtype)
    changed = {"response": kind} if kind == "extinction" else {"primitive": kind}
    return dataclasses.replace(g, **changed)


def move(rng, pose, shutter):
    """A pair of poses some hundredths apart, or the one pose without a shutter."""
    return pose if shutter is None else (pose, gsut.exp_pose(0.05 * rng.normal(size=6)) @ pose)


def profile(primitive, d2):
    """The response, once more; d2: of a triangle the gauge's square."""
    if primitive == "gaussian":
        return np.exp(-d2 / 2)
    return np.maximum(1 - np.sqrt(d2) / np.sqrt(40 / 3), 0)


def test_primitives_are_those_of_the_core_with_the_gaussian_first():
    assert tuple(_core.list_primitives()) == PRIMITIVES == ("gaussian", "triangle")
    with pytest.raises(InputError, match='primitive "cube" is unknown; known: gaussian, triangle'):
        dataclasses.replace(gsut.Gaussians(*make_one()), primitive="cube")


def make_one(opacity_logit=2.0):
    """The arrays of one, seen along z from the origin."""
    sh = np.full((1, 1, 3), 0.5 * np.sqrt(4 * np.pi))
    return [[0, 0, 3.0]], [[1.0, 0, 0, 0]], np.log([[0.4] * 3]), [opacity_logit], sh


@pytest.mark.parametrize("primitive", PRIMITIVES)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_one_primitive_along_a_fan_of_rays_is_its_closed_form(primitive, dtype):
    camera = pinhole(65, 1, focal=40.0)
    g = gsut.Gaussians(*(np.asarray(a, dtype) for a in make_one()), primitive=primitive)
    rays = camera.rays()[0][0]
    distance2 = 9 - (3 * rays[:, 2]) ** 2  # of the mean from the ray
    if primitive == "triangle":
        distance2 = 3 * (3 * rays[:, 0] / rays[:, 2]) ** 2  # (sqrt(3) |x|)^2 in its plane
    alpha = profile(primitive, distance2 / 0.4**2) / (1 + np.exp(-2.0))
    alpha = np.where(alpha < 1 / 255, 0.0, alpha)
    found = gsut.render(g, camera, np.eye(4), dtype=dtype).alpha[0]
    sure = np.abs(alpha - 1 / 255) > tolerances.RENDER_CUT_MARGIN
    bound = tolerances.RENDER_DOUBLE if dtype == "float64" else tolerances.PRIMITIVE_FLOAT
    assert np.abs(found - alpha)[sure].max() < bound
    assert 0 < (found > 0).sum() < 65


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_primitive_has_the_second_moments_of_its_scale(primitive):
    # Seen from so far away that rays are parallel, and as a sheet.
    camera, (means, quats, _, logits, sh) = pinhole(160, focal=16_000.0), make_one()
    means[0][2] = 1000.0
    scales = np.log([[1.0, 1.0, 1e-3]])
    g = gsut.Gaussians(means, quats, scales, logits, sh, primitive=primitive)
    alpha = gsut.render(g, camera, np.eye(4), dtype="float64", blend=open_rule()).alpha
    y, x = (np.mgrid[:160, :160] + 0.5 - 80) / 16
    for moment, expected in ((x * x, 1), (y * y, 1), (x, 0), (y, 0)):
        assert np.sum(alpha * moment) / alpha.sum() == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("alpha_min", [1e-3, 1e-37])  # the second is none: all up to the outline
@pytest.mark.parametrize("response", ["maximum", "extinction"])
def test_triangle_backward_in_double_matches_central_differences(rng, response, alpha_min):
    camera = fisheye(12)
    pose = random_pose(rng)
    g = make_scene(rng, camera, pose, 6, np.float64, distances=(2.0, 3.0),
                   sizes=(0.05, 0.1), aspect=0.3)  # fmt: skip
    g = dataclasses.replace(g, response=response)
    rule = open_rule()
    rule.alpha_min = alpha_min
    checked = hold_to_differences(
        g, camera, pose, random_weights(rng, camera), tolerances.PRIMITIVE_DIFFERENCES,
        blend=rule, background=(0.2, 0.5, 0.9),
    )  # fmt: skip
    assert checked == 6 * (3 + 4 + 3 + 1 + 12)


@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
@pytest.mark.parametrize(
    ("kind", "parity"),
    [("extinction", "gsplat"), *((kind, parity) for kind in KINDS for parity in (None, "3dgrut"))],
)
def test_kernels_of_every_isa_match_double(rng, kind, shutter, parity):
    camera, pose = fisheye(48), random_pose(rng)
    g = make_scene(rng, camera, pose, kind=kind)
    # From nearly nothing to more than float's alpha tells from 1.
    g.opacity_logits[:4] = (-5.5, -5.0, 8.0, 12.0)
    if kind == "extinction":
        g.opacity_logits[4:6] = (30.0, 80.0)
    place = move(rng, pose, shutter)
    options = {"shutter": shutter, "parity": parity, "background": (0.3, 0.1, 0.6)}
    expected = gsut.render(g, camera, place, dtype="float64", **options)
    as_gaussians = dataclasses.replace(g, primitive="gaussian", response="maximum")
    plain = gsut.render(as_gaussians, camera, place, dtype="float64", **options)
    assert np.abs(expected.image - plain.image).max() > 0.02
    flat, ball = tolerances.PRIMITIVE_FLAT_GRADIENT, tolerances.RENDER_GRADIENT
    gradient = flat if kind == "triangle" else ball
    weights = random_weights(rng, camera)
    flips.assert_isas_match(expected, weights, camera, place, gradient=gradient, **options)


@pytest.mark.parametrize("shutter", [None, "top_to_bottom"])
@pytest.mark.parametrize("kind", KINDS)
def test_tiles_miss_nothing_that_double_sees(rng, kind, shutter):
    # The cut-off of an extinction lies farther out than the maximum's: bounds must follow.
    camera, pose = fisheye(64), random_pose(rng)
    g = make_scene(rng, camera, pose, count=300, kind=kind)
    g.opacity_logits[:] = 4.6
    rule = gsut.BlendRule()
    rule.transmittance_min = 0.0
    place = move(rng, pose, shutter)
    expected = gsut.render(g, camera, place, shutter=shutter, dtype="float64", blend=rule)
    found = gsut.render(g, camera, place, shutter=shutter, blend=rule)
    assert np.abs(found.alpha - expected.alpha).max() < 2 / 255
    flipped, _ = flips.flipped(found, expected)
    assert flipped.mean() < tolerances.EXTINCTION_FLIPS


def test_extinction_features_are_blended_by_the_weights_of_the_image(rng):
    camera, pose = fisheye(32), random_pose(rng)
    g = make_scene(rng, camera, pose, kind="extinction", sh_degree=0)
    g.sh[:] = np.abs(g.sh)
    colors = 0.5 + gsut.gaussians.SH_C0 * g.sh[:, 0]
    found = gsut.render(g, camera, pose, features=colors)
    assert np.abs(found.features - found.image).max() < tolerances.RENDER_CLOSED_FORM
    dfeatures = rng.normal(size=found.image.shape)
    slopes = gsut.render_backward(found, np.zeros_like(found.image), dfeatures=dfeatures)
    plain = gsut.render_backward(gsut.render(g, camera, pose), dfeatures)
    for field in ("means", "quats", "log_scales", "opacity_logits"):
        error = relative_error(getattr(slopes.gaussians, field), getattr(plain.gaussians, field))
        assert error < tolerances.RENDER_GRADIENT, (field, error)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_of_colors_are_refused(rng, kind):
    baseline = pytest.importorskip("gsut_scalar_baseline")
    camera, pose = pinhole(12), random_pose(rng)
    g = make_scene(rng, camera, pose, 4, kind=kind, sh_degree=0, distances=(2.0, 3.0))
    pixels = np.arange(144, dtype=np.uint32)
    with pytest.raises(InputError, match="and for Gaussians by their maximum"):
        baseline.color_jacobian(g, _core.RenderJob(camera, pose), pixels)


def test_triangle_is_met_in_its_plane_whatever_its_third_scale(rng):
    camera, pose = fisheye(24), random_pose(rng)
    g = make_scene(rng, camera, pose, 30)
    expected = gsut.render(g, camera, pose)
    thick = g.copy()
    thick.log_scales[:, 2] = 0.7
    found = gsut.render(thick, camera, pose)
    assert found.image.tobytes() == expected.image.tobytes()
    slopes = gsut.render_backward(found, *random_weights(rng, camera)).gaussians
    assert not slopes.log_scales[:, 2].any() and slopes.log_scales[:, :2].any()
