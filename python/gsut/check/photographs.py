"""Do the photographs fit the poses and the lens that they come with; if not, which would fit?"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from gsut import _core
from gsut.check.geometry import (
    TOLERANCE,
    Matches,
    PoseTable,
    cost,
    gather,
    pair_costs,
    pose_table,
    rays_of,
)
from gsut.check.lenses import LensFit, fit_lens, other_lenses
from gsut.check.matches import ImagePair, neighbouring_matches
from gsut.check.readings import readings
from gsut.data import Finding, Scene, some_names
from gsut.sfm import angular_errors, pixels_per_radian

_FEWEST_PAIRS, _FEWEST_MATCHES = 2, 60
# Costs are between 0 and 1: good data of ours lie at 0.1 to 0.5, wrong ones at 0.7 to 1.
_POOR = 0.62  # from here on something is wrong, whether or not another reading fits
_GAIN, _RATIO = 0.12, 0.8  # another reading is named if its cost is so much less, and in ratio
_LEAST_ALIKE = 0.03  # readings whose costs differ by less are alike: the likelier one is named
_MATCHED = 0.5  # of the matches must fit one relative pose a pair, for there to be evidence
# A lens is off from so many thousandths of the diagonal (focal length, principal point, distortion)
# and standard deviations, by so many pairs or more.
_MOVES, _SIGMAS, _FEWEST_FOR_LENS = np.array([2.0, 0.8, 2.0]), 5.0, 6
_BAD_PAIR = 0.85  # cost of a pair that contradicts its poses, among others that do not
_MANY_BAD = 0.2  # of the pairs: more than a few bad poses
_FITTED_LENSES = 4  # other lenses from which a fit is tried
_FEWEST_TURNS = 4  # pairs from which a turn of the camera on its body is estimated


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What the photographs have to say: matches, and the given poses and lenses."""

    scene: Scene
    pairs: list[ImagePair]
    matches: Matches
    table: PoseTable
    rays: np.ndarray

    @functools.cached_property
    def focal(self) -> float:
        return pixels_per_radian(self.scene.cameras[0])

    def cost_of_poses(self, poses: np.ndarray) -> float:
        errors = angular_errors(self.rays, self.table.of_matches(poses))
        return cost(errors, self.matches, self.focal)

    def words(self) -> str:
        return f"{len(self.matches):,} matches in {len(self.pairs)} pairs of neighbouring images"


def gather_evidence(scene: Scene, pairs: list[ImagePair] | None = None) -> Evidence | None:
    """Matches of some neighbouring photographs; None where they share too few features.

    Args:
        scene: in the dataset's coordinates; some of its images are decoded.
        pairs: from `neighbouring_matches`, where they are known already.
    """
    pairs = neighbouring_matches(scene) if pairs is None else pairs
    if len(pairs) < _FEWEST_PAIRS or sum(p.pixels.shape[1] for p in pairs) < _FEWEST_MATCHES:
        return None
    matches = gather(scene, pairs)
    rays = rays_of(scene.cameras, matches)
    return Evidence(scene, pairs, matches, pose_table(scene, matches), rays)


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
    found = []
    for reading in readings(evidence.scene, evidence.table.poses):
        value = evidence.cost_of_poses(reading.poses)
        if value < most:
            text = f"these poses {reading.name}"
            found.append((value, text, reading.advice, "poses"))
    poses = evidence.table.of_matches()
    for lens in other_lenses(evidence.scene.cameras):
        errors = angular_errors(rays_of(lens.cameras, evidence.matches), poses)
        value = cost(errors, evidence.matches, pixels_per_radian(lens.cameras[0]))
        if value < most:
            found.append((value, lens.name, lens.advice, "lens"))
    if not found and given > _POOR:
        found = _fitted(evidence, most)
    if not found:
        return None
    best = min(row[0] for row in found)
    return next(row for row in found if row[0] <= best + _LEAST_ALIKE)


def _fitted(evidence: Evidence, most: float) -> list[tuple[float, str, str, str]]:
    """What fits once something is estimated: the lens near another one, or a turn of the camera."""
    found = []
    matches, poses = evidence.matches, evidence.table.of_matches()
    turn = _turn_of_body(evidence)
    if turn is not None:
        value = evidence.cost_of_poses(evidence.table.poses @ turn)
        if value < most:
            rows = "; ".join(" ".join(f"{v:.4f}" for v in row) for row in turn[:3, :3])
            found.append((
                value, "these poses as a body's on which the camera is turned", "multiply each "
                f"camera-to-world matrix by the camera's place on the body (inverse of Kalibr's "
                f"T_cam_imu); its rotation is about [{rows}]", "poses",
            ))  # fmt: skip
    tried = []
    for lens in other_lenses(evidence.scene.cameras):
        errors = angular_errors(rays_of(lens.cameras, matches), poses)
        tried.append((cost(errors, matches, pixels_per_radian(lens.cameras[0])), lens))
    for _, lens in sorted(tried, key=lambda row: row[0])[:_FITTED_LENSES]:
        rays = fit_lens(lens.cameras, matches, poses).apply(lens.cameras, matches)
        value = cost(angular_errors(rays, poses), matches, pixels_per_radian(lens.cameras[0]))
        if value < most:
            found.append((value, f"nearly {lens.name}", lens.advice, "lens"))
    return found


