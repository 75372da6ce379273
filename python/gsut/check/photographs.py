"""Checks whether the photographs fit their poses and lens, and if not, names what would fit."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from gsut.check.breaks import check_loops, check_scale, name_break
from gsut.check.chance import Judgement, is_another_view, judge_pairs, measure_turn_error
from gsut.check.drift import DRIFT_ADVICE, check_drift, fit_drift, name_drift, rate_drift
from gsut.check.epipolar import rate_matches, rate_pairs
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_errors import check_half_pixel, describe_crop, find_lens_errors, is_off
from gsut.check.lens_fit import LensFit, fit_lens
from gsut.check.lenses import OtherLens, list_other_lenses
from gsut.check.readings import list_readings
from gsut.check.shutter import check_timing
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
_FEWEST_FOR_LENS = 6  # pairs of photographs: fewer do not separate lens and poses
_BAD_PAIR = 0.85  # cost of a pair that contradicts its poses while others do not
_MANY_BAD = 0.2  # of the pairs: more than a few bad poses
_OF_PHOTOGRAPHS = "photographs are"  # in the names of readings that photographs explain as well
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
    rolling = check_timing(evidence, _POOR) if given > _POOR else []
    if rolling:
        return rolling
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
    if given > _POOR or found:
        found += _fit_crop(evidence, most) + _fit_drift(evidence, given, most)
    if given > _POOR and min([row[0] for row in found], default=1.0) > _WELL:
        found += _fit_others(evidence, most)
    if not found:
        return None
    best = min(row[0] for row in found)
    alike = [row for row in found if row[0] <= best + _LEAST_ALIKE]
    return _add_photographs(alike)


def _add_photographs(alike: list[tuple[float, str, str, str]]) -> tuple[float, str, str, str]:
    """Returns the first of several that fit alike, and beside it what the photographs may be.

    Along a straight path, pictures that are mirrored or upside down look like other camera axes.
    """
    value, name, advice, subject = alike[0]
    for _, other, edit, _ in alike[1:] if _OF_PHOTOGRAPHS not in name else ():
        if _OF_PHOTOGRAPHS in other:
            return value, f"{name}, and as well {other}", f"{advice}; or {edit}", subject
    return alike[0]


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
    for lens in lenses[:_FITTED_LENSES]:
        if _fit_near(sample, lens)[1] >= most + _SAMPLE_NOISE:
            continue
        fit, value = _fit_near(evidence, lens)
        if value < most and given - value > by_chance - _rate_fit(shuffled, fit, lens):
            found.append((value, f"nearly {lens.name}", lens.advice, "lens"))
    return found


def _fit_crop(evidence: Evidence, most: float) -> list[tuple[float, str, str, str]]:
    """Estimates the principal point of cropped photographs; returns it if it fits."""
    given = OtherLens("", "", list(evidence.scene.cameras))
    for used, noise in ((evidence.sample, _SAMPLE_NOISE), (evidence, 0.0)):
        fit, value = _fit_near(used, given)
        if value >= most + noise:
            return []
    off = is_off(fit)
    if not off[1] or off[0]:
        return []
    dx, dy = fit.values[1:3]
    name = f"cx {dx:+.1f} and cy {dy:+.1f} pixels: the photographs are a crop"
    return [(value, name, describe_crop(evidence, fit), "lens")]


def _fit_drift(evidence: Evidence, given: float, most: float) -> list[tuple[float, str, str, str]]:
    """Estimates a turn that grows along the path; returns it if poses without it fit."""
    for used, noise in ((evidence.sample, _SAMPLE_NOISE), (evidence, 0.0)):
        drift = fit_drift(used)
        value = rate_drift(used, drift)
        if value >= most + noise:
            return []
    shuffled = evidence.shuffled
    by_chance = shuffled.rate_poses(evidence.table.poses) - rate_drift(shuffled, drift)
    if not drift.is_sure or given - value <= by_chance:
        return []
    return [(value, name_drift(evidence, drift), DRIFT_ADVICE, "poses")]


def _fit_near(evidence: Evidence, lens: OtherLens) -> tuple[LensFit, float]:
    """Fits a correction of another lens; returns it with its cost."""
    fit = fit_lens(lens.cameras, evidence.matches, evidence.table.select_poses())
    return fit, _rate_fit(evidence, fit, lens)


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
    paired = sum(is_another_view(evidence, each) for each in judgement.contradicts)
    if 2 * paired > len(judgement.contradicts):
        cause = "in most of them another image's pose fits: check names, order and time stamps"
    elif 2 * len(judgement.confirmed) > len(judgement.contradicts):
        cause = (
            "no other reading fits, nor any other image's pose, though the photographs agree with "
            "each other: they are photographs of another scene, or the poses are another run's"
        )
    else:
        cause = (
            "no other reading fits: they may be photographs of another scene; or check rotations "
            "(degrees for radians, Euler angles, body instead of camera poses) and the pairing of "
            "names"
        )
    return evidence.make_finding(
        "error",
        f"the photographs contradict the poses: {_share(given)} of the matches fit them; in "
        f"{len(judgement.contradicts)} pairs other poses through the same lens fit better than "
        f"chance, whose turns differ by {np.median(off):.1f} degrees (median; "
        f"{evidence.describe()})",
        f"{cause}; or find poses with `gsut poses`",
    )


def _weigh_poor_matches(evidence: Evidence, given: float) -> Finding:
    """Judges whether poses are wrong, or photographs say little, where few matches fit."""
    judgement = judge_pairs(evidence)
    at_one_place = name_break(evidence, judgement)
    if at_one_place is not None:
        return at_one_place
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
    findings = _find_bad_pairs(evidence, costs) or check_timing(evidence, given)
    if not findings and len(costs) >= _FEWEST_FOR_LENS:
        fit = fit_lens(scene.cameras, evidence.matches, poses)
        lens = find_lens_errors(evidence, fit)
        findings += (lens and check_drift(evidence)) or lens
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
    """Finds a break of the path, loops that do not close, and single pairs that do not fit."""
    if not np.any(costs > _BAD_PAIR):
        return []
    judgement = judge_pairs(evidence)
    at_one_place = name_break(evidence, judgement)
    if at_one_place is not None:
        return [at_one_place]
    loops = check_loops(evidence, judgement)
    if loops:
        return [*loops, *check_drift(evidence), *check_scale(evidence)]
    return [_name_bad_pairs(evidence, judgement)] if judgement.confirmed else []


def _name_bad_pairs(evidence: Evidence, judgement: Judgement) -> Finding:
    """Names the images whose pairs contradict their poses while others do not."""
    against = [evidence.pairs[each.number] for each in judgement.confirmed]
    count = len(evidence.pairs)
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


def check_closely(evidence: Evidence) -> list[Finding]:
    """Checks for single wrong pairs, half a pixel and a drift of turns or of scale.

    Args:
        evidence: of a close look.
    """
    errors = measure_angular_errors(evidence.rays, evidence.table.select_poses())
    costs = rate_pairs(errors, evidence.matches, evidence.focal)
    found = _find_bad_pairs(evidence, costs) or check_drift(evidence)
    return found or [*check_half_pixel(evidence), *check_scale(evidence)]
