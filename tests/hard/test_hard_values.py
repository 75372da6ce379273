"""Hard cases 10, 11, 13, 14: extreme scales, quaternions, opacities; values that are no number."""

import numpy as np
import pytest
from precision_paths import FIELDS, run_every_path

import gsut
import tolerances
from random_scenes import (
    blob,
    gaussians_in_view,
    list_isas,
    pinhole,
    random_weights,
)

# `render` warns of the very values that some of these tests plant.
WARNED = pytest.mark.filterwarnings("ignore:of [0-9]+ Gaussians:RuntimeWarning")
BLACK_HARMONIC = 1 / np.sqrt(4 * np.pi)


def test_zero_quaternion_is_the_identity_with_gradient_zero(rng):
    camera = pinhole(32)
    weights = random_weights(rng, camera)
    scales = (0.1, 0.3, 0.5)
    zero = run_every_path(blob(scale=scales, quat=(0, 0, 0, 0)), camera, np.eye(4), weights)
    identity = run_every_path(blob(scale=scales), camera, np.eye(4), weights)
    for one, other in zip(zero, identity, strict=True):
        assert np.array_equal(one.result.image, other.result.image)
        assert np.all(one.gradients.gaussians.quats == 0)
        assert np.array_equal(one.gradients.gaussians.means, other.gradients.gaussians.means)


@pytest.mark.parametrize("norm", [1e-35, 1e-20, 1e-6, 1e6, 1e20, 1e37])
def test_quaternion_of_any_norm_gives_the_same_image(rng, norm):
    camera = pinhole(32)
    weights = random_weights(rng, camera)
    unit = np.array([0.5, -0.1, 0.7, 0.4])
    unit /= np.linalg.norm(unit)
    scales = (0.1, 0.3, 0.5)
    outcomes = run_every_path(blob(scale=scales, quat=unit * norm), camera, np.eye(4), weights)
    expected = run_every_path(blob(scale=scales, quat=unit), camera, np.eye(4), weights)
    for one, other in zip(outcomes, expected, strict=True):
        assert np.abs(one.result.image - other.result.image).max() < tolerances.HARD_ALPHA
        # The gradient is inversely proportional to the norm, and finite.
        slope = one.gradients.gaussians.quats.astype(np.float64) * norm
        truth = other.gradients.gaussians.quats.astype(np.float64)
        if 1e-30 < norm < 1e30:
            error = np.linalg.norm(slope - truth) / np.linalg.norm(truth)
            assert error < tolerances.HARD_GRADIENT


def entries_of(g):
    """(field, flat index of the second Gaussian's entry) of every parameter."""
    for name in FIELDS:
        size = getattr(g, name)[0].size
        for k in range(size):
            yield name, size + k


@WARNED
def test_value_that_is_no_number_drops_its_gaussian_and_touches_no_other(rng):
    camera = pinhole(40)
    weights = random_weights(rng, camera)
    whole = gaussians_in_view(rng, camera, np.eye(4), 20, sh_degree=1)
    without = whole[np.arange(20) != 1]
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        clean = gsut.render(without, camera, np.eye(4))
        slopes = gsut.render_backward(clean, *weights)
        for name, index in entries_of(whole):
            for value in (np.nan, np.inf, -np.inf):
                g = whole.copy()
                getattr(g, name).flat[index] = value
                result = gsut.render(g, camera, np.eye(4))
                assert np.array_equal(result.image, clean.image), (isa, name, index, value)
                assert np.array_equal(result.depth, clean.depth)
                found = gsut.render_backward(result, *weights)
                assert not found.touched[1]
                for field in FIELDS:
                    rows = getattr(found.gaussians, field)
                    assert np.all(rows[1] == 0)
                    others = np.delete(rows, 1, axis=0)
                    assert np.array_equal(others, getattr(slopes.gaussians, field))
                assert np.allclose(found.pose, slopes.pose, rtol=tolerances.RENDER_CLOSED_FORM)


