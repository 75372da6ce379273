"""Checks whether the photographs fit their poses and lens, and if not, names what would fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from gsut.check.breaks import check_loops, check_scale, name_break
from gsut.check.chance import Judgement, is_another_view, judge_pairs, measure_turn_error
from gsut.check.drift import check_drift
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_errors import check_half_pixel, find_lens_errors, name_other_model
from gsut.check.lens_fit import fit_lens
from gsut.check.others import POOR, find_best_other, is_sure
from gsut.check.shutter import check_timing
from gsut.check.turns import (
    find_clock_shift,
    rate_as_degrees,
)
from gsut.data import Scene, list_some

_FEWEST_FOR_LENS = 6  # pairs of photographs: fewer do not separate lens and poses
_BAD_PAIR = 0.85  # cost of a pair that contradicts its poses while others do not
_MANY_BAD = 0.2  # of the pairs: more than a few bad poses


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
    rolling = check_timing(evidence, POOR) if given > POOR else []
    if rolling:
        return rolling
    other = find_best_other(evidence, given)
    if other is not None:
        contradiction = evidence.make_finding(
            "error" if is_sure(other, evidence.rate_pairs()) else "warning",
            f"the photographs contradict the {other.subject} ({evidence.describe()}: "
            f"{_share(given)} fit); {_share(other.value)} fit {other.name}",
            other.advice,
        )
        return _set_subject(other.subject, [contradiction])
    if given > POOR:
        return _weigh_poor_matches(evidence, given)
    return _find_small_errors(evidence, given)


def _set_subject(subject: str, findings: Iterable[Finding]) -> list[Finding]:
    return [dataclasses.replace(finding, subject=subject) for finding in findings]


def _share(value: float) -> str:
    return f"{100 * max(0.0, 1 - value):.0f} %"


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


def _weigh_poor_matches(evidence: Evidence, given: float) -> list[Finding]:
    """Judges whether poses are wrong, or photographs say little, where few matches fit."""
    judgement = judge_pairs(evidence)
    at_one_place = name_break(evidence, judgement)
    if at_one_place is not None:
        return _set_subject("poses", [at_one_place])
    if judgement.is_contradiction:
        return _set_subject("poses", [_explain_contradiction(evidence, given, judgement)])
    if judgement.confirmed:
        return _set_subject("poses", [_name_bad_pairs(evidence, judgement)])
    return [_describe_poor_matches(evidence, given, judgement)]


def _describe_poor_matches(evidence: Evidence, given: float, judgement: Judgement) -> Finding:
    """Says what few matches that fit may mean, where nothing is proved."""
    pairs = len(evidence.pairs)
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
    costs = evidence.rate_pairs()
    findings = _find_bad_pairs(evidence, costs) or check_timing(evidence, given)
    if not findings and len(costs) >= _FEWEST_FOR_LENS:
        findings += _set_subject("lens", name_other_model(evidence))
    if not findings and len(costs) >= _FEWEST_FOR_LENS:
        fit = fit_lens(scene.cameras, evidence.matches, poses)
        lens = _set_subject("lens", find_lens_errors(evidence, fit))
        findings += (lens and _set_subject("poses", check_drift(evidence))) or lens
    if not findings:
        findings += _set_subject("poses", check_scale(evidence))
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
        return _set_subject("poses", [at_one_place])
    loops = check_loops(evidence, judgement)
    if loops:
        return _set_subject("poses", [*loops, *check_drift(evidence), *check_scale(evidence)])
    bad = [_name_bad_pairs(evidence, judgement)] if judgement.confirmed else []
    return _set_subject("poses", bad)


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
    """Checks for single wrong pairs, misread coefficients, half a pixel and drifts.

    Args:
        evidence: of a close look.
    """
    found = _find_bad_pairs(evidence, evidence.rate_pairs())
    if not found and len(evidence.pairs) >= _FEWEST_FOR_LENS:
        found = _set_subject("lens", name_other_model(evidence))
    found = found or _set_subject("poses", check_drift(evidence))
    if found:
        return found
    fit = fit_lens(evidence.scene.cameras, evidence.matches, evidence.table.select_poses())
    half = _set_subject("lens", check_half_pixel(evidence, fit))
    return [*half, *_set_subject("poses", check_scale(evidence))]
