"""Lets what a film's camera recorded of its turns take part in the adjustment of its poses."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from gsut._core import SolveError
from gsut.gaussians import find_rotation_vectors
from gsut.judge import KEPT
from gsut.sfm.gyroscope.calibration import BIAS_SIGMA, TurnCalibration, calibrate_turns
from gsut.sfm.mapping import Mapping
from gsut.sfm.solution import (
    Adjustment,
    ReadoutMotion,
    Solution,
    StatedTurns,
    compare_solutions,
)

# Share of the pairs of pictures that must agree with it, and of the poses that must stay near it.
_AGREE = 0.8
# Standard deviation of the scale of a camera's gyroscope, which its maker calibrates.
SCALE_SIGMA = 0.005
# Seconds of a readout: of phones and action cameras.
USUAL_READOUT = 0.015


def use_gyroscope(mapping: Mapping) -> Mapping:
    """Adjusts poses and lens near the turns that the camera recorded, where these fit the poses.

    Returns:
        The run with solution, `turns`, and "gyroscope" of the figures where there is a record.
    """
    found = _calibrate_records(mapping)
    if found is None:
        return mapping
    figures: dict[str, Any] = {
        "explained": {source: each.explained for source, each in found.items()}, "used": None,
    }  # fmt: skip
    source = _choose_record(found)
    held = None if source is None else hold_near_record(mapping, found[source])
    if source is None or held is None:
        reason = "the pictures contradict it" if source else (
            "it does not explain how the poses turn: the picture was stabilised in the camera, the "
            "film was cut, or the camera hardly turned"
        )  # fmt: skip
        mapping.log.note(f"the gyroscope's record is not used: {reason}")
        # Poses that were held near it are adjusted without.
        bare = None if mapping.turns is None else _adjust(mapping, None)
        mapping = mapping.replace(solution=bare or mapping.solved, turns=None)
        return mapping.add_findings({"gyroscope": figures})
    mapping, calibration = held
    if source == "gyroscope":
        mapping = _turn_ups(mapping, calibration.camera_from_sensor)
    figures |= _describe(calibration, source)
    name = "gyroscope" if source == "gyroscope" else "record of its orientation"
    mapping.log.note(
        f"the camera's {name} took part in the adjustment: it explains "
        f"{100 * calibration.explained:.1f} % of the turns, to "
        f"{math.degrees(calibration.sigma):.3f} degrees each, and is "
        f"{1000 * calibration.offset:.0f} ms late"
    )
    return mapping.add_findings({"gyroscope": figures})


def _turn_ups(mapping: Mapping, camera_from_sensor: np.ndarray) -> Mapping:
    """Turns what an accelerometer beside the gyroscope took for up into the camera's axes."""
    photographs = mapping.photographs
    ups = {name: tuple(camera_from_sensor @ up) for name, up in photographs.sensor_ups.items()}
    return mapping.replace(photographs=dataclasses.replace(photographs, ups=photographs.ups | ups))


def _choose_record(found: dict[str, TurnCalibration]) -> str | None:
    """Chooses the source of the record that explains the turns best; None: none fits the poses."""
    fitting = [source for source, each in found.items() if _is_fitting(each)]
    return max(fitting, key=lambda each: found[each].explained, default=None)


def calibrate_best(mapping: Mapping) -> TurnCalibration | None:
    """Calibrates the record that explains the poses' turns best; None: none fits them."""
    found = _calibrate_records(mapping) or {}
    source = _choose_record(found)
    return None if source is None else found[source]


def hold_near_record(
    mapping: Mapping, calibration: TurnCalibration
) -> tuple[Mapping, TurnCalibration] | None:
    """Adjusts near a record that fits; None where the pictures contradict it.

    The record weighs by what the poses without it left of the turns, the errors of both: what poses
    leave that follow it is smaller than its own error.

    Returns:
        The run with solution and turns, and the calibration by its poses.
    """
    held = _adjust(mapping, _state_turns(mapping, mapping.solved, calibration))
    again = held and calibrate_poses(mapping, held, calibration.rates)
    if not held or not again or not _is_fitting(again):
        return None
    again = dataclasses.replace(again, sigma=calibration.sigma)
    return mapping.replace(solution=held, turns=_state_turns(mapping, held, again)), again


