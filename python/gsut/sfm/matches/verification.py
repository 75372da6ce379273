"""Keeps matches that agree with relative poses, and explains why nothing can be reconstructed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut._core import SolveError
from gsut.data import list_some
from gsut.gaussians import find_rotation_vectors
from gsut.judge import SURE
from gsut.judge.checks import PICTURE_CHECKS, PictureQuality, find_faults
from gsut.least_squares import ROUNDS
from gsut.run import Verdict
from gsut.sfm.matches.matching import (
    BATCH,
    PREVIEW_FEATURES,
    OnPairs,
    PairMatches,
    RawMatches,
)
from gsut.sfm.matches.selection import ENOUGH_MATCHES, FEW_IMAGES
from gsut.sfm.photographs import Features, Images, PosesOptions

# Largest angle in radians between a pair's rotation and that of all images. Rotations of pairs are
# often off by 20 degrees where both see a plane; a pair of places that look alike is off by any
# angle.
LARGEST_OFFSET = np.radians(45.0)
_SCALE = np.radians(8.0)  # of the robust weights: the offset of an ordinary pair
MIN_ANGLE_DEGREES = 1.5  # smallest triangulation angle of a point
_DARK = 25  # mean grey value of the features of an underexposed picture, of 255
_BRIGHT = 235  # mean grey value of the features of an overexposed picture, of 255
FEWEST_MATCHES = 20  # verified, of a pair that is used: fewer of anything hold no pose
# Factor on the largest errors under a rolling shutter, until velocities are estimated.
ROLLING_ERROR = 12.0
ALL_SAME = (
    "all images are the same: matched features do not move; give photographs from different places"
)


def verify_matches(
    images: Images,
    raw: RawMatches,
    options: PosesOptions,
    on_pairs: OnPairs = lambda done, total: None,
) -> list[PairMatches]:
    """Keeps matches that agree with one relative pose a pair, and with the other pairs' rotations.

    Matches of a rolling shutter may be ROLLING_ERROR times farther off. Each other's nearest among
    learned features, which no ratio of distances sorts out, agree with some pose by chance: as many
    of the others then agree with another one. Such pairs are left out.

    Returns:
        The pairs with at least FEWEST_MATCHES matches that the others do not contradict.
    """
    bearings = [
        _core.ImageBearings(c, f.pixels)
        for c, f in zip(images.cameras, images.features, strict=True)
    ]
    valid = [b.valid for b in bearings]
    diagonal = max(float(np.hypot(c.width, c.height)) for c in images.cameras)
    max_error = options.max_two_view_error * diagonal / 1000
    if images.shutter is not None:
        max_error *= ROLLING_ERROR
    result = []
    for begin in range(0, len(raw.pairs), BATCH):
        batch = raw.pairs[begin : begin + BATCH]
        found = [
            m[valid[a][m[:, 0]] & valid[b][m[:, 1]]]
            for (a, b), m in zip(batch, raw.matches[begin : begin + BATCH], strict=True)
        ]
        verified = _core.verify_pairs(bearings, batch, found, max_error, options.seed)
        most = np.zeros(len(batch))
        if any(f.is_learned is not None for f in images.features):
            rest = [m[~each[0]] for m, each in zip(found, verified, strict=True)]
            rivals = _core.verify_pairs(bearings, batch, rest, max_error, options.seed)
            most = np.array([each[0].sum() for each in rivals])
        for (a, b), matches, rival, (inliers, pose, rotation, parallax, ok) in zip(
            batch, found, most, verified, strict=True
        ):
            count = int(inliers.sum())
            is_clear = count - rival > SURE * np.sqrt(count + rival)
            if ok and count >= FEWEST_MATCHES and is_clear:
                result.append(
                    PairMatches(int(a), int(b), matches[inliers], pose, rotation, parallax)
                )
        on_pairs(begin + len(batch), len(raw.pairs))
    return drop_contradicted(result, len(images))


def drop_contradicted(pairs: Sequence[PairMatches], count: int) -> list[PairMatches]:
    """Drops the pairs whose rotation disagrees with the rotations of all images.

    Images get rotations from the pairs with most matches first (a spanning tree), then from all
    pairs with robust weights (Chatterjee and Govindu, "Efficient and robust large-scale rotation
    averaging", ICCV 2013).

    Args:
        pairs: verified, of `count` images.
    """
    if len(pairs) < 3:
        return list(pairs)
    first = np.array([pair.first for pair in pairs])
    second = np.array([pair.second for pair in pairs])
    relative = np.array([pair.second_from_first[:3, :3] for pair in pairs])
    weights = np.array([float(min(len(pair.matches), ENOUGH_MATCHES)) for pair in pairs])
    rotations = _chain_rotations((first, second), relative, weights, count)
    for _ in range(ROUNDS):
        off = _measure_offsets(rotations, (first, second), relative)
        robust = weights / (1 + (np.linalg.norm(off, axis=1) / _SCALE) ** 2) ** 2
        laplacian = np.zeros((count, count))
        pull = np.zeros((count, 3))
        np.add.at(laplacian, (first, first), robust)
        np.add.at(laplacian, (second, second), robust)
        np.add.at(laplacian, (first, second), -robust)
        np.add.at(laplacian, (second, first), -robust)
        np.add.at(pull, second, robust[:, None] * off)
        np.add.at(pull, first, -robust[:, None] * off)
        laplacian[np.diag_indices(count)] += 1e-6 * weights.mean()  # the world's own rotation
        turns = np.linalg.solve(laplacian, pull)
        rotations = np.array(
            [
                r @ _core.exp_pose(np.concatenate([np.zeros(3), turn]))[:3, :3]
                for r, turn in zip(rotations, turns, strict=True)
            ]
        )
    off = np.linalg.norm(_measure_offsets(rotations, (first, second), relative), axis=1)
    return [pair for pair, angle in zip(pairs, off, strict=True) if angle < LARGEST_OFFSET]


def _chain_rotations(
    ends: tuple[np.ndarray, np.ndarray], relative: np.ndarray, weights: np.ndarray, count: int
) -> np.ndarray:
    """Chains (N, 3, 3) camera_from_world along the pairs with most matches."""
    first, second = ends
    group = np.arange(count)
    rotations = np.tile(np.eye(3), (count, 1, 1))
    for index in np.argsort(-weights, kind="stable"):
        a, b = first[index], second[index]
        if group[a] == group[b]:
            continue
        # The group of b turns as a whole: R_b turn = relative R_a.
        members = group == group[b]
        rotations[members] = rotations[members] @ (rotations[b].T @ relative[index] @ rotations[a])
        group[members] = group[a]
    return rotations


def _measure_offsets(
    rotations: np.ndarray, ends: tuple[np.ndarray, np.ndarray], relative: np.ndarray
) -> np.ndarray:
    """Returns (P, 3) radians, the turn in the world that each pair's second image lacks."""
    first, second = ends
    wanted = relative @ rotations[first]
    return find_rotation_vectors(np.swapaxes(rotations[second], 1, 2) @ wanted)


def require_overlap(images: Images, pairs: Sequence[PairMatches], *, is_lens_known: bool) -> None:
    """Rejects images of which no two overlap.

    Args:
        pairs: verified matches.

    Raises:
        SolveError: no two images have matches that agree.
    """
    if not pairs:
        few = [
            name
            for name, features in zip(images.names, images.features, strict=True)
            if len(features) < FEWEST_MATCHES
        ]
        if len(few) * 2 > len(images):
            raise SolveError(
                f"{len(few)} of {len(images)} images have almost no features"
                f" ({list_some(few)}); photograph something with texture, in focus and well lit"
            )
        lens = ", or the lens is not theirs" if is_lens_known else ""
        raise SolveError(
            f"no two of the {len(images)} images have matches that agree: they show different "
            f"things or overlap too little{lens}; give photographs of one place, each overlapping "
            "the next by more than half"
        )


def explain_failure(
    error: SolveError,
    features: Sequence[Features],
    pairs: Sequence[PairMatches],
    advice: str,
) -> SolveError:
    """Adds to a solver's error what the images say about its cause, gravest first.

    Args:
        features: of all images.
        pairs: verified matches.
        advice: what else may help.
    """
    faults = find_faults(PICTURE_CHECKS, measure_pictures(features))
    reasons = [f"{f.what}: {f.advice}" for f in faults if Verdict.LEVELS[f.severity] == "poor"]
    if len(features) < FEW_IMAGES:
        reasons.append(f"{len(features)} images are few")
    parallax = np.degrees(float(np.median([pair.parallax for pair in pairs] or [np.inf])))
    if parallax < MIN_ANGLE_DEGREES:
        reasons.append(f"the camera hardly moved between them ({parallax:.1f} degrees of parallax)")
    steps = f"walk sideways to what you photograph, or {advice}"
    return SolveError("; ".join([str(error), *reasons, steps]))


def measure_pictures(
    features: Sequence[Features], posed: np.ndarray | None = None
) -> PictureQuality:
    """Counts the images that are badly exposed, and those with few features.

    Args:
        features: of all images.
        posed: (images,) bool; an image that has a pose had features enough, however few: small
            pictures have fewer. None if no image has a pose.
    """
    posed = np.zeros(len(features), bool) if posed is None else posed
    grey = np.array([float(f.colors.mean()) for f in features if len(f)])
    return PictureQuality(
        images=len(features),
        dark=int((grey < _DARK).sum()),
        bright=int((grey > _BRIGHT).sum()),
        featureless=sum(
            len(f) < PREVIEW_FEATURES for f, has in zip(features, posed, strict=True) if not has
        ),
    )
