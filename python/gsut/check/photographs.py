"""Do the photographs fit the poses and the lens that they come with; if not, which would fit?"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from gsut.check.epipolar import cost, pair_costs
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lenses import LensFit, fit_lens, is_free_of_distortion, other_lenses, undistorted
from gsut.check.readings import list_readings
from gsut.check.turns import MATCHED, clock_of_turns, read_in_degrees, rotation_vector, turn_of_body
from gsut.data import Scene, some_names
from gsut.sfm.core import measure_angular_errors, measure_pixels_per_radian

# Costs are between 0 and 1: good data of ours lie at 0.1 to 0.5, wrong ones at 0.7 to 1.
_POOR = 0.62  # from here on something is wrong, whether or not another reading fits
_GAIN, _RATIO = 0.12, 0.8  # another reading is named if its cost is so much less, and in ratio
_SAMPLE_NOISE = 0.06  # of a cost by the sample of the matches
_WELL = 0.5  # what fits so needs no estimate beside it
_LEAST_ALIKE = 0.03  # readings whose costs differ by less are alike: the likelier one is named
# A lens is off from so many thousandths of the diagonal (focal length, principal point, distortion)
# and standard deviations, by so many pairs or more.
_MOVES, _SIGMAS, _FEWEST_FOR_LENS = np.array([2.0, 0.8, 2.0]), 5.0, 6
# A principal point is half a pixel off where that is far from none and near a half, in standard
# deviations.
_SURE, _NEAR_HALF = 4.0, 2.5
_BAD_PAIR = 0.85  # cost of a pair that contradicts its poses, among others that do not
_MANY_BAD = 0.2  # of the pairs: more than a few bad poses
_FITTED_LENSES = 4  # other lenses from which a fit is tried


def check_photographs(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Matches of neighbouring photographs through the given lenses and poses.

    Features that match lie on each other's epipolar lines, if poses and lenses are right. Where
    they do not, other readings of the poses and other lenses are tried, and the one that fits is
    named with the edit that mends the data.

    Args:
        scene: with poses of all views.
        evidence: from `gather_evidence`.

    Returns:
        Findings: "error" where the photographs contradict poses or lens, "warning" where they
        differ a little, "info" where they agree or say nothing.
    """
    where = str(scene.path)
    if evidence is None:
        what = "neighbouring images share too few features to check poses and lens by them"
        return [Finding("info", where, what)]
    given = evidence.cost_of_poses(evidence.table.poses)
    other = _best_other(evidence, given)
    if other is not None:
        value, name, advice, subject = other
        return [
            Finding(
                "error",
                where,
                f"the photographs contradict the {subject} ({evidence.words()}: "
                f"{_share(given)} fit); {_share(value)} fit {name}",
                advice,
            )
        ]
    if given > _POOR:
        return [_unexplained(evidence, given)]
    return _small_errors(evidence, given)


def _share(value: float) -> str:
    return f"{100 * max(0.0, 1 - value):.0f} %"


def _best_other(evidence: Evidence, given: float) -> tuple[float, str, str, str] | None:
    """Cost, name, advice and subject of the reading or lens that fits better by far."""
    noise = 1 / np.sqrt(len(evidence.matches))
    most = min(given - _GAIN - noise, _RATIO * given)
    found: list[tuple[float, str, str, str]] = []

    def judge(cost_of: Callable[[Evidence], float], name: str, advice: str, subject: str) -> None:
        if cost_of(evidence.sample) < most + _SAMPLE_NOISE:
            value = cost_of(evidence)
            if value < most:
                found.append((value, name, advice, subject))

    for reading in list_readings(evidence.scene, evidence.table.poses):
        cost_of = functools.partial(Evidence.cost_of_poses, poses=reading.poses)
        judge(cost_of, f"these poses {reading.name}", reading.advice, "poses")
    for lens in other_lenses(evidence.scene.cameras, evidence.sample.cost_of_lenses):
        cost_of = functools.partial(Evidence.cost_of_lenses, cameras=lens.cameras)
        judge(cost_of, lens.name, lens.advice, "lens")
    if given > _POOR and min([row[0] for row in found], default=1.0) > _WELL:
        found += _fitted(evidence, most)
    if not found:
        return None
    best = min(row[0] for row in found)
    return next(row for row in found if row[0] <= best + _LEAST_ALIKE)