def sharpen_rates(
    mapping: Mapping, velocities: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Joins the velocities of a film's images with the turns that its gyroscope recorded.

    Pictures hardly distinguish a turn from a shift; once the turn is measured, the shift is known
    better. Orientations of stabilised pictures say nothing of a turn within a frame.

    Args:
        velocities: (N, 6) and their covariances (N, 6, 6), see `estimate_rates`.

    Returns:
        The same, by both.
    """
    found = (_calibrate_records(mapping) or {}).get("gyroscope")
    if found is None or not _is_fitting(found):
        return velocities
    rates, spread = (each.copy() for each in velocities)
    times = list_times(mapping)
    known = np.isfinite(rates).all(axis=1) & np.isfinite(times)
    recorded = np.full((len(rates), 3), np.nan)
    about = times[known, None] + USUAL_READOUT / 2 * np.array([-1, 1])
    recorded[known] = find_rotation_vectors(found.find_turns(about)) / USUAL_READOUT
    known &= np.isfinite(recorded).all(axis=1)
    # The bias is as the sensor has it; what its noise adds is far below it.
    axes = found.camera_from_sensor
    error = axes @ np.diag(found.sigmas[:3] ** 2) @ axes.T
    turned = spread[known][:, :, 3:]
    gain = turned @ np.linalg.inv(turned[:, 3:] + error)
    off = recorded[known] - rates[known, 3:]
    rates[known] += np.einsum("nij,nj->ni", gain, off)
    spread[known] -= gain @ turned.transpose(0, 2, 1)
    return rates, spread


def _calibrate_records(mapping: Mapping) -> dict[str, TurnCalibration] | None:
    """Calibrates each record by the poses; None where there is none, or poses are of a rig."""
    records = mapping.photographs.turns
    if not records or mapping.photographs.frames is not None:
        return None
    each = {
        source: calibrate_poses(mapping, mapping.solved, rates) for source, rates in records.items()
    }
    return {source: found for source, found in each.items() if found is not None}


def _is_fitting(calibration: TurnCalibration) -> bool:
    agreeing = float(np.mean(calibration.used))
    return calibration.explained >= KEPT and agreeing >= _AGREE


def list_times(mapping: Mapping) -> np.ndarray:
    """Lists (N,) seconds at which the images were taken; NaN: not known."""
    times = mapping.photographs.times
    return np.array([times.get(name, math.nan) for name in mapping.photographs.names])


def list_pairs(mapping: Mapping, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Lists (P, 2) images that follow each other in time, and when each was taken."""
    times = list_times(mapping)
    known = np.flatnonzero(solution.registered & np.isfinite(times))
    order = known[np.argsort(times[known], kind="stable")]
    pairs = np.stack([order[:-1], order[1:]], axis=1)
    return pairs, times[pairs]


def calibrate_poses(
    mapping: Mapping, solution: Solution, rates: np.ndarray
) -> TurnCalibration | None:
    """Calibrates a record by the poses of a solution; see `calibrate_turns`."""
    pairs, times = list_pairs(mapping, solution)
    first, second = solution.camera_from_world[pairs.T, :3, :3]
    return calibrate_turns(rates, times, second @ first.transpose(0, 2, 1))


def _state_turns(mapping: Mapping, solution: Solution, found: TurnCalibration) -> StatedTurns:
    """States the recorded turns; where poses disagree with a record that fits, they are wrong."""
    pairs, _ = list_pairs(mapping, solution)
    known = np.isfinite(found.rotations).all(axis=(1, 2))
    sigmas = np.array([*[BIAS_SIGMA] * 3, SCALE_SIGMA, *[1.0] * 4])
    return StatedTurns(
        pairs[known], found.rotations[known], found.by_unknowns[known],
        found.sigma, sigmas,
    )  # fmt: skip


def _free_scale(turns: StatedTurns) -> StatedTurns:
    """Frees the scale of turns, which speaks of the focal length; see `find_focal_by_turns`."""
    sigmas = turns.calibration_sigma.copy()
    sigmas[3] = 1.0
    return dataclasses.replace(turns, calibration_sigma=sigmas)


def _adjust(mapping: Mapping, turns: StatedTurns | None) -> Solution | None:
    """Adjusts near recorded turns, if any; None if that fails or the pictures contradict them.

    A pose whose turn is known is held by half as many points.
    """
    solution = mapping.solved
    adjustment = Adjustment(
        mapping.lens_free, lens_settled=True, extend=True,
        motion=ReadoutMotion.hold(solution), turns=turns and _free_scale(turns),
        min_inliers=Adjustment.min_inliers // 2,
    )  # fmt: skip
    try:
        held = mapping.adjust(adjustment, stage="mapping")
    except SolveError:
        return None
    if held.num_registered < _AGREE * solution.num_registered:
        return None
    bare = keep_images(solution, held.registered)
    free = 0 if turns is None else 3 * len(turns.images)
    contradicted = compare_solutions(held, bare, mapping.features, mapping.pairs, free).is_rival
    return None if contradicted else dataclasses.replace(held, restarts=solution.restarts)


def keep_images(solution: Solution, chosen: np.ndarray) -> Solution:
    """Keeps the poses and observations of chosen images (N,) bool."""
    own = chosen[solution.observations[:, 1]]
    return dataclasses.replace(
        solution, registered=solution.registered & chosen, observations=solution.observations[own],
        pixels=solution.pixels[own], residuals=solution.residuals[own],
    )  # fmt: skip


def _describe(found: TurnCalibration, source: str) -> dict[str, Any]:
    """Describes a calibration for poses.json; "scale_sigma" is that of the sensor, too."""
    return {
        "used": source,
        "pairs": int(np.count_nonzero(found.used)),
        "explained_by_used": found.explained,
        "offset_seconds": found.offset,
        "offset_sigma_seconds": float(found.sigmas[7]),
        "bias_rad_per_s": found.bias.tolist(),
        "scale": found.scale,
        "scale_sigma": math.hypot(float(found.sigmas[3]), SCALE_SIGMA),
        "camera_from_sensor": found.camera_from_sensor.tolist(),
        "sigma_degrees": math.degrees(found.sigma),
    }
