"""A camera that turned or stood still is told from one that moved, however little."""

import contextlib
import dataclasses

import numpy as np
import pytest

import gsut
from gsut import SolveError
from gsut.sfm.lens import still_camera
from gsut.sfm.lens.still_camera import require_motion
from gsut.sfm.matches.matching import RawMatches, match_images
from gsut.sfm.photographs.listing import LensGroup
from gsut.sfm.photographs.options import PosesOptions
from synthetic_walk import Synthetic, observe, quiet, shuffled

LENS = gsut.Camera("kannala_brandt", [420, 420, 505, 500, 0.03, -0.01, 0, 0], 1000, 1010)


def find_matches(*, is_known, wrong=0.3, noise=0.3, **motion):
    """The state of a run after matching; a share of the matches of each pair is wrong."""
    scene = Synthetic(np.random.default_rng(7), 6, 500, noise, camera=LENS, **motion)
    return match_scene(scene, is_known, wrong)


def match_scene(scene, is_known, wrong):
    raw = match_images([f"{i}" for i in range(6)], scene.features, PosesOptions(), quiet)
    mixed = [matches.copy() for matches in raw.matches]
    for matches in mixed:
        some = matches[:: round(1 / wrong), 1]
        some[:] = np.roll(some, 1)
    guess = gsut.Camera("pinhole", [900, 900, 500, 505], 1000, 1010)
    mapping = scene.mapping(
        PosesOptions(), camera=None if is_known else guess, raw=RawMatches(raw.pairs, mixed)
    )
    groups = () if is_known else (LensGroup("", np.arange(6)),)
    photographs = dataclasses.replace(mapping.photographs, groups=groups)
    mapping = mapping.replace(photographs=photographs)
    return mapping.add_findings({"lens": "known" if is_known else "estimated"})


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (1.0, "turned but did not move: . of . pairs"),
        (0.0, "the camera did not move: . of . pairs"),
    ],
)
def test_camera_without_motion_is_refused(is_known, turn, words):
    mapping = find_matches(is_known=is_known, turn=turn, reach=0.0)
    with pytest.raises(gsut.SolveError, match=words) as refused:
        require_motion(mapping)
    assert " px, so there is no depth; walk " in str(refused.value)


@pytest.mark.parametrize("is_known", [True, False])
def test_noisy_turn_is_refused(is_known):
    with pytest.raises(gsut.SolveError, match="did not move"):
        require_motion(find_matches(is_known=is_known, turn=1.0, reach=0.0, noise=1.2))


@pytest.mark.parametrize("is_known", [True, False])
def test_equal_images_are_refused_as_a_still_background_is(is_known):
    mapping = find_matches(is_known=is_known, wrong=0.1, turn=0.0, reach=0.0, noise=0.0)
    with pytest.raises(gsut.SolveError, match="before a still background, leave that out by masks"):
        require_motion(mapping)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("turn", [1.0, 0.1, 0.0])
@pytest.mark.parametrize("reach", [1.0, 0.02])  # of 0.02: 3 pixels from first to last
def test_camera_that_moved_is_not_refused(is_known, turn, reach):
    require_motion(find_matches(is_known=is_known, turn=turn, reach=reach))


class StraightFlight(Synthetic):
    """A straight flight over a plane through a lens of 35 degrees, in steps of seven pixels."""

    def __init__(self, rng):
        lens = gsut.Camera("pinhole", [517, 517, 80, 140], 160, 280)
        super().__init__(rng, 0, 2000, camera=lens)
        self.points *= [1, 1, 0]
        identity = rng.random((2000, 128)) ** 4
        for i in range(6):
            pose = np.eye(4)
            pose[:3, 3] = [0.5 * (2.5 - i), 0, 10]
            _, features = observe(rng, lens, *self._seen(lens, pose, np.zeros(6)), 0.03, identity)
            self.features.append(shuffled(rng, features))


def test_straight_flight_over_a_plane_through_a_known_narrow_lens_is_not_refused():
    require_motion(match_scene(StraightFlight(np.random.default_rng(7)), True, 0.1))


@pytest.mark.parametrize(("turned", "is_refused"), [(4, True), (3, True), (2, False)])
def test_rotations_must_explain_most_pairs_not_most_matches(turned, is_refused):
    matches = np.where(np.arange(4) < turned, 200, 40)  # two large pairs hold five in six
    pair = np.repeat(np.arange(4), matches)
    pixels = np.stack([np.zeros((len(pair), 2)), np.full((len(pair), 2), 20.0)])
    fitted = np.arange(len(pair)) % 2 == 0
    sample = still_camera._Sample(np.array([[0, 1]] * 4), pair, pixels, fitted)
    turns = np.where(pair < turned, 0.1, 5.0)
    expected = pytest.raises(SolveError, match="turned but did not move")
    with expected if is_refused else contextlib.nullcontext():
        still_camera._refuse_turns(sample, turns, np.full(len(pair), 0.1), 1.0)
