"""Tests Adam, MCMC and adaptive densification through gsut.optimize."""

from math import sqrt

import numpy as np
import pytest

import tolerances
from gsut import Gaussians, InputError, _core
from gsut.machine import available_isas, set_isa
from gsut.optimize import GaussianOptimizer, densify_adaptive, densify_mcmc
from gsut.optimize.optimizer import LearningRates
from random_scenes import assert_same, central_differences, list_isas, random_gaussians
from ray_model import covariances

pytestmark = pytest.mark.quick

FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")
RATES = LearningRates(
    means=1e-3, quats=2e-3, log_scales=1e-2, opacity_logits=5e-2, sh0=5e-3, sh_rest=1e-4
)


def logit(opacity):
    return np.log(opacity / (1 - opacity))


def sigmoid(x):
    return 1 / (1 + np.exp(-np.asarray(x, np.float64)))


# --- Adam ------------------------------------------------------------------------


# Rows of none, one, a few and many vectors and chunks; harmonics that are stepped, of 16.
@pytest.mark.parametrize(
    ("rows", "degree", "is_sparse", "steps"),
    [(300, 3, True, 30), (0, 3, True, 1), (1, 3, False, 2), (15, 0, False, 2), (16, 1, True, 2),
     (17, 2, False, 2), (1000, 0, True, 2), (7001, 3, False, 2)],
)  # fmt: skip
def test_adam_matches_float64_oracle_with_the_same_bits_on_every_instruction_set(
    rng, rows, degree, is_sparse, steps
):
    g, active = random_gaussians(rng, rows, 16), (degree + 1) ** 2
    rates = {"means": 1e-3, "quats": 2e-3, "log_scales": 1e-2, "opacity_logits": 5e-2}
    rates["sh"] = np.where(np.arange(16)[:, None] < 1, RATES.sh0, RATES.sh_rest)
    rates["sh"] = rates["sh"] * (np.arange(16)[:, None] < active)
    params = {name: getattr(g, name).astype(np.float64) for name in FIELDS}
    moment1 = {name: np.zeros_like(params[name]) for name in FIELDS}
    moment2 = {name: np.zeros_like(params[name]) for name in FIELDS}
    total = {name: np.zeros_like(params[name]) for name in FIELDS}
    optimizers = {isa: GaussianOptimizer(g) for isa in available_isas()}
    for step in range(1, steps + 1):
        grads = random_gaussians(rng, rows, 16)
        for name in FIELDS:  # of all sizes
            scale = 10 ** rng.uniform(-9, 1, getattr(grads, name).shape) if rows != 300 else 1
            getattr(grads, name)[...] *= scale
        visible = rng.random(rows) < 0.6 if is_sparse else None
        for isa, optimizer in optimizers.items():
            set_isa(isa)
            optimizer.step(grads, RATES, visible, degree)
        for name in FIELDS:
            gradient = getattr(grads, name).astype(np.float64)
            seen = np.ones(rows, bool) if visible is None else visible
            seen = seen.reshape(-1, *[1] * (gradient.ndim - 1))
            m = 0.9 * moment1[name] + 0.1 * gradient
            v = 0.999 * moment2[name] + 0.001 * gradient**2
            update = rates[name] * m / (1 - 0.9**step) / (np.sqrt(v / (1 - 0.999**step)) + 1e-15)
            moment1[name] = np.where(seen, m, moment1[name])
            moment2[name] = np.where(seen, v, moment2[name])
            params[name] -= np.where(seen, update, 0)
            total[name] += np.where(seen, np.abs(update), 0)
    first, *others = (optimizer.state_dict() for optimizer in optimizers.values())
    for other in others:
        assert_same_state(first, other)
    for name in FIELDS:
        found = first[f"params.{name}"]
        allowed = tolerances.ADAM_RELATIVE * total[name]
        allowed = allowed + steps * tolerances.FLOAT32 * (np.abs(params[name]) + total[name])
        assert np.all(np.abs(found - params[name]) <= allowed), name