def _fitted(evidence: Evidence, most: float) -> list[tuple[float, str, str, str]]:
    """What fits once something is estimated: the lens near another one, or a turn of the camera."""
    found = []
    turn = turn_of_body(evidence)
    value = evidence.cost_of_poses(evidence.table.poses @ turn)
    if value < most:
        rows = "; ".join(" ".join(f"{v:.4f}" for v in row) for row in turn[:3, :3])
        found.append((
            value, "these poses as a body's on which the camera is turned", "multiply each "
            f"camera-to-world matrix by the camera's place on the body (inverse of Kalibr's "
            f"T_cam_imu); its rotation is about [{rows}]", "poses",
        ))  # fmt: skip
    cameras, sample = evidence.scene.cameras, evidence.sample
    tried = other_lenses(cameras, sample.cost_of_lenses)
    lenses = sorted(tried, key=lambda lens: sample.cost_of_lenses(lens.cameras))
    matches, poses = evidence.matches, evidence.table.of_matches()
    for lens in lenses[:_FITTED_LENSES]:
        rays = fit_lens(lens.cameras, matches, poses).apply(lens.cameras, matches)
        value = cost(
            measure_angular_errors(rays, poses), matches, measure_pixels_per_radian(lens.cameras[0])
        )
        if value < most:
            found.append((value, f"nearly {lens.name}", lens.advice, "lens"))
    return found


def _unexplained(evidence: Evidence, given: float) -> Finding:
    """Nothing that is known fits: is it the poses, or do the photographs say nothing?"""
    where = str(evidence.scene.path)
    share, turn = _free_fit(evidence)
    if share < MATCHED:
        return Finding(
            "warning",
            where,
            f"only {_share(given)} of the matched features fit the poses and the lens, and they "
            f"hardly fit any ({share:.0%} with free poses; {evidence.words()})",
            "check lens model and focal length (gsut calibrate); blurred, repeated or moving "
            "things can be a reason, too",
        )
    contradiction = (
        f"the photographs contradict the poses ({evidence.words()}: {_share(given)} fit)"
    )
    degrees = read_in_degrees(evidence)
    if degrees is not None:
        return Finding(
            "error",
            where,
            f"{contradiction}; {degrees:.0%} of the turns between neighbours fit these poses with "
            "their rotation vectors read in degrees",
            "convert rotation vectors to radians (np.radians) before matrices are made of them",
        )
    late = clock_of_turns(evidence)
    if late is not None:
        return Finding(
            "error",
            where,
            f"{contradiction}; the turns between neighbours fit poses that are about {abs(late):g} "
            f"of a frame {'late' if late > 0 else 'early'}",
            "shift the poses' clock against the images' by as much, and interpolate anew",
        )
    return Finding(
        "error",
        where,
        f"the photographs contradict the poses: {_share(given)} of the matches fit them, "
        f"{share:.0%} fit free poses through the same lens, whose turns between neighbours differ "
        f"by {turn:.1f} degrees (median; {evidence.words()})",
        "no other reading fits: check rotations (degrees for radians, Euler angles, body instead "
        "of camera poses) and the pairing of names; or find poses with `gsut poses`",
    )


def _free_fit(evidence: Evidence) -> tuple[float, float]:
    """Share of the matches that free relative poses explain; median degrees between the turns of
    these and of the given ones."""
    turns = []
    free = evidence.free_turns
    for number, turn, _ in free:
        pair = evidence.pairs[number]
        given = [
            evidence.scene.views[i].camera_from_world[:3, :3] for i in (pair.first, pair.second)
        ]
        turns.append(np.degrees(np.linalg.norm(rotation_vector(turn @ given[0] @ given[1].T))))
    if not free:
        return 0.0, float("nan")
    return float(np.mean([share for *_, share in free])), float(np.median(turns))


