"""The one Levenberg-Marquardt: known minima, many problems at once, and where it stops."""

import numpy as np
import pytest

import tolerances
from gsut.least_squares import minimize_least_squares


def rosenbrock(x):
    """Residuals (2,) and their derivative (2, 2); the minimum is 0 at (1, 1)."""
    return (
        np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
        np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]),
    )


def solve(start, residuals, **options):
    def normal_equations(x):
        r, j = residuals(x)
        return j.T @ r, j.T @ j

    options = {"max_steps": 100, **options}
    return minimize_least_squares(
        start, lambda x: np.sum(residuals(x)[0] ** 2), normal_equations, **options
    )


def test_rosenbrock_valley_is_followed_to_its_end():
    found, cost = solve(np.array([-1.2, 1.0]), rosenbrock)
    np.testing.assert_allclose(found, 1.0, rtol=tolerances.LEAST_SQUARES)
    assert cost < tolerances.LEAST_SQUARES**2


def test_many_problems_at_once_find_what_each_finds_alone(rng):
    starts, wanted = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))

    def cost_of(x):
        return np.sum((x**3 + x - wanted) ** 2, axis=-1)

    def normal_equations(x):
        slope = 3 * x**2 + 1
        return slope * (x**3 + x - wanted), slope[..., None] ** 2 * np.eye(3)

    found, cost = minimize_least_squares(starts, cost_of, normal_equations, max_steps=50)
    np.testing.assert_allclose(found**3 + found, wanted, atol=tolerances.LEAST_SQUARES)
    assert cost.shape == (20,)


def test_steps_into_a_forbidden_region_are_shortened():
    # sqrt(x) - 0.1 leads from 4 to negative numbers, which have no cost.
    def residuals(x):
        return np.sqrt(x) - 0.1, 0.5 / np.sqrt(x)[:, None]

    def cost_of(x):
        return np.sum(residuals(x)[0] ** 2) if x[0] > 0 else np.inf

    def normal_equations(x):
        r, j = residuals(x)
        return j.T @ r, j.T @ j

    found, _ = minimize_least_squares(np.array([4.0]), cost_of, normal_equations, max_steps=50)
    np.testing.assert_allclose(found, 0.01, rtol=tolerances.LEAST_SQUARES)


@pytest.mark.parametrize(("options", "steps"), [({"max_steps": 3}, 3), ({"least_gain": 1.0}, 1)])
def test_it_stops_where_it_is_told_to(options, steps):
    formed = []

    def normal_equations(x):
        formed.append(x)
        return 0.1 * x, np.eye(2)  # steps a tenth as long as they should be

    minimize_least_squares(
        np.ones(2), lambda x: np.sum(x**2), normal_equations, **{"max_steps": 50, **options}
    )
    assert len(formed) == steps


def test_an_unknown_of_no_effect_stays():
    found, _ = solve(
        np.array([3.0, 7.0]), lambda x: (x[:1] - 1, np.array([[1.0, 0.0]])), max_steps=10
    )
    np.testing.assert_allclose(found, [1.0, 7.0], rtol=tolerances.LEAST_SQUARES)


def test_unknowns_that_are_no_sum_of_steps_are_moved_by_the_callers_rule():
    # A point of the unit circle is turned by an angle until it is the wanted one.
    wanted = np.array([0.6, 0.8])

    def turned(point, angle):
        c, s = np.cos(angle[0]), np.sin(angle[0])
        return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])

    def normal_equations(point):
        along = np.array([-point[1], point[0]])
        return np.array([along @ (point - wanted)]), np.array([[along @ along]])

    found, _ = minimize_least_squares(
        np.array([1.0, 0.0]), lambda point: np.sum((point - wanted) ** 2), normal_equations,
        max_steps=50, apply=turned,
    )  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=tolerances.LEAST_SQUARES)