def test_adam_leaves_rows_and_degrees_that_are_off_untouched(rng):
    g = random_gaussians(rng, 40, 16)
    optimizer = GaussianOptimizer(g)
    visible = np.zeros(40, bool)
    visible[::3] = True
    optimizer.step(random_gaussians(rng, 40, 16), RATES, visible, active_sh_degree=1)
    found = optimizer.gaussians
    assert_same(found[~visible], g[~visible])
    np.testing.assert_array_equal(found.sh[:, 4:], g.sh[:, 4:])
    assert np.all(found.sh[visible][:, :4] != g.sh[visible][:, :4])


def test_adam_with_a_gradient_that_is_not_finite_spoils_its_element_only(rng):
    optimizer = GaussianOptimizer(random_gaussians(rng, 40))
    grads = random_gaussians(rng, 40)
    grads.means[7, 1] = np.nan
    optimizer.step(grads, RATES)
    finite = np.isfinite(optimizer.gaussians.means)
    assert not finite[7, 1] and finite.sum() == 119


def test_adam_with_gradients_of_another_size_raises(rng):
    optimizer = GaussianOptimizer(random_gaussians(rng, 4))
    with pytest.raises(InputError, match=r"gradient of means must have shape \(4, 3\)"):
        optimizer.step(random_gaussians(rng, 5), RATES)


def test_regularizer_matches_central_differences(rng):
    g = random_gaussians(rng, 6)
    grads = random_gaussians(rng, 6)
    before = grads.copy()
    GaussianOptimizer(g).add_regularizer(grads, 0.3, 0.2)

    exact = g.to_dtype(np.float64)

    def loss():
        return 0.3 * sigmoid(exact.opacity_logits).mean() + 0.2 * np.exp(exact.log_scales).mean()

    for name in ("opacity_logits", "log_scales"):
        added = getattr(grads, name) - getattr(before, name)
        expected = central_differences(loss, getattr(exact, name))
        assert added == pytest.approx(expected, abs=tolerances.REGULARIZER)
    np.testing.assert_array_equal(grads.means, before.means)


def test_regularizer_of_many_rows_matches_double_on_every_instruction_set(rng):
    n = 1100  # more than a chunk, and no whole number of vectors
    g = random_gaussians(rng, n)
    g.opacity_logits[:4] = [-100.0, 100.0, -20.0, 20.0]
    g.log_scales[0] = [-60.0, -50.0, 50.0]
    opacity, scales = sigmoid(g.opacity_logits), np.exp(g.log_scales.astype(np.float64))
    try:
        for isa in list_isas():
            set_isa(isa)
            grads = random_gaussians(rng, n)
            for name in FIELDS:
                getattr(grads, name)[...] = 0.0
            GaussianOptimizer(g).add_regularizer(grads, 0.3, 0.2)
            np.testing.assert_allclose(
                grads.opacity_logits, 0.3 / n * opacity * (1 - opacity),
                rtol=0, atol=tolerances.REGULARIZER_OPACITIES / n,
            )  # fmt: skip
            np.testing.assert_allclose(
                grads.log_scales, 0.2 / (3 * n) * scales,
                rtol=tolerances.REGULARIZER_SCALES, atol=0,
            )  # fmt: skip
    finally:
        set_isa("")


# --- MCMC -------------------------------------------------------------------------------------


