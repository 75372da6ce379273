"""Which of two structures explains the same matches better, and when that is chance."""

import itertools

import numpy as np
import pytest

from gsut.judge import Matches, Structure, prefer, score_errors
from gsut.judge.preference import estimate_noise
from tolerances.judge import ESTIMATED_NOISE, ESTIMATED_SHARE

IMAGES, MATCHES, EXTENT = 8, 40, 350.0


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def matches():
    pairs = list(itertools.combinations(range(IMAGES), 2))
    return Matches(np.repeat(pairs, MATCHES, axis=0), EXTENT)


def make_errors(rng, matches, noise=0.3, wrong=0.1):
    """Makes errors of right matches, a share of wrong ones among them."""
    errors = np.abs(rng.normal(0, noise, len(matches.images)))
    is_wrong = rng.random(len(errors)) < wrong
    errors[is_wrong] = rng.uniform(0, EXTENT, int(is_wrong.sum()))
    return errors


def test_prefer_same_structure_keeps_current(rng, matches):
    same = Structure(make_errors(rng, matches))
    found = prefer(same, Structure(same.errors.copy()), matches)
    assert not found.is_rival
    assert found.gain == 0


def test_prefer_other_draw_of_the_same_noise_keeps_current(rng, matches):
    for _ in range(20):
        current, rival = (Structure(make_errors(rng, matches)) for _ in range(2))
        assert not prefer(current, rival, matches).is_rival


def test_prefer_rival_that_explains_more_of_every_image_takes_it(rng, matches):
    errors = make_errors(rng, matches, wrong=0.05)
    found = prefer(Structure(errors + 1.0), rival := Structure(errors), matches)
    assert found.is_rival
    assert found.gain > 3 * found.sigma
    assert not prefer(rival, Structure(errors + 1.0), matches).is_rival


def test_prefer_gain_of_one_pair_alone_keeps_current(rng, matches):
    errors = make_errors(rng, matches)
    worse = errors.copy()
    worse[:MATCHES] += 5.0
    found = prefer(Structure(worse), Structure(errors), matches)
    assert not found.is_rival
    assert found.gain > found.sigma


def test_prefer_rival_that_loses_most_images_keeps_current(rng, matches):
    errors = make_errors(rng, matches)
    first = (matches.images <= 2).all(axis=1)
    one, other = errors.copy(), errors.copy()
    one[first] += 50.0
    other[~first] += 0.3
    found = prefer(Structure(one), Structure(other), matches)
    assert found.share < 0.5
    assert not found.is_rival


def test_prefer_images_without_pose_count_their_matches_as_wrong(rng, matches):
    errors = make_errors(rng, matches)
    lost = np.where((matches.images < IMAGES // 2).any(axis=1), np.nan, errors)
    found = prefer(Structure(lost), Structure(errors), matches)
    assert found.is_rival


def test_prefer_free_parameters_and_priors_cost_their_nats(rng, matches):
    errors = make_errors(rng, matches)
    current = Structure(errors + 0.2)
    gain = prefer(current, Structure(errors), matches).gain
    paid = prefer(current, Structure(errors, free=10), matches).gain
    _, share = estimate_noise(np.stack([errors + 0.2, errors]), EXTENT)
    assert gain - paid == pytest.approx(5 * np.log(share * len(errors)))
    assert prefer(current, Structure(errors, prior=-7.0), matches).gain == pytest.approx(gain - 7)


def test_prefer_impossible_structure_loses_to_any(rng, matches):
    errors = make_errors(rng, matches)
    impossible = Structure(errors, prior=-np.inf)
    rival = Structure(errors + 1.0)
    assert prefer(impossible, rival, matches).is_rival
    assert not prefer(rival, impossible, matches).is_rival


def test_prefer_without_matches_keeps_current():
    current, rival = Structure(np.zeros(0)), Structure(np.zeros(0))
    assert not prefer(current, rival, Matches(np.zeros((0, 2), int), EXTENT)).is_rival


def test_estimate_noise_mixture_returns_both_parts(rng, matches):
    noise, share = estimate_noise(make_errors(rng, matches, noise=0.4, wrong=0.3), EXTENT)
    assert noise == pytest.approx(0.4, rel=ESTIMATED_NOISE)
    assert share == pytest.approx(0.7, abs=ESTIMATED_SHARE)


def test_score_errors_is_density_over_that_of_a_wrong_match():
    scores = score_errors(np.array([0.0, 1e6, np.nan]), 0.5, 0.8, EXTENT)
    peak = 0.8 * np.sqrt(2 / np.pi) / 0.5 * EXTENT
    assert scores == pytest.approx(np.log([0.2 + peak, 0.2, 0.2]))


def test_prefer_what_is_known_beside_matches_overrules_them_where_it_weighs_more(rng, matches):
    errors = make_errors(rng, matches)
    current, worse = Structure(errors), errors + 0.1
    loss = -prefer(current, Structure(worse), matches).gain
    assert loss > 0
    assert not prefer(current, Structure(worse, prior=loss / 2), matches).is_rival
    found = prefer(current, Structure(worse, prior=10 * loss), matches)
    assert found.is_rival and found.share < 0.5
