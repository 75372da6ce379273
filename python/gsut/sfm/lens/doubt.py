"""Judges how well an estimated lens is known, and compares it with what was said of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gsut._core import SolveError
from gsut.data import list_some
from gsut.judge.checks import FOCAL_LIMIT
from gsut.lens import Camera, measure_field_of_view
from gsut.sfm.lens.center import describe_center
from gsut.sfm.lens.covariance import LensCovariance, estimate_lens_covariances
from gsut.sfm.lens.critical_motion import find_critical_motion
from gsut.sfm.lens.given import check_given_lens
from gsut.sfm.lens.prior import estimate_focal_sigma, weigh_focal_prior
from gsut.sfm.mapping import Findings, Mapping
from gsut.sfm.photographs import LensGroup
from gsut.sfm.solution import FEATURE_VARIANCE, LensFlags, Solution, StatedTurns, index_lenses

_CONTRADICTS = 0.1  # relative difference of focal lengths that needs an explanation


def judge_lens(mapping: Mapping) -> Mapping:
    """Adds to the findings how well the focal length of the least known lens is known.

    Where all lenses are known, whether the photographs contradict them; see `check_given_lens`.
    """
    solution, flags = mapping.solved, mapping.lens_free
    if flags is None:
        return check_given_lens(mapping)
    sigma, covariances = _measure_focal_sigma(solution, flags, mapping.turns)
    if isinstance(flags, np.ndarray) and mapping.photographs.frames is None:
        lens = solution.cameras[int(np.flatnonzero(solution.registered)[0])]
        mapping = describe_center(mapping, lens, covariances[0] if covariances else None)
    motion = find_critical_motion(solution, mapping.pairs)
    if mapping.one_lens_free is None:
        sigma = estimate_focal_sigma(mapping, flags, sigma)
    else:
        mapping, sigma = weigh_focal_prior(mapping, sigma)
    if mapping.turns is not None:
        gyroscope = mapping.found.figures["gyroscope"]
        # Features that disagree with the gyroscope know the focal length less well than they seem.
        sigma = math.hypot(sigma, gyroscope["disagreement_percent"] / 100)
        motion = motion if sigma > FOCAL_LIMIT else None  # settled by the gyroscope
        without = _measure_focal_sigma(solution, flags, None)[0]
        sigmas = {"by_features_alone": _to_percent(without), "with": _to_percent(sigma)}
        mapping = mapping.add_findings({"gyroscope": {**gyroscope, "focal_sigma_percent": sigmas}})
    return mapping.add_findings(
        {"focal_sigma_percent": _to_percent(sigma)}, motion=motion, focal_sigma=sigma
    )


def _to_percent(sigma: float) -> float | None:
    return 100 * sigma if math.isfinite(sigma) else None


def _measure_focal_sigma(
    solution: Solution, flags: LensFlags, turns: StatedTurns | None
) -> tuple[float, list[LensCovariance]]:
    """Measures the relative standard deviation of the focal length of the least known lens.

    Returns:
        It, infinite where the images do not determine the lens; and the lenses' covariances.
    """
    try:
        covariances = estimate_lens_covariances(solution, flags, FEATURE_VARIANCE, turns=turns)
    except SolveError:
        return math.inf, []
    lenses = index_lenses(solution.cameras, flags)
    estimated = [c for c, f in zip(lenses.cameras, lenses.free, strict=True) if f is not None]
    sigma = max(
        float(covariance.sigmas[0] / lens.params[0])
        for covariance, lens in zip(covariances, estimated, strict=True)
    )
    return sigma, covariances


def describe_doubt(found: Findings) -> str | None:
    """Describes what leaves an estimated lens open; None if it is known well enough."""
    if found.focal_sigma is None:
        return None
    if found.focal_sigma <= FOCAL_LIMIT and found.motion is None:
        return None
    known = f"to {200 * found.focal_sigma:.1f} %" if 2 * found.focal_sigma <= 0.5 else "not at all"
    if found.motion:
        return (
            f"{found.motion}; by the errors of the features alone the focal length is known "
            f"{known} (two standard deviations)"
        )
    return (
        f"these images determine the focal length {known} (two standard deviations); give "
        "--camera or --fov if you know the lens"
    )


def compare_lens(mapping: Mapping) -> list[str]:
    """Compares the lens that was found with what the photographs say: one sentence each."""
    photographs, groups = mapping.photographs, mapping.photographs.groups
    if len(groups) > 1 or (groups and len(groups[0].images) < len(photographs)):
        return _describe_cameras(groups, mapping.solved)
    if mapping.found.figures["lens"] == "estimated" and photographs.exif_focal_px is not None:
        return explain_contradiction(photographs.exif_focal_px, mapping.solved.cameras[0])
    return []


def _describe_cameras(groups: Sequence[LensGroup], solution: Solution) -> list[str]:
    """Names the cameras whose lens was found, and those whose images all have no pose."""
    notes, found = [], []
    for group in groups:
        if solution.registered[group.images].any():
            found.append(group.name or "images")
            continue
        names = [solution.names[i] for i in group.images]
        notes.append(
            f"no lens was found for the {len(names)} images of the camera {group.name}, which "
            f"have no pose: {list_some(names)}; give their lens file, or more images that "
            "overlap with each other or with those of the other cameras"
        )
    if found:
        notes.insert(0, f"the lens of each of these cameras was found: {', '.join(found)}")
    return notes


def explain_contradiction(exif_focal_px: float, lens: Camera) -> list[str]:
    """Explains, in a sentence, a lens far from the focal length that EXIF states."""
    found = float(lens.params[0])
    if abs(found / exif_focal_px - 1) <= _CONTRADICTS:
        return []
    said = 2 * math.degrees(math.atan(lens.width / 2 / exif_focal_px))
    field = measure_field_of_view(lens)
    seen = "" if field is None else f", {field:.0f} degrees across"
    return [
        f"EXIF states a focal length of {exif_focal_px:.0f} px ({said:.0f} degrees across as a "
        f"perspective lens), but {found:.0f} px were found{seen}: the photographs were cropped or "
        "corrected in the camera, or the lens found is wrong; if renders look bent, give the field "
        "of view by --fov or a lens by --camera"
    ]
