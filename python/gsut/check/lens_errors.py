"""Finds small errors of a lens in matches that fit their poses, and names what was meant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gsut.check.epipolar import find_rays, rate_pairs
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.check.lens_fit import (
    LEAST_EFFECT,
    LensFit,
    count_sigmas,
    find_line_rays,
    find_principal_point,
    fit_lens,
    measure_line_errors,
)
from gsut.check.lenses import is_free_of_distortion, list_other_models
from gsut.lens import Camera

# A lens is wrong from this correction of focal length, principal point and distortion on, in
# thousandths of the diagonal: about a pixel of a small image.
_MOVES = np.array([2.0, 0.8, 2.0])
_SIGMAS = 4.0  # standard deviations from which a correction of the lens is not chance
_SURE = 4.0  # standard deviations of a principal point that is surely wrong
_MOST_MATCHES = 6000  # they determine a lens to a hundredth of a pixel
_SAME_FACTOR = 3.0  # standard deviations within which two corrections are one factor
_NEAR_HALF = 2.5  # standard deviations within which it may be half a pixel off
_NEARER = 0.25  # of its distance from the given one, likewise: many matches have small deviations


def find_lens_errors(evidence: Evidence, fit: LensFit) -> list[Finding]:
    """Names the errors of the lens that a fitted correction shows."""
    off = _is_off_throughout(evidence, fit)
    if not off.any():
        return []
    named = name_other_model(evidence, is_wrong=True) if off[1:].any() else []
    if named:
        return named
    if off[1:].any() and all(is_free_of_distortion(c) for c in evidence.scene.cameras):
        return [
            evidence.make_finding(
                "warning",
                "the photographs fit better a lens with distortion: they are not undistorted, as "
                "the lens says",
                "give the lens file of the original photographs, or calibrate (gsut calibrate)",
            )
        ]
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
    elif off[1] and not off[0]:
        advice = describe_crop(evidence, fit)
    elif off[:2].all() and is_of_another_size(evidence.scene.cameras[0], fit):
        advice = (
            f"multiply fx, fy, cx and cy by {np.exp(log_scale):.3g}: the lens is for images of "
            "another size"
        )
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


def is_off(fit: LensFit) -> np.ndarray:
    """Returns whether focal length, principal point and distortion (3,) are wrong."""
    sure = (fit.moves > _MOVES) & (fit.significance > _SIGMAS)
    return sure & (fit.effect > LEAST_EFFECT)


def _fit_halves(evidence: Evidence) -> Iterator[LensFit]:
    """Fits the lens to either half of the photographs.

    Neighbouring views see the same surfaces, whose features have errors in common that no spread
    shows; another part of the scene has others.
    """
    m, poses = evidence.matches, evidence.table.select_poses()
    for late in (False, True):
        rows = np.flatnonzero((2 * m.pair >= len(m.pairs)) == late)
        yield fit_lens(evidence.scene.cameras, m.select(rows), poses[:, rows])


def _is_off_throughout(evidence: Evidence, fit: LensFit) -> np.ndarray:
    """Returns the same (3,), where both halves of the photographs show it."""
    off = is_off(fit)
    for half in _fit_halves(evidence) if off.any() else ():
        along = half.values * fit.values
        same = np.array([along[0], along[1:3].sum(), along[3]]) > 0
        off &= same & (half.significance > _SIGMAS / np.sqrt(2))
    return off


def name_other_model(evidence: Evidence, is_wrong: bool = False) -> list[Finding]:
    """Names the lens that may have been meant, if pairs prefer it and it needs no correction.

    Coefficients in another order may move pixels in the corners alone, or nearly as an error of the
    poses does: no correction of focal length, principal point and distortion shows these.

    Args:
        evidence: of the photographs.
        is_wrong: the given lens is known to be wrong: another one need not be preferred by far.
    """
    cameras = evidence.scene.cameras
    given = _rate_pairs(evidence, cameras)
    used = evidence.select(slice(None, None, 1 + len(evidence.matches) // _MOST_MATCHES))
    best, fewest = None, given
    for lens in list_other_models(cameras):
        costs = _rate_pairs(evidence, lens.cameras)
        if costs.mean() >= fewest.mean() or not (is_wrong or _is_preferred(given - costs)):
            continue
        rays = find_rays(lens.cameras, used.matches)
        moved = evidence.focal * np.nanmedian(np.linalg.norm(rays - used.rays, axis=-1))
        fit = fit_lens(lens.cameras, used.matches, used.table.select_poses())
        if 1000 * moved / evidence.matches.diagonal > _MOVES[1] and not is_off(fit).any():
            best, fewest = lens, costs
    if best is None:
        return []
    what = f"the photographs fit better {best.name}"
    return [evidence.make_finding("warning", what, best.advice)]


def _rate_pairs(evidence: Evidence, cameras: Sequence[Camera]) -> np.ndarray:
    """Returns the cost of each pair (P,), from 0 to 1, through these lenses.

    By pixels: angles become smaller through a longer lens, and fit no better for it.
    """
    rays = find_line_rays(cameras, evidence.matches)
    errors = measure_line_errors(rays, evidence.table.select_poses())
    return rate_pairs(np.abs(errors), evidence.matches, 1.0)


def _is_preferred(gains: np.ndarray) -> bool:
    """Returns whether pairs gain beyond chance, in both halves of the path."""
    halves = np.array_split(gains, 2)
    return count_sigmas(gains) > _SIGMAS and all(
        count_sigmas(half) > _SIGMAS / np.sqrt(2) for half in halves
    )


def is_of_another_size(camera: Camera, fit: LensFit) -> bool:
    """Returns whether focal length and principal point of a lens are wrong by one factor."""
    center, scale = find_principal_point(camera), np.exp(fit.values[0])
    sigmas = np.hypot(fit.sigmas[1:3], scale * fit.sigmas[0] * center)
    return bool(np.all(np.abs(fit.values[1:3] - (scale - 1) * center) < _SAME_FACTOR * sigmas))


def describe_crop(evidence: Evidence, fit: LensFit) -> str:
    """Says which centre the lens has if the photographs were cropped after calibration."""
    x, y = find_principal_point(evidence.scene.cameras[0]) + fit.values[1:3]
    return (
        "if the photographs were cropped after calibration, keep fx and fy and subtract from cx "
        f"and cy what was cut off at the left and the top: cx = {x:.1f}, cy = {y:.1f}"
    )


def check_half_pixel(evidence: Evidence, fit: LensFit) -> list[Finding]:
    """Checks whether the principal point is half a pixel off, as where two conventions meet.

    Both halves of the photographs must show it.
    """
    given = np.zeros(2)
    far = fit.shift_distance(given)
    for half in (0.5, -0.5) if far > _SURE else ():
        near = fit.shift_distance(np.full(2, half))
        if near < max(_NEAR_HALF, _NEARER * far) and all(
            each.shift_distance(given) > _SURE / np.sqrt(2) for each in _fit_halves(evidence)
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
