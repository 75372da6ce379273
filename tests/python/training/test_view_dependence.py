"""Whether colours depend on the direction, told from points of known colours, and what follows."""

import numpy as np
import pytest

import gsut
from gsut import TrainOptions
from gsut.training.first import choose_degree, complexity, view_dependence

POINTS, VIEWS = 150, 12


def share(rng, slope, noise, others=0.0):
    """Of points seen from half a sphere; `others` of the samples show another surface."""
    point = np.repeat(np.arange(POINTS), VIEWS)
    directions = rng.normal(size=(len(point), 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    slopes = slope * rng.normal(size=(POINTS, 3))[point]
    colors = rng.normal(size=POINTS)[point] + np.einsum("ni,ni->n", slopes, directions)
    colors += noise * rng.normal(size=len(point))
    hidden = rng.random(len(point)) < others
    colors[hidden] += rng.choice([-2.0, 2.0], hidden.sum())
    return view_dependence._predict_left_out(point, colors, directions)


def test_colors_without_a_direction_are_not_foretold(rng):
    assert 0.95 < share(rng, 0.0, 0.05) < 1.4
    assert 0.95 < share(rng, 0.0, 0.02, others=0.05) < 1.4


def test_colors_that_follow_the_direction_are_foretold(rng):
    assert share(rng, 0.1, 0.01) < 0.2
    assert share(rng, 0.1, 0.03) < share(rng, 0.1, 0.06) < 1.0


def test_each_sample_is_left_out_of_its_own_forecast(rng):
    """Against a fit for each sample of its own."""
    point = np.repeat(np.arange(120), 7)
    directions = rng.normal(size=(len(point), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = 0.1 * directions[:, 0] + 0.02 * rng.normal(size=len(point))
    foretold, by_mean = [], []
    for number in range(120):
        own = point == number
        c, d = colors[own] - colors[own].mean(), directions[own] - directions[own].mean(axis=0)
        d /= np.sqrt(np.square(d).sum(axis=1).mean())
        for k in range(len(c)):
            rest = np.arange(len(c)) != k
            basis = np.column_stack([np.ones(rest.sum()), d[rest]])
            normal = basis.T @ basis + np.diag([0.0, 1.0, 1.0, 1.0])
            found = np.linalg.solve(normal, basis.T @ c[rest])
            foretold.append(c[k] - found[0] - d[k] @ found[1:])
            by_mean.append(c[k] - c[rest].mean())
    expected = np.square(foretold).sum() / np.square(by_mean).sum()
    assert view_dependence._predict_left_out(point, colors, directions) == pytest.approx(expected)


def test_few_points_tell_nothing(rng):
    point = np.repeat(np.arange(20), 8)
    directions = rng.normal(size=(160, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert view_dependence._predict_left_out(point, rng.normal(size=160), directions) is None


def test_degree_of_harmonics_follows_the_photographs_where_it_is_open(scene, monkeypatch, capsys):
    assert view_dependence.measure_unpredicted_share(scene) is None  # a handful of points
    assert choose_degree(scene, TrainOptions()).sh_degree == 1
    rows = [(0.5, {}, 3), (0.9, {}, 1), (0.5, {"sh_degree": 0}, 0), (0.9, {"preset": "best"}, 2)]
    for unforeseen, given, degree in rows:
        monkeypatch.setattr(
            complexity, "measure_unpredicted_share", lambda scene, value=unforeseen: value
        )
        assert choose_degree(scene, TrainOptions(**given)).sh_degree == degree
    monkeypatch.setattr(complexity, "measure_unpredicted_share", lambda scene: 0.5)
    options = TrainOptions(steps=20, max_gaussians=100)
    result = gsut.train(scene, options, progress=True)
    assert result.gaussians.sh_degree == result.metrics["complexity"]["sh_degree"] == 3
    line = "colours depend on the direction that they are seen from: harmonics of degree 3"
    assert line in capsys.readouterr().err
    assert any(note.startswith(line) for note in result.metrics["notes"])