def one_parent(opacity, capacity=8):
    g = Gaussians([[1.0, 2, 3]], [[1.0, 0, 0, 0]], [[-1.0] * 3], [logit(opacity)], [[[0.1] * 3]])
    return GaussianOptimizer(g, capacity, seed=5)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_mcmc_split_keeps_the_mean_and_the_covariance(rng, n):
    parents = 4000
    g = random_gaussians(rng, 1)
    many = g[np.zeros(parents, np.int64)]
    optimizer = GaussianOptimizer(many, capacity=n * parents, seed=6)
    assert densify_mcmc(optimizer, n * parents, np.ones(parents, np.float32)).added > 0
    found = optimizer.gaussians
    np.testing.assert_allclose(
        found.means.mean(axis=0), g.means[0], rtol=0, atol=tolerances.MCMC_MEAN
    )
    offsets = found.means.astype(np.float64) - g.means[0]
    mixture = offsets.T @ offsets / len(offsets) + covariances(found[:1].to_dtype(np.float64))[0]
    expected = covariances(g.to_dtype(np.float64))[0]
    np.testing.assert_allclose(
        mixture, expected, rtol=0, atol=tolerances.MCMC_MOMENT * np.trace(expected)
    )
    np.testing.assert_allclose(
        found.log_scales,
        np.broadcast_to(g.log_scales[0] - np.log(n) / 3, (n * parents, 3)),
        rtol=0,
        atol=tolerances.ACTIVATED_FLOAT32,
    )


def test_mcmc_split_copies_take_the_opacity_of_the_power():
    optimizer = one_parent(0.6)
    densify_mcmc(optimizer, 3, np.ones(1, np.float32))
    expected = 1 - 0.4 ** (3 ** (-1 / 3))
    np.testing.assert_allclose(
        sigmoid(optimizer.gaussians.opacity_logits), expected, rtol=tolerances.ACTIVATED_FLOAT32
    )


