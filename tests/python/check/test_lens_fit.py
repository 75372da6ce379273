"""The doctor's correction of a lens claims no more than the matches determine."""

import types

import numpy as np
import pytest

import gsut
from gsut.check.epipolar import Matches
from gsut.check.lens_errors import (
    _is_preferred,
    _rate_pairs,
    find_lens_errors,
    is_of_another_size,
    is_off,
)
from gsut.check.lens_fit import fit_lens

LENSES = {
    "pinhole": gsut.Camera("pinhole", [120.0, 120.0, 100.0, 75.0], 200, 150),
    "fisheye": gsut.Camera("kannala_brandt", [60.0, 60.0, 100.0, 75.0, 0, 0, 0, 0], 200, 150),
}
VIEWS = 12


def make_matches(lens, step, rng, turn=0.0):
    """Matches of neighbours on a path, noisy, a tenth of them wrong; and their poses."""
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    for pose in poses:
        pose[:3, :3] = gsut.exp_pose([0, 0, 0, *rng.normal(0, turn, 3)])[:3, :3]
    poses[:, :3, 3] = np.arange(VIEWS)[:, None] * np.asarray(step)
    pairs, pixels, number = [], [], []
    for first in range(VIEWS - 1):
        points = rng.uniform([-4, -3, 2], [4, 3, 9], (150, 3)) + poses[first, :3, 3]
        sides = [lens.project((points - poses[v, :3, 3]) @ poses[v, :3, :3])
                 for v in (first, first + 1)]  # fmt: skip
        size = [lens.width, lens.height]
        seen = np.all([ok & np.all((p > 0) & (p < size), axis=1) for p, ok in sides], axis=0)
        both = np.stack([p[seen] for p, _ in sides]) + rng.normal(0, 0.1, (2, seen.sum(), 2))
        wrong = rng.random(seen.sum()) < 0.1
        both[1, wrong] = rng.uniform(0, size, (wrong.sum(), 2))
        pixels.append(both)
        number += [len(pairs)] * both.shape[1]
        pairs.append((first, first + 1))
    matches = Matches(
        np.array(number), np.array(pairs), np.concatenate(pixels, axis=1),
        np.zeros((2, len(number)), np.int64), float(np.hypot(lens.width, lens.height)),
    )  # fmt: skip
    return matches, poses[matches.pairs[matches.pair].T]


@pytest.mark.parametrize("name", LENSES)
def test_correction_of_an_exact_lens_on_a_straight_path_is_not_claimed(name):
    claimed = []
    for seed in range(4):
        matches, poses = make_matches(LENSES[name], [0, 0, 0.4], np.random.default_rng(seed))
        claimed.append(bool(is_off(fit_lens([LENSES[name]], matches, poses)).any()))
    assert not any(claimed)


@pytest.mark.parametrize("name", LENSES)
def test_correction_of_a_lens_three_percent_too_long_is_found(name, rng):
    lens = LENSES[name]
    params = np.array(lens.params)
    params[:2] *= 1.03
    matches, poses = make_matches(lens, [0.3, 0.2, 0.2], rng, turn=0.1)
    fit = fit_lens([lens.with_params(params)], matches, poses)
    assert is_off(fit)[0]
    assert abs(fit.values[0] + np.log(1.03)) < 4 * fit.sigmas[0]


def make_evidence(lens, matches, poses):
    scene = types.SimpleNamespace(cameras=[lens])
    table = types.SimpleNamespace(select_poses=lambda: poses)
    return types.SimpleNamespace(
        scene=scene, matches=matches, table=table, make_finding=lambda *words: words
    )


def test_longer_lens_fits_no_better_in_pixels(rng):
    lens = LENSES["fisheye"]
    evidence = make_evidence(lens, *make_matches(lens, [0, 0, 0.4], rng))
    bent = lens.with_params([*lens.params[:4], 0.05, 0, 0, 0])  # angles become smaller outside
    gains = _rate_pairs(evidence, [lens]) - _rate_pairs(evidence, [bent])
    assert gains.shape == (VIEWS - 1,)
    assert not _is_preferred(gains)


@pytest.mark.parametrize(("factor", "named"), [(1.03, True), (1.0, False)])
def test_lens_is_named_where_pairs_prefer_another(factor, named, rng):
    lens = LENSES["pinhole"]
    matches, poses = make_matches(lens, [0.3, 0.2, 0.2], rng, turn=0.1)
    given = lens.with_params(np.array(lens.params) * [factor, factor, 1, 1])
    evidence, fit = make_evidence(given, matches, poses), fit_lens([given], matches, poses)
    said = [what for _, what, _ in find_lens_errors(evidence, fit)]
    assert ["a focal length times 0.9" in what for what in said] == [True] * named


@pytest.mark.parametrize(("factors", "same"), [([1.04] * 4, True), ([1.04, 1.04, 1, 1], False)])
def test_lens_of_images_of_another_size_is_told_from_another_focal_length(factors, same, rng):
    lens = LENSES["pinhole"]
    matches, poses = make_matches(lens, [0.3, 0.2, 0.2], rng, turn=0.1)
    given = lens.with_params(np.array(lens.params) * factors)
    assert is_of_another_size(given, fit_lens([given], matches, poses)) == same
