"""Judges how well an estimated lens is known."""

from __future__ import annotations

import math

import numpy as np

from gsut.data import list_some
from gsut.sfm.lens.center import describe_center
from gsut.sfm.lens.covariance import measure_focal_sigma
from gsut.sfm.lens.given import check_given_lens
from gsut.sfm.lens.jackknife import (
    adjust_without_groups,
    estimate_focal_sigma,
    measure_lens_sigma,
    measure_pose_errors,
)
from gsut.sfm.lens.prior import find_lens, weigh_focal_prior
from gsut.sfm.mapping import Mapping


def judge_lens(mapping: Mapping) -> Mapping:
    """Adds to the findings how well lenses are known, and where one was estimated the poses.

    Where all lenses are known, whether the photographs contradict them; see `check_given_lens`.
    """
    solution, flags = mapping.solved, mapping.lens_free
    if flags is None:
        return check_given_lens(mapping)
    sigma, known = measure_focal_sigma(solution, flags, mapping.turns)
    if isinstance(flags, np.ndarray) and mapping.photographs.frames is None:
        mapping = describe_center(mapping, find_lens(solution), known[0] if known else None)
    by_turns = mapping.found.figures.get("focal_prior")
    if by_turns is not None:
        sigma = by_turns["sigma_percent"] / 100
    else:
        without = adjust_without_groups(mapping, flags)
        sigma = alone = estimate_focal_sigma(mapping, flags, sigma, without)
        if mapping.one_lens_free is not None:
            mapping, sigma = weigh_focal_prior(mapping, mapping.one_lens_free, alone)
        if without is not None and len(without) > 1 and math.isfinite(alone):
            mapping = mapping.add_findings(
                pose_errors_px=measure_pose_errors(mapping.solved, without),
                lens_sigma_px=measure_lens_sigma(without, sigma),
            )
    percent = 100 * sigma if math.isfinite(sigma) else None
    return mapping.add_findings({"focal_sigma_percent": percent}, focal_sigma=sigma)


def describe_cameras(mapping: Mapping) -> list[str]:
    """Names the cameras whose lens was found, and those whose images all have no pose."""
    groups, solution = mapping.photographs.groups, mapping.solved
    if len(groups) < 2 and not (groups and len(groups[0].images) < len(mapping.photographs)):
        return []
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