def test_opacity_zero_and_one_have_closed_forms_and_finite_gradients(rng):
    camera = pinhole(33)
    weights = random_weights(rng, camera)
    logits = (
        (-1e30, 0),
        (-200.0, 0),
        (-88.0, 0),
        (-20.0, 0),
        (5.0, 0.99),
        (88.0, 0.99),
        (1e30, 0.99),
    )
    for logit, expected in logits:
        g = blob()
        g.opacity_logits[:] = logit
        for outcome in run_every_path(g, camera, np.eye(4), weights):
            assert outcome.result.alpha[16, 16] == pytest.approx(
                expected, abs=tolerances.RENDER_CLOSED_FORM
            )
            if expected == 0:
                assert np.all(outcome.gradients.gaussians.opacity_logits == 0)


def test_ten_thousand_layers_on_one_pixel_match_the_closed_form():
    # Equal alpha a, depth 1 + i d: alpha = 1 - (1 - a)^n, weights a (1 - a)^i.
    camera = gsut.Camera("pinhole", [100.0, 100.0, 0.5, 0.5], 1, 1)
    n, a = 10_000, 1.05 / 255
    means = np.zeros((n, 3))
    means[:, 2] = 1 + 1e-4 * np.arange(n)
    g = gsut.Gaussians(
        means.astype(np.float32),
        np.tile([1.0, 0, 0, 0], (n, 1)),
        np.full((n, 3), np.log(0.5)),
        np.full(n, np.log(a / (1 - a))),
        np.full((n, 1, 3), 0.5 / BLACK_HARMONIC),
    )
    rule = gsut.BlendRule()
    rule.transmittance_min = 0.0
    weights = a * (1 - a) ** np.arange(n)
    depth = np.sum(weights * means[:, 2])
    ones = (np.ones((1, 1, 3)), np.zeros((1, 1)), np.zeros((1, 1)))
    outcomes = run_every_path(g, camera, np.eye(4), ones, blend=rule)
    for outcome in outcomes:
        assert outcome.result.alpha[0, 0] == pytest.approx(
            1 - (1 - a) ** n, abs=tolerances.HARD_LAYERS
        )
        assert outcome.result.depth[0, 0] == pytest.approx(depth, rel=tolerances.HARD_LAYERS)
        assert np.abs(outcome.result.image - 1).max() < tolerances.HARD_LAYERS
        slopes = outcome.gradients.gaussians.sh[:, 0, 0]
        error = np.linalg.norm(slopes - BLACK_HARMONIC * weights)
        assert error < tolerances.HARD_LAYERS * np.linalg.norm(BLACK_HARMONIC * weights)
        # All colours are 1: a change of one opacity moves only what the last layers let through.
        total = 3 * BLACK_HARMONIC * np.sum(weights)
        assert 3 * slopes.sum() == pytest.approx(total, rel=tolerances.HARD_LAYERS)
    # With the stop, blending ends after ln(1e-4) / ln(1 - a) layers.
    stopped = run_every_path(g, camera, np.eye(4), ones)
    last = int(np.ceil(np.log(1e-4) / np.log1p(-a)))
    for outcome in stopped:
        touched = np.flatnonzero(outcome.gradients.gaussians.sh[:, 0, 0])
        assert abs(len(touched) - last) <= 2 and touched[-1] == len(touched) - 1


@pytest.mark.parametrize(
    ("field", "value"),
    [("alpha_min", 0.0), ("alpha_min", -1.0), ("alpha_min", 1.0), ("alpha_min", np.nan),
     ("alpha_max", 1.0), ("alpha_max", 0.0), ("alpha_max", np.nan), ("transmittance_min", -0.1),
     ("transmittance_min", 1.0), ("transmittance_min", np.nan), ("response_min", -0.1),
     ("response_min", 1.0), ("response_min", np.nan), ("near_z", np.nan), ("near_z", np.inf)],
)  # fmt: skip
def test_blend_rule_that_divides_by_zero_is_refused_with_its_field(field, value):
    rule = gsut.BlendRule("gsplat")
    setattr(rule, field, value)
    for dtype in ("float32", "float64"):
        with pytest.raises(gsut.InputError, match=field):
            gsut.render(blob(), pinhole(8), np.eye(4), blend=rule, dtype=dtype)