def _small_errors(evidence: Evidence, given: float) -> list[Finding]:
    """Poses and lens fit on the whole: pairs that do not, and how far the lens is off."""
    scene, where = evidence.scene, str(evidence.scene.path)
    poses = evidence.table.of_matches()
    costs = pair_costs(
        measure_angular_errors(evidence.rays, poses), evidence.matches, evidence.focal
    )
    findings = []
    free = {number: share for number, _, share in evidence.free_turns if share > MATCHED}
    bad = [i for i in np.flatnonzero(costs > _BAD_PAIR) if i in free]
    if bad:
        names = [scene.views[evidence.pairs[i].second].name for i in bad]
        findings.append(
            Finding(
                "error" if len(bad) > max(1, _MANY_BAD * len(costs)) else "warning",
                where,
                f"{len(bad)} of {len(costs)} pairs of neighbouring images contradict their poses: "
                f"{some_names(names)}",
                "they may have the poses of other images: check names, order and time stamps",
            )
        )
    if len(costs) >= _FEWEST_FOR_LENS:
        fit = fit_lens(scene.cameras, evidence.matches, poses)
        findings += _lens_findings(evidence, fit, where)
    if not findings:
        findings.append(
            Finding(
                "info",
                where,
                f"the photographs agree with poses and lens ({evidence.words()}, "
                f"{_share(given)} fit)",
            )
        )
    return findings


def _distortion_named(evidence: Evidence, where: str) -> Finding | None:
    """Where the distortion is off: undistorted photographs, or a lens that leaves it out."""
    cameras = evidence.scene.cameras
    plain = [undistorted(camera) for camera in cameras]
    known = [camera for camera in plain if camera is not None]
    if len(known) == len(cameras):
        if _off(fit_lens(known, evidence.matches, evidence.table.of_matches())).any():
            return None
        return Finding(
            "warning",
            where,
            "the photographs fit better a lens without distortion: they have been undistorted",
            "give the lens that the undistorted photographs have (pinhole, no k), or the originals",
        )
    if not all(is_free_of_distortion(camera) for camera in cameras):
        return None
    return Finding(
        "warning",
        where,
        "the photographs fit better a lens with distortion: they are not undistorted, as the lens "
        "says",
        "give the lens file of the original photographs, or calibrate (gsut calibrate)",
    )


def check_half_pixel(evidence: Evidence, where: str) -> list[Finding]:
    """Whether the principal point is half a pixel off, as where two conventions meet.

    Args:
        evidence: of a close look.
        where: for the finding.
    """
    fit = fit_lens(evidence.scene.cameras, evidence.matches, evidence.table.of_matches())
    for half in (0.5, -0.5):
        if (
            fit.shift_distance(np.zeros(2)) > _SURE
            and fit.shift_distance(np.full(2, half)) < _NEAR_HALF
        ):
            dx, dy = fit.values[1:3]
            return [
                Finding(
                    "warning",
                    where,
                    f"the photographs fit better cx {dx:+.2f} +- {fit.sigmas[1]:.2f} and cy "
                    f"{dy:+.2f} +- {fit.sigmas[2]:.2f} pixels",
                    _half_pixel(half),
                )
            ]
    return []


def _half_pixel(half: float) -> str:
    sign = "add 0.5 to" if half > 0 else "subtract 0.5 from"
    return (
        f"{sign} cx and cy: here the centre of the top-left pixel is (0.5, 0.5), in OpenCV, "
        "Kalibr and mrcal files (0, 0)"
    )


def _off(fit: LensFit) -> np.ndarray:
    """(3,) bool: focal length, principal point, distortion."""
    return (fit.moves > _MOVES) & (fit.significance > _SIGMAS)


def _lens_findings(evidence: Evidence, fit: LensFit, where: str) -> list[Finding]:
    off = _off(fit)
    if not off.any():
        return []
    if off[2] and not off[1]:
        named = _distortion_named(evidence, where)
        if named is not None:
            return [named]
    log_scale, dx, dy, radial = fit.values
    words = []
    if off[0]:
        words.append(f"a focal length times {np.exp(log_scale):.3f} +- {fit.sigmas[0]:.3f}")
    if off[1]:
        words.append(
            f"cx {dx:+.2f} +- {fit.sigmas[1]:.2f} and cy {dy:+.2f} +- {fit.sigmas[2]:.2f} pixels"
        )
    if off[2]:
        words.append(f"a distortion of {1000 * radial / 2:+.1f} thousandths of the diagonal more")
    half = off[1] and np.abs(np.abs([dx, dy]) - 0.5).max() < max(0.2, 3 * fit.sigmas[1:3].max())
    if half and dx * dy > 0 and not off[0]:
        advice = _half_pixel(dx)
    elif off[2] and not off[1]:
        advice = "check the lens model and its coefficients, or calibrate: gsut calibrate"
    else:
        advice = (
            "check that the lens is for images of this size and crop, or refine it: "
            "gsut train --refine-poses --refine-lens"
        )
    return [Finding("warning", where, f"the photographs fit better {' and '.join(words)}", advice)]
