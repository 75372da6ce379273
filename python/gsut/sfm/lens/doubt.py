"""Judges how well an estimated lens is known, and compares it with what was said of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.data.poses import find_centers
from gsut.lens import Camera, LensProfile, measure_field_of_view
from gsut.run.verdicts import FOCAL_LIMITS
from gsut.sfm.lens.center import describe_center
from gsut.sfm.lens.covariance import estimate_lens_covariances
from gsut.sfm.lens.prior import weigh_focal_prior
from gsut.sfm.mapping import Findings, Mapping
from gsut.sfm.matches import PairMatches
from gsut.sfm.photographs import PosesOptions
from gsut.sfm.solution import FEATURE_VARIANCE, Solution, index_lenses, measure_rotation_angles

TURNED = "the camera mostly turned on the spot"  # how that sentence begins
_STRAIGHT = 0.03  # second over first extent of the camera centres, below which they lie on a line
_FLAT = 0.03  # third over second extent of the points, below which they lie in a plane
_LITTLE_TURN = math.radians(10.0)  # between the views: it constrains no lens
_LITTLE_PARALLAX = math.radians(2.0)  # too little for depths that serve other views
_TURN_SHARE = 0.1  # parallax of a pair over its turn, below which the camera only turned
_MOSTLY = 0.8  # share of the pairs that speaks for the whole capture
_TURNED_ONLY = 0.9  # share of a pair's matches that a rotation must explain
_CONTRADICTS = 0.1  # relative difference of focal lengths that needs an explanation


def judge_lens(mapping: Mapping) -> None:
    """Adds to the findings how well the focal length of the least known lens is known.

    Does nothing where all lenses are known.
    """
    solution, flags = mapping.solved, mapping.lens_free
    if flags is None:
        return
    found = mapping.found
    found.motion = find_critical_motion(solution, mapping.pairs)
    found.focal_sigma = math.inf
    covariances = []
    try:
        covariances = estimate_lens_covariances(
            solution, flags, mapping.options.loss_scale, FEATURE_VARIANCE
        )
        lenses = index_lenses(solution.cameras, flags)
        estimated = [c for c, f in zip(lenses.cameras, lenses.free, strict=True) if f is not None]
        found.focal_sigma = max(
            float(covariance.sigmas[0] / lens.params[0])
            for covariance, lens in zip(covariances, estimated, strict=True)
        )
    except SolveError:  # the images do not determine the lens
        pass
    if isinstance(flags, np.ndarray) and mapping.photographs.frames is None:
        lens = solution.cameras[int(np.flatnonzero(solution.registered)[0])]
        describe_center(mapping, lens, covariances[0] if covariances else None)
    found.focal_sigma = weigh_focal_prior(mapping, found.focal_sigma)
    is_finite = math.isfinite(found.focal_sigma)
    found.figures["focal_sigma_percent"] = 100 * found.focal_sigma if is_finite else None


def describe_doubt(found: Findings) -> str | None:
    """Describes what leaves an estimated lens open; None if it is known well enough."""
    if found.focal_sigma is None:
        return None
    if 2 * found.focal_sigma <= FOCAL_LIMITS[0] and found.motion is None:
        return None
    known = f"to {200 * found.focal_sigma:.1f} %" if found.focal_sigma < 1 else "not at all"
    if found.motion:
        return (
            f"{found.motion}; by the errors of the features alone the focal length is known "
            f"{known} (two standard deviations)"
        )
    return (
        f"these images determine the focal length {known} (two standard deviations); give "
        "--camera or --fov if you know the lens"
    )


def find_critical_motion(solution: Solution, pairs: Sequence[PairMatches]) -> str | None:
    """Finds why the motion or the scene leaves the lens open, as a sentence; None if nothing does.

    A straight flight without turns: a longer focal length with a longer path gives the same images.
    A turn about one point: no depth. A plane seen from one height: no depth differences, so that
    focal length and height trade off (Sturm, "Critical motion sequences for monocular
    self-calibration", CVPR 1997).

    Args:
        pairs: verified matches.
    """
    poses = solution.camera_from_world[solution.registered]
    turned = [pair.rotation_matches > _TURNED_ONLY * len(pair.matches) for pair in pairs]
    parallax = np.array([pair.parallax for pair in pairs])
    turns = measure_rotation_angles(
        np.array([p.second_from_first[:3, :3] for p in pairs]).reshape(-1, 3, 3)
    )
    # A rolling shutter or a step to the side is more than a rotation explains.
    beside = parallax < _TURN_SHARE * turns
    mostly = pairs and max(np.mean(turned), np.mean(beside)) > _MOSTLY
    if mostly and float(np.median(parallax)) < _LITTLE_PARALLAX:
        return (
            f"{TURNED}, so depths are hardly known and nothing can be seen from elsewhere: walk "
            "between the pictures, sideways to what you film"
        )
    extents = _measure_extents(find_centers(poses))
    middle = poses[len(poses) // 2, :3, :3]
    angles = measure_rotation_angles(poses[:, :3, :3] @ middle.T)
    still = float(np.percentile(angles, 90)) < _LITTLE_TURN
    if extents[1] < _STRAIGHT * extents[0] and still:
        return (
            "the camera moved straight on without turning, so the focal length and the length of "
            "the path along the view can replace each other: film a curve, or turn the camera "
            "while you move, some pictures upright and some on their side"
        )
    flat = _measure_extents(_drop_far_points(solution.points))
    if flat[2] < _FLAT * flat[1] and still:
        return (
            "everything seen lies in one plane and was seen from one direction, so focal length "
            "and distance can replace each other: add pictures tilted by 30 degrees or more, or "
            "with things of different height"
        )
    return None


def _drop_far_points(points: np.ndarray) -> np.ndarray:
    """Drops the farthest tenth of the points, as single outliers are no depth."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return points[distance <= np.percentile(distance, 90)] if len(points) else points


def _measure_extents(points: np.ndarray) -> np.ndarray:
    """Returns (3,) the singular values about the mean, largest first."""
    if len(points) < 3:
        return np.array([1.0, 0.0, 0.0])
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return np.maximum(values, 1e-300 * np.ones(3))


def compare_lens(mapping: Mapping) -> list[str]:
    """Compares the lens that was found with what the photographs say, one sentence each.

    Adds "lens_start" to the figures where the lens was named.
    """
    photographs, figures = mapping.photographs, mapping.found.figures
    lens, notes = mapping.solved.cameras[0], []
    groups = photographs.groups
    if len(groups) > 1 or (groups and len(groups[0].images) < len(photographs)):
        names = ", ".join(group.name or "images" for group in groups)
        return [f"the lens of each of these cameras was found: {names}"]
    if figures["lens"] == "estimated" and photographs.exif_focal_px is not None:
        notes += explain_contradiction(photographs.exif_focal_px, lens)
    if photographs.profile is not None:
        figures["lens_start"] = compare_with_profile(
            photographs.profile, lens, figures.get("readout"), mapping.options
        )
        notes.append(describe_start(figures["lens_start"]))
    return notes


def compare_with_profile(
    profile: LensProfile, lens: Camera, readout: dict[str, Any] | None, options: PosesOptions
) -> dict[str, Any]:
    """Compares a lens and readout time with a profile's, for "lens_start" of poses.json.

    Args:
        profile: the lens that the search started from.
        lens: the estimated lens.
        readout: of poses.json, with the estimated time; None: a global shutter.
        options: with the given readout time.

    Returns:
        Name and doubts of the profile, its focal length and field of view and the estimated ones,
        and the differences of focal length and readout time from the start in percent; None for
        what is not known.
    """
    start = profile.make_camera(lens.width, lens.height)
    found = given = None
    if readout is not None and "seconds" in readout:  # by the flow of a video
        found = readout["seconds"]
        given = None if profile.readout_ms is None else abs(profile.readout_ms) / 1000
    elif readout is not None:
        found, given = readout["estimated"], options.readout_time
    return {
        "name": profile.name,
        "doubts": list(profile.doubts),
        "focal_px": [float(start.params[0]), float(lens.params[0])],
        "focal_percent": 100 * float(lens.params[0] / start.params[0] - 1),
        "fov_degrees": [measure_field_of_view(start), measure_field_of_view(lens)],
        "readout_percent": 100 * (found / given - 1) if found and given else None,
    }


def describe_start(values: dict[str, Any]) -> str:
    """Describes the comparison in a sentence."""
    before, after = values["focal_px"]
    text = (
        f"the search for the lens started from {values['name']} of the database and found a focal "
        "length "
        f"of {after:.1f} px, {values['focal_percent']:+.1f} % of its {before:.1f} px"
    )
    if None not in values["fov_degrees"]:
        text += " (field of view {:.1f} -> {:.1f} degrees)".format(*values["fov_degrees"])
    if values["readout_percent"] is not None:
        text += f", its readout time {values['readout_percent']:+.0f} %"
    if values["doubts"]:
        text += f"; that calibration is doubtful: {', '.join(values['doubts'])}"
    return text


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