def test_mcmc_relocates_all_kinds_of_dead_and_copies_the_living(rng):
    g = random_gaussians(rng, 60, 4)
    g.opacity_logits[:] = 1.0
    g.opacity_logits[3] = logit(0.004)
    g.means[10, 2] = np.nan
    g.sh[11, 3, 1] = np.inf
    g.opacity_logits[12] = np.nan
    g.quats[14] = np.nan
    optimizer = GaussianOptimizer(g, capacity=60, seed=1)
    optimizer.step(random_gaussians(rng, 60), LearningRates(0, 0, 0, 0, 0, 0))
    weights = np.zeros(60, np.float32)
    weights[20:30] = 1.0
    weights[31], weights[32], weights[33] = np.nan, np.inf, -1.0
    weights[3] = 100.0  # a dead row is no source, whatever its weight
    counts = densify_mcmc(optimizer, 60, weights)
    assert counts == (60, 5, 0)
    found = optimizer.gaussians
    for name in FIELDS:
        assert np.isfinite(getattr(found, name)).all()
    dead = np.array([3, 10, 11, 12, 14])
    moved = np.any(found.means != g.means, axis=1)
    sources = np.setdiff1d(np.flatnonzero(moved), dead)
    assert set(sources) <= set(range(20, 30)) and 3 <= len(sources) <= 5
    rest = np.setdiff1d(np.arange(60), np.concatenate([dead, sources]))
    assert_same(found[rest], g[rest])
    parents = [np.flatnonzero(np.all(g.quats[sources] == q, axis=1)) for q in found.quats[dead]]
    assert all(len(parent) == 1 for parent in parents)
    touched = np.concatenate([dead, sources])
    state = optimizer.state_dict()
    assert np.all(state["moment1.means"][touched] == 0) and np.all(
        state["moment2.sh"][touched] == 0
    )
    assert np.all(state["moment1.means"][rest] != 0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", FIELDS)
def test_mcmc_relocates_exactly_the_row_with_a_value_that_is_not_finite(rng, name, value):
    g = random_gaussians(rng, 3)
    g.opacity_logits[:] = 1.0
    getattr(g, name).reshape(3, -1)[1, -1] = value
    optimizer = GaussianOptimizer(g)
    assert densify_mcmc(optimizer, 3, np.ones(3, np.float32)) == (3, 1, 0)
    found = optimizer.gaussians
    assert all(np.isfinite(getattr(found, field)).all() for field in FIELDS)
    np.testing.assert_array_equal(found.sh[[0, 2]], g.sh[[0, 2]])  # which relocation never writes


def test_mcmc_draws_in_proportion_to_the_weights(rng):
    weights = np.array([0.0, 1.0, 2.0, 5.0, 0.0], np.float32)
    copies = np.zeros(5)
    for seed in range(400):
        g = random_gaussians(rng, 5)
        optimizer = GaussianOptimizer(g, capacity=9, seed=seed)
        assert densify_mcmc(optimizer, 9, weights).added == 4
        new = optimizer.gaussians.quats[5:]
        copies += (new[None] == g.quats[:, None]).all(axis=2).sum(axis=1)
    np.testing.assert_allclose(copies / 1600, weights / 8, rtol=0, atol=tolerances.MCMC_SHARES)
    assert copies[0] == 0 and copies[4] == 0


def test_mcmc_with_one_living_makes_at_most_51_of_it():
    optimizer = one_parent(0.9, capacity=200)
    counts = densify_mcmc(optimizer, 200, np.ones(1, np.float32))
    assert counts == (51, 0, 50)
    # None of the copies is born dead.
    again = densify_mcmc(optimizer, 51, np.ones(51, np.float32))
    assert again == (51, 0, 0)


def test_mcmc_with_all_weights_zero_draws_all_living_equally(rng):
    g = random_gaussians(rng, 30)
    optimizer = GaussianOptimizer(g, capacity=60)
    assert densify_mcmc(optimizer, 60, np.zeros(30, np.float32)) == (60, 0, 30)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_mcmc_with_none_living_changes_nothing(rng, count):
    g = random_gaussians(rng, count)
    g.opacity_logits[:] = -9.0
    optimizer = GaussianOptimizer(g, capacity=20)
    assert densify_mcmc(optimizer, 10, np.ones(count, np.float32)) == (count, 0, 0)
    assert_same(optimizer.gaussians, g)


def test_mcmc_with_nothing_to_do_changes_nothing(rng):
    g = random_gaussians(rng, 20)
    optimizer = GaussianOptimizer(g)
    assert densify_mcmc(optimizer, 20, np.ones(20, np.float32)) == (20, 0, 0)
    assert densify_mcmc(optimizer, 5, np.ones(20, np.float32)) == (20, 0, 0)
    assert_same(optimizer.gaussians, g)


def test_mcmc_default_weights_are_opacity_times_the_largest_gradient(rng):
    g = random_gaussians(rng, 10)
    optimizer = GaussianOptimizer(g, capacity=14)
    grads = np.zeros((10, 3), np.float32)
    grads[6] = [0.0, 3.0, 4.0]
    optimizer.accumulate(grads, np.full(10, 2.0, np.float32))
    optimizer.accumulate(0.1 * grads, np.full(10, 2.0, np.float32))
    assert optimizer.gradient_max[6] == 10.0 and optimizer.gradient_sum[6] == pytest.approx(5.5)
    assert densify_mcmc(optimizer, 14).added == 4
    assert np.all(optimizer.gaussians.quats[10:] == g.quats[6])
    assert len(optimizer.gradient_max) == 14 and not optimizer.gradient_max.any()


def test_mcmc_default_weights_go_by_errors_too_where_they_are_measured(rng):
    optimizer = GaussianOptimizer(random_gaussians(rng, 10), capacity=14)
    optimizer.accumulate(np.ones((10, 3), np.float32), np.ones(10, np.float32))
    optimizer.error_sum[6] = 1.0
    parent = optimizer.gaussians.quats[6].copy()
    assert densify_mcmc(optimizer, 14).added == 4
    assert np.all(optimizer.gaussians.quats[10:] == parent)
    assert len(optimizer.error_sum) == 14 and not optimizer.error_sum.any()


def test_mcmc_noise_has_the_papers_covariance(rng):
    g = random_gaussians(rng, 1)
    many = g[np.zeros(20000, np.int64)]
    many.opacity_logits[:] = logit(0.01)
    optimizer = GaussianOptimizer(many, seed=9)
    optimizer.add_noise(1e-4)
    shift = (optimizer.gaussians.means - many.means).astype(np.float64)
    gate = 1e-4 * 5e5 * sigmoid(-100 * (0.01 - 0.005))
    sigma = covariances(g.to_dtype(np.float64))[0]
    expected = gate**2 * sigma @ sigma
    found = shift.T @ shift / len(shift)
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=tolerances.NOISE_MOMENT * np.trace(expected)
    )
    assert np.all(
        np.abs(shift.mean(axis=0)) < tolerances.NOISE_MOMENT * np.sqrt(np.trace(expected))
    )


