"""Searches other readings of the poses, and other lenses, that fit the photographs far better."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut.check.chance import are_beyond_repeated
from gsut.check.drift import DRIFT_ADVICE, fit_drift, name_drift, rate_drift
from gsut.check.epipolar import rate_pairs
from gsut.check.evidence import Evidence
from gsut.check.lens_errors import describe_crop, is_off
from gsut.check.lens_fit import LensFit, count_sigmas, fit_lens
from gsut.check.lenses import OtherLens, list_other_lenses
from gsut.check.readings import list_readings
from gsut.check.turns import find_body_turn, refine_turn
from gsut.lens import Camera
from gsut.sfm.points import measure_angular_errors, measure_pixels_per_radian

# Costs are between 0 and 1; good data lie at 0.1 to 0.5, wrong data at 0.7 to 1.
POOR = 0.62  # cost from which something is wrong, whether or not another reading fits
_GAIN = 0.12  # of the cost, that another reading must save; and an estimate beside a reading
_RATIO = 0.8  # of the given cost, that another reading may have at most
_SAMPLE_NOISE = 0.06  # of a cost, when it is measured on the sample of the matches
# Cost below which a reading explains most of the matches: it needs no estimate beside it, and no
# proof that all pairs prefer it.
_WELL = 0.5
_LEAST_ALIKE = 0.03  # readings whose costs differ by less are alike, unless pairs prefer one
_SIGMAS = 4.0  # standard deviations from which pairs prefer a reading
_OF_PHOTOGRAPHS = "photographs are"  # in the names of readings that photographs explain as well
_FITTED_LENSES = 4  # other lenses from which a fit is tried: a fit takes a second


@dataclasses.dataclass(frozen=True, eq=False)
class Other:
    """A reading of the poses, or a lens, that fits far better than the given one.

    Args:
        costs: (P,) of each pair, see `Evidence.rate_pairs`.
        name: completes "the photographs fit ...".
        advice: the edit that mends the data.
        subject: "poses" or "lens".
        poses, cameras: other than the given ones; neither where they were estimated from matches.
    """

    costs: np.ndarray
    name: str
    advice: str
    subject: str
    poses: np.ndarray | None = None
    cameras: list[Camera] | None = None

    @property
    def value(self) -> float:
        """Returns the cost of the matches."""
        return float(np.mean(self.costs))

    @property
    def is_listed(self) -> bool:
        """Returns whether it is one of the readings and lenses that are always tried."""
        return self.poses is not None or self.cameras is not None


def find_best_other(evidence: Evidence, given: float) -> Other | None:
    """Finds the reading or lens that fits far better; among those that fit alike the likelier.

    One that leaves most of the matches unexplained counts only if the pairs prefer it beyond
    chance: a few pairs of things that look alike agree with each other on what is wrong.
    """
    noise = 1 / np.sqrt(len(evidence.matches))
    given_by_chance = evidence.shuffled.rate_poses(evidence.table.poses)
    most = min(given - _GAIN - noise, _RATIO * given)
    found: list[Other] = []

    def judge(name: str, advice: str, **changed: Any) -> None:
        if np.mean(evidence.sample.rate_pairs(**changed)) < most + _SAMPLE_NOISE:
            costs = evidence.rate_pairs(**changed)
            value = float(np.mean(costs))
            by_chance = given_by_chance - float(np.mean(evidence.shuffled.rate_pairs(**changed)))
            if value < most and given - value > by_chance:
                subject = "poses" if "poses" in changed else "lens"
                found.append(Other(costs, name, advice, subject, **changed))

    for reading in list_readings(evidence.scene, evidence.table.poses):
        judge(f"these poses {reading.name}", reading.advice, poses=reading.poses)
    for lens in list_other_lenses(evidence.scene.cameras, evidence.sample.rate_lenses):
        judge(lens.name, lens.advice, cameras=lens.cameras)
    best = min(found, key=lambda other: other.value, default=None)
    if given > POOR or found:
        found += _fit_crop(evidence, most) + _fit_drift(evidence, given, most)
    if given > POOR and (best is None or not _is_enough(evidence.sample, best)):
        found += _fit_others(evidence, most if best is None else best.value - _GAIN)
    if not found:
        return None
    chosen = _choose_likeliest(evidence, found)
    return chosen if is_proved(chosen, evidence.rate_pairs()) else None


def is_proved(other: Other, given: np.ndarray) -> bool:
    """Returns whether most matches fit a reading, or the pairs prefer it beyond chance.

    Args:
        other: the reading.
        given: (P,) costs of the pairs with what is given.
    """
    return other.value < _WELL or count_sigmas(given - other.costs) > _SIGMAS


def is_sure(other: Other, given: np.ndarray) -> bool:
    """Returns whether a proved reading is more than what repeated things explain.

    A pattern moves what a pair shows as other poses would, or numbers that are fitted, and not as
    another lens of the list does.

    Args:
        other: the reading.
        given: (P,) costs of the pairs with what is given.
    """
    saved = given - other.costs
    return other.cameras is not None or are_beyond_repeated(
        int(np.count_nonzero(saved > 0)), int(np.count_nonzero(saved < 0))
    )


def _is_enough(sample: Evidence, other: Other) -> bool:
    """Returns whether a reading needs no estimate beside it: a small turn does not mend it."""
    if other.value > _WELL:
        return False
    if other.poses is None:
        return True
    turned = sample.replace_poses(other.poses)
    near = turned.rate_poses(other.poses @ refine_turn(turned, np.eye(4), Evidence.rate_poses))
    return turned.rate_poses(other.poses) - near < _GAIN


def _choose_likeliest(evidence: Evidence, found: Sequence[Other]) -> Other:
    """Returns the first that fits alike the best, and beside it what the photographs may be.

    Along a straight path, pictures that are mirrored or upside down look like other camera axes.
    """
    best = min(other.value for other in found)
    alike = [other for other in found if other.value <= best + _LEAST_ALIKE]
    listed = [other for other in alike if other.is_listed]
    if listed:
        fewest = _rate_pairs(evidence, min(listed, key=lambda other: other.value))
        alike = [
            other for other in alike
            if not other.is_listed
            or count_sigmas(_rate_pairs(evidence, other) - fewest) <= _SIGMAS
        ]  # fmt: skip
    alike = _leave_out_corrected(evidence, alike)
    first = alike[0]
    for other in alike[1:] if _OF_PHOTOGRAPHS not in first.name else ():
        if _OF_PHOTOGRAPHS in other.name:
            return dataclasses.replace(
                first, name=f"{first.name}, and as well {other.name}",
                advice=f"{first.advice}; or {other.advice}",
            )  # fmt: skip
    return first


def _leave_out_corrected(evidence: Evidence, alike: list[Other]) -> list[Other]:
    """Leaves out lenses that a correction would still mend, where others need none."""
    if sum(other.cameras is not None for other in alike) < 2:
        return alike
    poses, right = evidence.table.select_poses(), []
    for other in alike:
        if other.cameras is not None:
            fit = fit_lens(other.cameras, evidence.matches, poses)
            right += [] if is_off(fit).any() else [other]
    return [other for other in alike if not right or other.cameras is None or other in right]


def _rate_pairs(evidence: Evidence, other: Other) -> np.ndarray:
    return evidence.rate_pairs(other.poses, other.cameras)


def _fit_others(evidence: Evidence, most: float) -> list[Other]:
    """Estimates a turn of the camera on its body, and lenses near others; returns what fits."""
    found = []
    poses, shuffled, sample = evidence.table.poses, evidence.shuffled, evidence.sample
    gain = evidence.rate_poses(poses) - shuffled.rate_poses(poses)
    turn = find_body_turn(evidence)
    costs = evidence.rate_pairs(poses @ turn)
    value = float(np.mean(costs))
    if value < most and gain > value - shuffled.rate_poses(poses @ turn):
        rows = "; ".join(" ".join(f"{v:.4f}" for v in row) for row in turn[:3, :3])
        found.append(Other(
            costs, "these poses as a body's on which the camera is turned", "multiply each "
            f"camera-to-world matrix by the camera's place on the body (inverse of Kalibr's "
            f"T_cam_imu); its rotation is about [{rows}]", "poses",
        ))  # fmt: skip
    tried = list_other_lenses(evidence.scene.cameras, sample.rate_lenses)
    lenses = sorted(tried, key=lambda lens: sample.rate_lenses(lens.cameras))
    for lens in lenses[:_FITTED_LENSES]:
        if np.mean(_fit_near(sample, lens)[1]) >= most + _SAMPLE_NOISE:
            continue
        fit, costs = _fit_near(evidence, lens)
        value = float(np.mean(costs))
        if value < most and gain > value - float(np.mean(_rate_fit(shuffled, fit, lens))):
            found.append(Other(costs, f"nearly {lens.name}", lens.advice, "lens"))
    return found


def _fit_crop(evidence: Evidence, most: float) -> list[Other]:
    """Estimates the principal point of cropped photographs; returns it if it fits."""
    given = OtherLens("", "", list(evidence.scene.cameras))
    for used, noise in ((evidence.sample, _SAMPLE_NOISE), (evidence, 0.0)):
        fit, costs = _fit_near(used, given)
        if np.mean(costs) >= most + noise:
            return []
    off = is_off(fit)
    if not off[1] or off[0]:
        return []
    dx, dy = fit.values[1:3]
    name = f"cx {dx:+.1f} and cy {dy:+.1f} pixels: the photographs are a crop"
    return [Other(costs, name, describe_crop(evidence, fit), "lens")]


def _fit_drift(evidence: Evidence, given: float, most: float) -> list[Other]:
    """Estimates a turn that grows along the path; returns it if poses without it fit."""
    for used, noise in ((evidence.sample, _SAMPLE_NOISE), (evidence, 0.0)):
        drift = fit_drift(used)
        costs = rate_drift(used, drift)
        if np.mean(costs) >= most + noise:
            return []
    shuffled = evidence.shuffled
    by_chance = shuffled.rate_poses(evidence.table.poses) - np.mean(rate_drift(shuffled, drift))
    if not drift.is_sure or given - np.mean(costs) <= by_chance:
        return []
    return [Other(costs, name_drift(evidence, drift), DRIFT_ADVICE, "poses")]


def _fit_near(evidence: Evidence, lens: OtherLens) -> tuple[LensFit, np.ndarray]:
    """Fits a correction of another lens; returns it with the cost of each pair."""
    fit = fit_lens(lens.cameras, evidence.matches, evidence.table.select_poses())
    return fit, _rate_fit(evidence, fit, lens)


def _rate_fit(evidence: Evidence, fit: LensFit, lens: OtherLens) -> np.ndarray:
    errors = measure_angular_errors(
        fit.apply(lens.cameras, evidence.matches), evidence.table.select_poses()
    )
    focal = measure_pixels_per_radian(lens.cameras[0])
    return rate_pairs(errors, evidence.matches, focal)
