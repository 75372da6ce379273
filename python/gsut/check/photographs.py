"""Checks whether the photographs fit their poses and lens, and if not, names what would fit."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from gsut.check.breaks import check_scale, name_break
from gsut.check.chance import Judgement, judge_pairs, measure_turn_error
from gsut.check.epipolar import rate_matches, rate_pairs
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_fit import LensFit, fit_lens
from gsut.check.lenses import (
    OtherLens,
    is_free_of_distortion,
    list_other_lenses,
    without_distortion,
)
from gsut.check.readings import list_readings
from gsut.check.turns import (
    find_body_turn,
    find_clock_shift,
    rate_as_degrees,
)
from gsut.data import Scene, list_some
from gsut.sfm.points import measure_angular_errors, measure_pixels_per_radian

# Costs are between 0 and 1; good data lie at 0.1 to 0.5, wrong data at 0.7 to 1.
_POOR = 0.62  # cost from which something is wrong, whether or not another reading fits
_GAIN = 0.12  # of the cost, that another reading must save
_RATIO = 0.8  # of the given cost, that another reading may have at most
_SAMPLE_NOISE = 0.06  # of a cost, when it is measured on the sample of the matches
_WELL = 0.5  # cost of a reading that fits well enough to need no estimate beside it
_LEAST_ALIKE = 0.03  # readings whose costs differ by less are alike: the likelier one is named
# A lens is wrong from this correction of focal length, principal point and distortion on, in
# thousandths of the diagonal: about a pixel of a small image.
_MOVES = np.array([2.0, 0.8, 2.0])
_SIGMAS = 4.0  # standard deviations from which a correction of the lens is not chance
_FEWEST_FOR_LENS = 6  # pairs of photographs: fewer do not separate lens and poses
_SURE = 4.0  # standard deviations of a principal point that is surely wrong
_NEAR_HALF = 2.5  # standard deviations within which it may be half a pixel off
_BAD_PAIR = 0.85  # cost of a pair that contradicts its poses while others do not
_MANY_BAD = 0.2  # of the pairs: more than a few bad poses
_FITTED_LENSES = 4  # other lenses from which a fit is tried: a fit takes a second


def check_photographs(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Checks the matches of neighbouring photographs against the given lenses and poses.

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
    if evidence is None:
        what = "neighbouring images share too few features to check poses and lens by them"
        return [Finding("info", str(scene.path), what)]
    given = evidence.rate_poses(evidence.table.poses)
    other = _find_best_other(evidence, given)
    if other is not None:
        value, name, advice, subject = other
        return [
            evidence.make_finding(
                "error",
                f"the photographs contradict the {subject} ({evidence.describe()}: "
                f"{_share(given)} fit); {_share(value)} fit {name}",
                advice,
            )
        ]
    if given > _POOR:
        return [_weigh_poor_matches(evidence, given)]
    return _find_small_errors(evidence, given)


def _share(value: float) -> str:
    return f"{100 * max(0.0, 1 - value):.0f} %"


def _find_best_other(evidence: Evidence, given: float) -> tuple[float, str, str, str] | None:
    """Returns cost, name, advice and subject of the reading or lens that fits far better."""
    noise = 1 / np.sqrt(len(evidence.matches))
    given_by_chance = evidence.shuffled.rate_poses(evidence.table.poses)
    most = min(given - _GAIN - noise, _RATIO * given)
    found: list[tuple[float, str, str, str]] = []

    def judge(cost_of: Callable[[Evidence], float], name: str, advice: str, subject: str) -> None:
        if cost_of(evidence.sample) < most + _SAMPLE_NOISE:
            value = cost_of(evidence)
            if value < most and given - value > given_by_chance - cost_of(evidence.shuffled):
                found.append((value, name, advice, subject))

    for reading in list_readings(evidence.scene, evidence.table.poses):
        cost_of = functools.partial(Evidence.rate_poses, poses=reading.poses)
        judge(cost_of, f"these poses {reading.name}", reading.advice, "poses")
    for lens in list_other_lenses(evidence.scene.cameras, evidence.sample.rate_lenses):
        cost_of = functools.partial(Evidence.rate_lenses, cameras=lens.cameras)
        judge(cost_of, lens.name, lens.advice, "lens")
    if given > _POOR and min([row[0] for row in found], default=1.0) > _WELL:
        found += _fit_others(evidence, most)
    if not found:
        return None
    best = min(row[0] for row in found)
    return next(row for row in found if row[0] <= best + _LEAST_ALIKE)


def _fit_others(evidence: Evidence, most: float) -> list[tuple[float, str, str, str]]:
    """Estimates a turn of the camera on its body, and lenses near others; returns what fits."""
    found = []
    by_chance = evidence.shuffled.rate_poses(evidence.table.poses)
    given, shuffled = evidence.rate_poses(evidence.table.poses), evidence.shuffled
    turn = find_body_turn(evidence)
    value = evidence.rate_poses(evidence.table.poses @ turn)
    if value < most and given - value > by_chance - shuffled.rate_poses(
        evidence.table.poses @ turn
    ):
        rows = "; ".join(" ".join(f"{v:.4f}" for v in row) for row in turn[:3, :3])
        found.append((
            value, "these poses as a body's on which the camera is turned", "multiply each "
            f"camera-to-world matrix by the camera's place on the body (inverse of Kalibr's "
            f"T_cam_imu); its rotation is about [{rows}]", "poses",
        ))  # fmt: skip
    cameras, sample = evidence.scene.cameras, evidence.sample
    tried = list_other_lenses(cameras, sample.rate_lenses)
    lenses = sorted(tried, key=lambda lens: sample.rate_lenses(lens.cameras))
    poses = evidence.table.select_poses()
    for lens in lenses[:_FITTED_LENSES]:
        fit = fit_lens(lens.cameras, evidence.matches, poses)
        value = _rate_fit(evidence, fit, lens)
        if value < most and given - value > by_chance - _rate_fit(shuffled, fit, lens):
            found.append((value, f"nearly {lens.name}", lens.advice, "lens"))
    return found


def _rate_fit(evidence: Evidence, fit: LensFit, lens: OtherLens) -> float:
    errors = measure_angular_errors(
        fit.apply(lens.cameras, evidence.matches), evidence.table.select_poses()
    )
    focal = measure_pixels_per_radian(lens.cameras[0])
    return rate_matches(errors, evidence.matches, focal)


def _explain_contradiction(evidence: Evidence, given: float, judgement: Judgement) -> Finding:
    """Names what turns between photographs show of poses that no known reading explains."""
    contradiction = (
        f"the photographs contradict the poses ({evidence.describe()}: {_share(given)} fit)"
    )
    degrees = rate_as_degrees(evidence)
    if degrees is not None:
        return evidence.make_finding(
            "error",
            f"{contradiction}; {degrees:.0%} of the turns between neighbours fit these poses with "
            "their rotation vectors read in degrees",
            "convert rotation vectors to radians (np.radians) before matrices are made of them",
        )
    late = find_clock_shift(evidence)
    if late is not None:
        return evidence.make_finding(
            "error",
            f"{contradiction}; the turns between neighbours fit poses that are about {abs(late):g} "
            f"of a frame {'late' if late > 0 else 'early'}",
            "shift the poses' clock against the images' by as much, and interpolate anew",
        )
    off = [measure_turn_error(evidence, each) for each in judgement.contradicts]
    return evidence.make_finding(
        "error",
        f"the photographs contradict the poses: {_share(given)} of the matches fit them; in "
        f"{len(judgement.contradicts)} pairs other poses through the same lens fit better than "
        f"chance, whose turns differ by {np.median(off):.1f} degrees (median; "
        f"{evidence.describe()})",
        "no other reading fits: they may be photographs of another scene; or check rotations "
        "(degrees for radians, Euler angles, body instead of camera poses) and the pairing of "
        "names; or find poses with `gsut poses`",
    )


def _weigh_poor_matches(evidence: Evidence, given: float) -> Finding:
    """Judges whether poses are wrong, or photographs say little, where few matches fit."""
    judgement = judge_pairs(evidence)
    if judgement.is_contradiction:
        return _explain_contradiction(evidence, given, judgement)
    pairs = len(evidence.pairs)
    if judgement.confirmed:
        return _name_bad_pairs(evidence, judgement)
    if judgement.supports:
        return evidence.make_finding(
            "info",
            f"the photographs agree with poses and lens in {len(judgement.supports)} of {pairs} "
            f"pairs of neighbouring images, and show too little in the others "
            f"({evidence.describe()})",
        )
    if not judgement.contradicts:
        return evidence.make_finding(
            "warning",
            f"only {_share(given)} of the matched features fit the poses and the lens, and no "
            f"poses fit more of them than chance ({evidence.describe()})",
            "check lens model and focal length (gsut calibrate); blurred, repeated or moving "
            "things can be a reason, too",
        )
    return evidence.make_finding(
        "info",
        f"the photographs may contradict the poses: {len(judgement.contradicts)} of {pairs} pairs "
        f"of neighbouring images do, no pair supports them ({evidence.describe()})",
        "repeated things in few photographs can be the reason; look at the poses, or find others "
        "with `gsut poses`",
    )


def _find_small_errors(evidence: Evidence, given: float) -> list[Finding]:
    """Finds pairs that do not fit, and small errors of the lens, where most matches fit."""
    scene = evidence.scene
    poses = evidence.table.select_poses()
    costs = rate_pairs(
        measure_angular_errors(evidence.rays, poses), evidence.matches, evidence.focal
    )
    findings = _find_bad_pairs(evidence, costs)
    if len(costs) >= _FEWEST_FOR_LENS:
        fit = fit_lens(scene.cameras, evidence.matches, poses)
        findings += _find_lens_errors(evidence, fit)
    if not findings:
        findings += check_scale(evidence)
    if not findings:
        findings.append(
            evidence.make_finding(
                "info",
                f"the photographs agree with poses and lens ({evidence.describe()}, "
                f"{_share(given)} fit)",
            )
        )
    return findings


def _find_bad_pairs(evidence: Evidence, costs: np.ndarray) -> list[Finding]:
    if not np.any(costs > _BAD_PAIR):
        return []
    judgement = judge_pairs(evidence)
    return [_name_bad_pairs(evidence, judgement)] if judgement.confirmed else []


def _name_bad_pairs(evidence: Evidence, judgement: Judgement) -> Finding:
    """Names the images whose pairs contradict their poses while others do not."""
    against = [evidence.pairs[each.number] for each in judgement.confirmed]
    count = len(evidence.pairs)
    at_one_place = name_break(evidence, judgement)
    if at_one_place is not None:
        return at_one_place
    supported = {
        view
        for each in judgement.supports
        for view in (evidence.pairs[each.number].first, evidence.pairs[each.number].second)
    }
    accused = sorted({view for p in against for view in (p.first, p.second)} - supported)
    names = [evidence.scene.views[i].name for i in accused or sorted({p.second for p in against})]
    return evidence.make_finding(
        "error" if len(against) > max(1, _MANY_BAD * count) else "warning",
        f"{len(against)} of {count} pairs of neighbouring images contradict their poses: "
        f"{list_some(names)}",
        "they may have the poses of other images: check names, order and time stamps",
    )


def _name_distortion(evidence: Evidence) -> Finding | None:
    """Names undistorted photographs, or a lens without distortion, if the distortion is wrong."""
    cameras = evidence.scene.cameras
    plain = [without_distortion(camera) for camera in cameras]
    known = [camera for camera in plain if camera is not None]
    if len(known) == len(cameras):
        if _is_off(fit_lens(known, evidence.matches, evidence.table.select_poses())).any():
            return None
        return evidence.make_finding(
            "warning",
            "the photographs fit better a lens without distortion: they have been undistorted",
            "give the lens that the undistorted photographs have (pinhole, no k), or the originals",
        )
    if not all(is_free_of_distortion(camera) for camera in cameras):
        return None
    return evidence.make_finding(
        "warning",
        "the photographs fit better a lens with distortion: they are not undistorted, as the lens "
        "says",
        "give the lens file of the original photographs, or calibrate (gsut calibrate)",
    )


def check_closely(evidence: Evidence) -> list[Finding]:
    """Checks for single wrong pairs, half a pixel and a drift of scale.

    Args:
        evidence: of a close look.
    """
    errors = measure_angular_errors(evidence.rays, evidence.table.select_poses())
    costs = rate_pairs(errors, evidence.matches, evidence.focal)
    bad = _find_bad_pairs(evidence, costs)
    return bad or [*_check_half_pixel(evidence), *check_scale(evidence)]


def _check_half_pixel(evidence: Evidence) -> list[Finding]:
    """Checks whether the principal point is half a pixel off, as where two conventions meet."""
    fit = fit_lens(evidence.scene.cameras, evidence.matches, evidence.table.select_poses())
    for half in (0.5, -0.5):
        if (
            fit.shift_distance(np.zeros(2)) > _SURE
            and fit.shift_distance(np.full(2, half)) < _NEAR_HALF
        ):
            dx, dy = fit.values[1:3]
            return [
                evidence.make_finding(
                    "warning",
                    f"the photographs fit better cx {dx:+.2f} +- {fit.sigmas[1]:.2f} and cy "
                    f"{dy:+.2f} +- {fit.sigmas[2]:.2f} pixels",
                    _correct_half_pixel(half),
                )
            ]
    return []


def _correct_half_pixel(half: float) -> str:
    sign = "add 0.5 to" if half > 0 else "subtract 0.5 from"
    return (
        f"{sign} cx and cy: here the centre of the top-left pixel is (0.5, 0.5), in OpenCV, "
        "Kalibr and mrcal files (0, 0)"
    )


def _is_off(fit: LensFit) -> np.ndarray:
    """Returns whether focal length, principal point and distortion (3,) are wrong."""
    return (fit.moves > _MOVES) & (fit.significance > _SIGMAS)


def _is_off_throughout(evidence: Evidence, fit: LensFit) -> np.ndarray:
    """Returns the same (3,), where both halves of the photographs show it.

    Neighbouring views see the same surfaces, whose features have errors in common that no spread
    shows; another part of the scene has others.
    """
    off, m, poses = _is_off(fit), evidence.matches, evidence.table.select_poses()
    for late in (False, True) if off.any() else ():
        rows = np.flatnonzero((2 * m.pair >= len(m.pairs)) == late)
        half = fit_lens(evidence.scene.cameras, m.select(rows), poses[:, rows])
        along = half.values * fit.values
        same = np.array([along[0], along[1:3].sum(), along[3]]) > 0
        off &= same & (half.significance > _SIGMAS / np.sqrt(2))
    return off


def _find_lens_errors(evidence: Evidence, fit: LensFit) -> list[Finding]:
    off = _is_off_throughout(evidence, fit)
    if not off.any():
        return []
    if off[2] and not off[1]:
        named = _name_distortion(evidence)
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
        advice = _correct_half_pixel(dx)
    elif off[2] and not off[1]:
        advice = "check the lens model and its coefficients, or calibrate: gsut calibrate"
    else:
        advice = (
            "check that the lens is for images of this size and crop, or refine it: "
            "gsut train --refine-poses --refine-lens"
        )
    return [
        evidence.make_finding(
            "warning", f"the photographs fit better {' and '.join(words)}", advice
        )
    ]