def test_mcmc_noise_leaves_opaque_and_broken_ones_and_differs_by_step(rng):
    g = random_gaussians(rng, 30)
    g.opacity_logits[:10] = logit(0.5)
    g.opacity_logits[10:] = logit(0.006)
    g.quats[29] = np.nan
    g.quats[28] = 0.0
    g.log_scales[27] = 80.0
    optimizer = GaussianOptimizer(g)
    optimizer.add_noise(1e-4)
    first = optimizer.gaussians.copy()
    np.testing.assert_array_equal(first.means[:10], g.means[:10])
    assert np.all(first.means[10:27] != g.means[10:27])
    np.testing.assert_array_equal(first.means[29], g.means[29])
    assert np.isfinite(first.means).all()
    other = GaussianOptimizer(g)
    other.steps = 1
    other.add_noise(1e-4)
    assert np.all(other.gaussians.means[10:27] != first.means[10:27])


# --- adaptive density control -----------------------------------------------------------------


def adaptive_case(rng):
    """Rows: 0 keep, 1 clone, 2 split, 3 transparent, 4 NaN, 5 too large, 6 never seen, 7 keep."""
    g = random_gaussians(rng, 8)
    g.opacity_logits[:] = 1.0
    g.log_scales[:] = np.log(0.05)
    g.log_scales[2, 1] = np.log(0.5)
    g.opacity_logits[3] = logit(0.004)
    g.sh[4, 1, 1] = np.nan
    g.log_scales[5, 0] = np.log(30.0)
    return g


def test_adaptive_clones_splits_and_prunes_in_order(rng):
    g = adaptive_case(rng)
    optimizer = GaussianOptimizer(g, seed=3)
    optimizer.step(
        Gaussians(*(np.ones_like(getattr(g, n)) for n in FIELDS)), LearningRates(*[0] * 6)
    )
    grads = np.zeros((8, 3), np.float32)
    grads[1:7] = [1e-3, 0, 0]
    visible = np.ones(8, bool)
    visible[6] = False
    optimizer.accumulate(grads, np.full(8, 2.0, np.float32), visible)
    counts = densify_adaptive(optimizer, clone_scale=0.1, max_scale=10.0)
    assert counts == (7, 3, 1, 1)
    found = optimizer.gaussians
    assert_same(found[np.array([0, 1, 3, 4])], g[np.array([0, 1, 6, 7])])
    assert_same(found[5:6], g[1:2])
    for row in (2, 6):
        np.testing.assert_allclose(
            found.log_scales[row], g.log_scales[2] - np.log(1.6), rtol=tolerances.ACTIVATED_FLOAT32
        )
        assert np.any(found.means[row] != g.means[2])
    assert np.any(found.means[2] != found.means[6])
    moments = optimizer.state_dict()["moment1.means"]
    assert np.all(moments[[2, 5, 6]] == 0) and np.all(moments[[0, 1, 3, 4]] != 0)
    assert len(optimizer.seen) == 7 and not optimizer.seen.any()


def test_adaptive_split_halves_are_drawn_from_the_parent(rng):
    g = random_gaussians(rng, 1)
    many = g[np.zeros(10000, np.int64)]
    optimizer = GaussianOptimizer(many, seed=4)
    optimizer.accumulate(np.ones((10000, 3), np.float32), np.ones(10000, np.float32))
    assert densify_adaptive(optimizer, clone_scale=1e-6).split == 10000
    shift = optimizer.gaussians.means.astype(np.float64) - g.means[0]
    expected = covariances(g.to_dtype(np.float64))[0]
    np.testing.assert_allclose(
        shift.T @ shift / len(shift),
        expected,
        rtol=0,
        atol=tolerances.NOISE_MOMENT * np.trace(expected),
    )