def _turn_of_body(evidence: Evidence) -> np.ndarray | None:
    """(4, 4) body_from_camera, a rotation: turns of cameras against turns of the given poses.

    Rotation vectors of both differ by the rotation sought (hand-eye calibration; Kabsch).
    """
    given, found = [], []
    for number, turn, share in _free_turns(evidence):
        if share < _MATCHED:
            continue
        pair = evidence.pairs[number]
        one, two = (
            evidence.scene.views[i].camera_from_world[:3, :3] for i in (pair.first, pair.second)
        )
        given.append(rotation_vector(two @ one.T))
        found.append(rotation_vector(turn))
    if len(given) < _FEWEST_TURNS:
        return None
    left, _, right = np.linalg.svd(np.array(given).T @ np.array(found))
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    turn = np.eye(4)
    turn[:3, :3] = left @ flip @ right
    return turn


def _unexplained(evidence: Evidence, given: float) -> Finding:
    """Nothing that is known fits: is it the poses, or do the photographs say nothing?"""
    where = str(evidence.scene.path)
    share, turn = _free_fit(evidence)
    if share < _MATCHED:
        return Finding(
            "warning",
            where,
            f"only {_share(given)} of the matched features fit the poses and the lens, and they "
            f"hardly fit any ({share:.0%} with free poses; {evidence.words()})",
            "check lens model and focal length (gsut calibrate); blurred, repeated or moving "
            "things can be a reason, too",
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


def _free_turns(evidence: Evidence) -> list[tuple[int, np.ndarray, float]]:
    """Of each pair that one relative pose explains: its number, the rotation second_from_first
    and the share of the matches; through the given lenses, without the given poses."""
    scene, result = evidence.scene, []
    for number, pair in enumerate(evidence.pairs):
        cameras = [
            scene.cameras[scene.views[index].camera_index] for index in (pair.first, pair.second)
        ]
        if not all(camera.is_central for camera in cameras):
            continue
        images = [
            _core.ImageBearings(camera, np.ascontiguousarray(pixels))
            for camera, pixels in zip(cameras, pair.pixels, strict=True)
        ]
        count = pair.pixels.shape[1]
        rows = np.repeat(np.arange(count, dtype=np.int32)[:, None], 2, axis=1)
        rows = rows[images[0].valid & images[1].valid]
        max_error = TOLERANCE * evidence.matches.diagonal / 1000
        ((kept, found, *_),) = _core.verify_pairs(images, np.array([[0, 1]]), [rows], max_error, 0)
        result.append((number, found[:3, :3], np.count_nonzero(kept) / count))
    return result


def _free_fit(evidence: Evidence) -> tuple[float, float]:
    """Share of the matches that free relative poses explain; median degrees between the turns of
    these and of the given ones."""
    turns = []
    free = _free_turns(evidence)
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
    costs = pair_costs(angular_errors(evidence.rays, poses), evidence.matches, evidence.focal)
    findings = []
    free = {number: share for number, _, share in _free_turns(evidence) if share > _MATCHED}
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
        findings += _lens_findings(fit, where)
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


def _lens_findings(fit: LensFit, where: str) -> list[Finding]:
    off = (fit.moves > _MOVES) & (fit.significance > _SIGMAS)
    if not off.any():
        return []
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
        sign = "add 0.5 to" if dx > 0 else "subtract 0.5 from"
        advice = (
            f"{sign} cx and cy: here the centre of the top-left pixel is (0.5, 0.5), in OpenCV, "
            "Kalibr and mrcal files (0, 0)"
        )
    elif off[2] and not off[1]:
        advice = "check the lens model and its coefficients, or calibrate: gsut calibrate"
    else:
        advice = (
            "check that the lens is for images of this size and crop, or refine it: "
            "gsut train --refine-poses --refine-lens"
        )
    return [Finding("warning", where, f"the photographs fit better {' and '.join(words)}", advice)]


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """(3,) axis times angle of a rotation (3, 3)."""
    r = rotation
    sine = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / 2
    length = np.linalg.norm(sine)
    angle = np.arctan2(length, (np.trace(r) - 1) / 2)
    return sine * (angle / length if length > 1e-12 else 1.0)
