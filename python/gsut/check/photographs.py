"""Checks whether the photographs fit their poses and lens, and if not, names what would fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection

import numpy as np

from gsut.check.agreement import Agreement, find_agreement, find_far_views
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.data import Scene, list_some
from gsut.judge import HYPOTHESES, KEPT, Hypothesis, Variant, find_best_variants, prefer
from gsut.judge.checks import FEW_AGREE

_LEAST_GAIN = 0.05  # nats a match that a hypothesis must gain: less are errors that images share
_PLAIN = 1.2  # nats a match: half of the matches that did not fit do so, a match that fits has five
_ADVICE = (
    "check names, order and time stamps, that these are the photographs of this path, and the "
    "lens; or find poses of all images at once (`gsut poses`)"
)


@dataclasses.dataclass(frozen=True)
class Explanation:
    """A hypothesis that explains the photographs better than what is given.

    Args:
        hypothesis, variant: what is supposed.
        score, gain: nats a match, means over the groups of images.
        is_sure: it shows beyond doubt that what is given is wrong.
    """

    hypothesis: Hypothesis
    variant: Variant
    score: float
    gain: float
    is_sure: bool

    @property
    def is_large(self) -> bool:
        """Returns whether it explains twice as much as what is given."""
        return self.gain > self.score / 2


def check_photographs(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Checks the matches of neighbouring photographs against the given lenses and poses.

    Features that match lie on each other's epipolar lines, if poses and lenses are right. Where
    they do not, what the poses and the lenses may have been meant to be is tried, and the
    hypothesis that fits is named with the edit that mends the data.

    Args:
        scene: with poses of all views.
        evidence: from `gather_evidence`.

    Returns:
        Findings: "error" where the photographs contradict poses or lens, "warning" where they
        differ a little, "info" where they agree or say nothing.
    """
    if evidence is None:
        what = "neighbouring images share too few features to check poses and lens by them"
        return [*name_far_views(scene), Finding("info", str(scene.path), what)]
    shares = evidence.find_shares(evidence.given)
    share = float(np.mean(shares))
    agreement = find_agreement(evidence) if shares.min() < FEW_AGREE else None
    found = find_explanation(evidence)
    fitting = [pair for pair, fits in zip(evidence.pairs, shares > FEW_AGREE, strict=True) if fits]
    far = name_far_views(scene, {view for pair in fitting for view in (pair.first, pair.second)})
    wrong = agreement is not None and agreement.is_contradiction
    if found is not None and (found.is_large or not wrong):
        return [_name_explanation(evidence, share, found)]
    return far or _describe_agreement(evidence, share, agreement)


def find_explanation(evidence: Evidence) -> Explanation | None:
    """Finds the hypothesis that explains the photographs best; of those alike the likelier.

    None where no hypothesis is sure. Where one is, another that explains more is named.
    """
    given, found = evidence.given, []
    current, structure = evidence.score(given), evidence.make_structure(given)
    can_be_gross = evidence.best_score - float(np.mean(current)) > _PLAIN
    for row, variant in find_best_variants(HYPOTHESES, given, evidence.sample.score, can_be_gross):
        scores = evidence.score(variant.data)
        touched = ~np.isclose(scores, current)
        if not touched.any() or np.median(evidence.find_shares(variant.data)) <= FEW_AGREE:
            continue
        gains = scores[touched] - current[touched]
        gain, everywhere = gains.mean(), bool(np.all(gains > 0))
        # It is better plainly, as all images say so, or else beyond chance.
        better = everywhere and min(gain, scores[touched].mean() / 2) > _PLAIN
        if not better and gain > (_PLAIN if row.is_gross else _LEAST_GAIN):
            rival = evidence.make_structure(variant.data, row.free)
            better = prefer(structure, rival, evidence.matches).is_rival
        if better:
            is_sure = everywhere or not row.is_everywhere or gain > _PLAIN
            means = float(np.mean(scores)), float(np.mean(scores - current))
            found.append(Explanation(row, variant, *means, is_sure))
    if not any(each.is_sure for each in found):
        return None
    most = max(each.gain for each in found)
    return next(each for each in found if each.gain >= KEPT * most)  # those explain the same


def _name_explanation(evidence: Evidence, share: float, found: Explanation) -> Finding:
    row, variant = found.hypothesis, found.variant
    sentence, cure = row.sentence.format(variant.words), row.cure.format(variant.edit)
    fits = np.mean(evidence.find_shares(variant.data))
    severity, what = "warning", f"the photographs fit better {sentence}"
    if share < FEW_AGREE or found.is_large:
        severity = "error"
        what = (
            f"the photographs contradict the {row.subject} ({evidence.describe()}: {share:.0%} "
            f"fit); {fits:.0%} fit {sentence}"
        )
    return Finding(severity, str(evidence.scene.path), what, cure, row.subject)


def name_far_views(scene: Scene, supported: Collection[int] = ()) -> list[Finding]:
    """Names cameras far from all others, but for views that photographs support."""
    views, distance, size = find_far_views(scene)
    views = [view for view in views if view not in supported]
    if not views:
        return []
    stands = "stands" if len(views) == 1 else "stand"
    return [
        Finding(
            "warning",
            str(scene.path),
            f"{list_some([scene.views[v].name for v in views])} {stands} farther from all other "
            f"cameras ({distance:.3g} units) than these are apart ({size:.3g})",
            "check the pose, or leave the image out: it makes the scene's extent and its steps too "
            "large",
            "poses",
        )
    ]


def _describe_agreement(
    evidence: Evidence, share: float, agreement: Agreement | None
) -> list[Finding]:
    """Says whether photographs and poses agree, where no hypothesis explains more."""
    fits, where = f"{evidence.describe()}, {share:.0%} fit", str(evidence.scene.path)
    if agreement is None:
        return [Finding("info", where, f"the photographs agree with poses and lens ({fits})")]
    names = [view.name for view in evidence.scene.views]
    disagree, count = "poses and photographs do not agree", len(agreement.contradicts)
    if agreement.is_contradiction:
        worst = sorted({v for pair in agreement.contradicts for v in pair.views})
        what = (
            f"{disagree}: {count} of {len(evidence.pairs)} pairs of neighbouring images contradict "
            f"their poses ({fits}): {list_some([names[v] for v in worst])}"
        )
        return [Finding("error", where, what, _ADVICE, "poses")]
    if agreement.apart:
        views, severity = agreement.apart[0], "warning"
        what = "contradict all neighbouring images that they were compared with, which agree"
        if len(views) > 1:
            severity = "error"
            what = "agree with each other, and with no others: their poses are in another world "
            what += "frame or scale"
        what = f"{disagree}: {list_some([names[v] for v in views])} {what}"
        return [Finding(severity, where, what, _ADVICE, "poses")]
    if not agreement.supports and share < FEW_AGREE:
        what = f"{disagree}, and other poses through this lens hardly fit them better ({fits})"
        return [Finding("info" if count else "warning", where, what, _ADVICE)]
    return [Finding("info", where, f"the photographs agree with poses and lens ({fits})")]