def test_adaptive_at_the_limit_grows_the_largest_gradients(rng):
    g = random_gaussians(rng, 10)
    g.opacity_logits[:] = 1.0
    optimizer = GaussianOptimizer(g)
    grads = np.zeros((10, 3), np.float32)
    grads[:, 0] = [5, 1, 4, 1, 5, 9, 2, 6, 5, 3]
    optimizer.accumulate(grads, np.ones(10, np.float32))
    counts = densify_adaptive(optimizer, clone_scale=1e9, max_gaussians=13)
    assert counts == (13, 0, 3, 0)
    np.testing.assert_array_equal(optimizer.gaussians.quats[10:], g.quats[[0, 5, 7]])


@pytest.mark.parametrize("count", [0, 1, 4])
def test_adaptive_with_all_transparent_leaves_none(rng, count):
    g = random_gaussians(rng, count)
    g.opacity_logits[:] = -9.0
    optimizer = GaussianOptimizer(g)
    assert densify_adaptive(optimizer, clone_scale=1.0) == (0, count, 0, 0)
    assert len(optimizer.gaussians) == 0
    optimizer.step(random_gaussians(rng, 0), RATES)


def test_apply_adaptive_for_another_size_raises(rng):
    a, b = random_gaussians(rng, 3), random_gaussians(rng, 4)
    zeros, seen = np.zeros(3, np.float32), np.zeros(3, np.int32)
    plan = _core.plan_adaptive(a, 3, zeros, seen, 2e-4, 0.1, 0.005, np.inf, 0)
    with pytest.raises(InputError, match="plan is for 3 Gaussians, there are 4"):
        _core.apply_adaptive(b, b.copy(), b.copy(), 4, plan, 0, 0)


def test_arrays_without_room_for_new_rows_raise_with_the_need(rng):
    params, moment1, moment2 = (random_gaussians(rng, 3) for _ in range(3))
    with pytest.raises(InputError, match="capacity of 6"):
        _core.mcmc_densify(params, moment1, moment2, 3, 6, np.ones(3, np.float32), 0.005, 0, 0)
    clone, split = 2, 3
    plan = _core.AdaptivePlan(np.array([clone, split], np.uint8))
    with pytest.raises(InputError, match="capacity of 4"):
        _core.apply_adaptive(params, moment1, moment2, 2, plan, 0, 0)


def test_reset_opacities_limits_them_and_forgets_their_moments(rng):
    g = random_gaussians(rng, 20)
    g.opacity_logits[3] = -8.0
    optimizer = GaussianOptimizer(g)
    optimizer.step(random_gaussians(rng, 20), LearningRates(*[0] * 6))
    optimizer.reset_opacities(0.01)
    found = optimizer.gaussians
    assert found.opacity_logits[3] == -8.0
    np.testing.assert_allclose(
        sigmoid(np.delete(found.opacity_logits, 3)), 0.01, rtol=tolerances.ACTIVATED_FLOAT32
    )
    state = optimizer.state_dict()
    assert not state["moment1.opacity_logits"].any() and state["moment1.means"].all()


def test_accumulate_leaves_out_what_is_not_seen_or_not_finite():
    g = Gaussians(*(np.zeros(shape) for shape in ((4, 3), (4, 4), (4, 3), (4,), (4, 1, 3))))
    optimizer = GaussianOptimizer(g)
    grads = np.full((4, 3), 2.0, np.float32)
    grads[1, 0] = np.nan
    optimizer.accumulate(grads, np.array([1, 1, np.inf, 1], np.float32), np.array([1, 1, 1, 0]))
    length = np.float32(2 * sqrt(3))
    np.testing.assert_allclose(optimizer.gradient_max, [length, 0, 0, 0])
    np.testing.assert_allclose(optimizer.gradient_sum, [length / 2, 0, 0, 0])
    assert optimizer.seen.tolist() == [1, 0, 0, 0]


# --- state ------------------------------------------------------------------------------------


def train(optimizer, rng, steps):
    """A few steps that use every operation."""
    for _ in range(steps):
        n = optimizer.size
        grads = random_gaussians(rng, n)
        visible = rng.random(n) < 0.7
        optimizer.accumulate(grads.means, np.ones(n, np.float32), visible)
        optimizer.add_regularizer(grads)
        optimizer.step(grads, RATES, visible)
        optimizer.add_noise(1e-3)
        if optimizer.steps % 5 == 0:
            densify_mcmc(optimizer, n + 50)
        if optimizer.steps % 7 == 0:
            densify_adaptive(optimizer, clone_scale=0.2, gradient_threshold=1.5)
        if optimizer.steps % 9 == 0:
            optimizer.reset_opacities(0.5)


def assert_same_state(a, b):
    assert a.keys() == b.keys()
    for name, array in a.items():
        np.testing.assert_array_equal(array, b[name], err_msg=name)


def test_state_dict_through_a_file_goes_on_exactly(tmp_path):
    rng = np.random.default_rng(1)
    whole = GaussianOptimizer(random_gaussians(rng, 500), seed=2**63 + 5)
    train(whole, rng, 12)
    np.savez(tmp_path / "state.npz", **whole.state_dict())
    resumed = GaussianOptimizer(random_gaussians(np.random.default_rng(0), 3))
    with np.load(tmp_path / "state.npz") as state:
        resumed.load_state_dict(dict(state))
    train(resumed, np.random.default_rng(9), 10)
    train(whole, np.random.default_rng(9), 10)
    assert_same_state(resumed.state_dict(), whole.state_dict())


def test_load_state_dict_with_a_missing_or_short_array_raises(rng):
    optimizer = GaussianOptimizer(random_gaussians(rng, 4))
    state = optimizer.state_dict()
    for name in state:
        broken = {key: value for key, value in state.items() if key != name}
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            optimizer.load_state_dict(broken)
    assert len(state) == 21
    with pytest.raises(InputError, match="different lengths"):
        optimizer.load_state_dict(state | {"seen": state["seen"][:2]})


def test_gaussians_are_views_that_follow_the_steps(rng):
    g = random_gaussians(rng, 5)
    optimizer = GaussianOptimizer(g, capacity=50)
    view = optimizer.gaussians
    before = view.copy()
    optimizer.step(random_gaussians(rng, 5), RATES)
    assert np.all(view.means != before.means)
    assert_same(g, before)  # the caller's arrays are not touched
    assert view.means.base is not None and optimizer.capacity == 50


def test_optimizer_with_too_small_a_capacity_raises(rng):
    with pytest.raises(InputError, match="capacity is 3, but there are 4 Gaussians"):
        GaussianOptimizer(random_gaussians(rng, 4), capacity=3)


def test_sort_by_place_moves_whole_rows_and_brings_neighbours_together(rng):
    gaussians = random_gaussians(rng, 200, 1)
    optimizer = GaussianOptimizer(gaussians, 220)
    optimizer.gradient_max[:] = gaussians.means[:, 0]
    optimizer.arrays[1].quats[:200] = gaussians.quats
    optimizer.sort_by_place()
    after = optimizer.gaussians
    order = np.lexsort(gaussians.means.T), np.lexsort(after.means.T)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        before = getattr(gaussians, name)[order[0]]
        assert np.array_equal(getattr(after, name)[order[1]], before)
    assert np.array_equal(optimizer.gradient_max, after.means[:, 0])
    assert np.array_equal(optimizer.arrays[1].quats[:200], after.quats)

    def apart(means):
        return np.linalg.norm(np.diff(means, axis=0), axis=1).mean()

    assert apart(after.means) < 0.5 * apart(gaussians.means)
