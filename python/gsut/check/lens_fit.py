"""Fits a correction of the lens to matches, and says how well they determine it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np

from gsut.check.epipolar import Matches, find_rays
from gsut.lens import Camera
from gsut.significance import convert_to_normal

_ITERATIONS = 8  # of the reweighted fit, which settles within half of them
_SETTLED = 0.05  # of the differences' steps: a fit that moves less has settled
_NORMAL = 1.4826  # standard deviation of a normal law over the median of its absolute values
# Standard deviation with which a lens is known beforehand, of its focal length, diagonal and
# distortion: what a straight path does not determine stays as it is given.
_KNOWN = 0.25
_TINY = 1e-12  # keeps quotients finite
_STEP_PX = 0.01  # of differences between rays: small beside a pixel, large beside rounding
_FEWEST = 40  # matches to which numbers are fitted
# Error that what is fitted takes away, in units of the spread that it leaves, below which errors
# that neighbouring features have in common may explain it.
LEAST_EFFECT = 0.3
# Of the four numbers of a lens, see `LensFit.values`.
_STEPS = np.array([1e-3, 0.1, 0.1, 1e-3])  # of the differences that give derivatives
_MOST = np.array([0.2, 50.0, 50.0, 0.1])  # change in one iteration


@dataclasses.dataclass(frozen=True)
class LensFit:
    """A correction of the lens, fitted to the matches with the poses held.

    Args:
        values: (4 + N,) logarithm of the factor on the focal lengths; pixels to add to cx and cy;
            factor minus 1 on the distance from the centre, at half the image's diagonal; and what
            was fitted beside the lens.
        covariance: of the values, by what each view changes when it is left out.
        effect: of the values on the errors, see `fit_numbers`.
        diagonal: of the image, pixels.
        freedom: views less the values: degrees of freedom of the covariance.
    """

    values: np.ndarray
    covariance: np.ndarray
    effect: float
    diagonal: float
    freedom: int

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations (4 + N,) of the values."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def shift_distance(self, shift: np.ndarray) -> float:
        """Returns the Mahalanobis distance of the correction of cx and cy from a shift (2,).

        As of a normal law, like `significance`.
        """
        off = self.values[1:3] - shift
        ratio = np.sqrt(off @ np.linalg.pinv(self.covariance[1:3, 1:3]) @ off)
        return float(convert_to_normal(ratio, self.freedom))

    def apply(self, cameras: Sequence[Camera], matches: Matches) -> np.ndarray:
        """Returns the rays (2, M, 3) of the matches through the corrected lenses."""
        moved = _move_pixels(cameras, matches, matches.pixels, self.values)
        return find_rays(cameras, matches, moved)

    @property
    def moves(self) -> np.ndarray:
        """The motion of pixels by focal length, principal point and distortion.

        (3,) in thousandths of the diagonal; the focal length a quarter of the diagonal from the
        centre, the distortion half of it.
        """
        scale, dx, dy, radial = np.abs(self.values[:4])
        return 1000 * np.array([scale / 4, np.hypot(dx, dy) / self.diagonal, radial / 2])

    @property
    def significance(self) -> np.ndarray:
        """The same corrections (3,), in standard deviations of a normal law that are as rare."""
        ratio = np.abs(self.values) / np.maximum(self.sigmas, 1e-12)
        ratio = np.array([ratio[0], max(ratio[1], ratio[2]), ratio[3]])
        return convert_to_normal(ratio, self.freedom)


def count_sigmas(differences: np.ndarray) -> float:
    """Returns how far the mean of paired differences lies from zero, as of a normal law."""
    sigma = float(np.std(differences, ddof=1)) / np.sqrt(len(differences))
    ratio = float(np.mean(differences)) / max(sigma, _TINY)
    return float(np.sign(ratio) * convert_to_normal(np.abs(ratio), len(differences) - 1))


def fit_lens(cameras: Sequence[Camera], matches: Matches, poses: np.ndarray) -> LensFit:
    """Fits one scale, shift and radial term for all lenses to the epipolar errors, poses held.

    A lens scaled about its principal point sees a pixel where it saw one nearer or farther, so
    pixels are moved instead of making lenses.

    Args:
        cameras: the lenses.
        matches: their pixels.
        poses: (2, M, 4, 4) world_from_camera.
    """
    return fit_lens_beside(cameras, matches, lambda _: poses, np.zeros((3, 0)))


def fit_lens_beside(
    cameras: Sequence[Camera],
    matches: Matches,
    find_poses: Callable[[np.ndarray], np.ndarray],
    others: np.ndarray,
) -> LensFit:
    """Fits the lens as `fit_lens` does, and beside it other numbers, on which the poses depend.

    Args:
        cameras: the lenses.
        matches: their pixels.
        find_poses: returns poses (2, M, 4, 4) world_from_camera by the other numbers (N,).
        others: (3, N) of these, as `fit_numbers` takes them: steps, known and most.
    """
    known = np.array([1.0, matches.diagonal, matches.diagonal, 1.0]) * _KNOWN
    all_numbers = np.concatenate([[_STEPS, known, _MOST], others], axis=1)
    views = matches.pairs[matches.pair]

    @functools.lru_cache(maxsize=1 + 2 * len(_STEPS))  # the lenses of one iteration
    def find_rays_of_lens(x: bytes) -> np.ndarray:
        return find_line_rays(cameras, matches, np.frombuffer(x))

    def find_errors(x: np.ndarray) -> np.ndarray:
        return measure_line_errors(find_rays_of_lens(x[:4].tobytes()), find_poses(x[4:]))

    x, covariance, effect = fit_numbers(find_errors, views, *all_numbers)
    freedom = max(1, len(np.unique(views)) - len(x))
    return LensFit(x, covariance, effect, matches.diagonal, freedom)


def fit_numbers(
    find_errors: Callable[[np.ndarray], np.ndarray],
    views: np.ndarray,
    steps: np.ndarray,
    known: np.ndarray,
    most: np.ndarray,
    start: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fits numbers to signed errors of matches.

    Least squares, iteratively reweighted (Cauchy), with derivatives by differences.

    Args:
        find_errors: returns the errors (M,) of numbers (N,), NaN where there is none.
        views: (M, 2) of the matches.
        steps: (N,) of the differences.
        known: (N,) standard deviations with which the numbers are known to be zero.
        most: (N,) by which an iteration may change the numbers.
        start: (N,) first numbers.

    Returns:
        The numbers (N,), their covariance (N, N) by the jackknife over views, and their effect: the
        error that they take away, in units of the spread that they leave.
    """
    x, covariance = np.zeros(len(steps)) + start, np.full((len(steps), len(steps)), np.inf)
    for _ in range(_ITERATIONS):
        now = find_errors(x)
        slopes = np.stack(
            [(find_errors(x + d) - find_errors(x - d)) / (2 * d.max()) for d in np.diag(steps)],
            axis=1,
        )
        good = np.isfinite(now) & np.isfinite(slopes).all(axis=1)
        if np.count_nonzero(good) < _FEWEST:
            break
        sigma = max(_NORMAL * float(np.median(np.abs(now[good]))), 0.05)
        weight = 1 / (1 + (now[good] / (2 * sigma)) ** 2)
        slope = slopes[good]
        weighted = weight[:, None] * slope
        prior = np.diag((sigma / known) ** 2)
        whole = slope.T @ weighted + prior
        step = np.linalg.solve(whole, weighted.T @ now[good] + prior @ x)
        covariance = _leave_views_out(views[good], whole, slope, weighted, now[good] - slope @ step)
        step = np.clip(step, -most, most)
        x = x - step
        if np.all(np.abs(step) < _SETTLED * steps):
            break
    return x, covariance, _measure_effect(find_errors(np.zeros(len(x))), find_errors(x))


def _measure_effect(before: np.ndarray, after: np.ndarray) -> float:
    """Returns the error that is in `before` alone, in units of the spread of `after`.

    By medians: a few wrong matches may bend a lens that a straight path leaves open, and the others
    fit no better for it.
    """
    good = np.isfinite(before) & np.isfinite(after)
    if not good.any():
        return 0.0
    first, second = (float(np.median(np.abs(errors[good]))) for errors in (before, after))
    return float(np.sqrt(max(0.0, (first / max(second, _TINY)) ** 2 - 1)))


def _leave_views_out(
    views: np.ndarray,
    whole: np.ndarray,
    slope: np.ndarray,
    weighted: np.ndarray,
    errors: np.ndarray,
) -> np.ndarray:
    """Returns the covariance of a linear fit by the jackknife over views.

    Where a few views determine a value, their own errors are small because the fit follows them,
    and only its change without them shows how little is known. Each pair is left out with either of
    its views, hence the half (Snijders and Borgatti, "Non-parametric standard errors and tests for
    network statistics", 1999).

    Args:
        views: (M, 2) of each match.
        whole: (N, N) normal matrix of all matches.
        slope, weighted: (M, N) derivatives of the errors, and the same times the weights.
        errors: (M,) that the fit leaves.
    """
    used, moves = np.unique(views), []
    for view in used:
        rows = (views == view).any(axis=1)
        rest = whole - slope[rows].T @ weighted[rows]
        moves.append(np.linalg.solve(rest, weighted[rows].T @ errors[rows]))
    return (len(used) - 2) / (2 * len(used)) * np.array(moves).T @ np.array(moves)


def find_line_rays(
    cameras: Sequence[Camera], matches: Matches, x: np.ndarray | None = None
) -> np.ndarray:
    """Returns the rays (3, 2, M, 3) from which `measure_line_errors` measures.

    Of the matches, and of pixels `_STEP_PX` to the right of and below them.

    Args:
        cameras: the lenses.
        matches: their pixels.
        x: (4,) change of the lenses, as `LensFit.values`; None: none.
    """
    steps = np.array([[0.0, 0.0], [_STEP_PX, 0.0], [0.0, _STEP_PX]])[:, None, None]
    x = np.zeros(4) if x is None else x
    return find_rays(cameras, matches, _move_pixels(cameras, matches, matches.pixels + steps, x))


def measure_line_errors(rays: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Returns how far matches (M,) lie from each other's epipolar lines, pixels, signed.

    In pixels of the given images, whatever the lens makes of them (Sampson's distance; Hartley and
    Zisserman, "Multiple view geometry", 2003, equation 11.9). Angles would not do: a longer focal
    length makes all of them smaller, and fits no better for it.

    Args:
        rays: (3, 2, M, 3), see `find_line_rays`.
        poses: (2, M, 4, 4) world_from_camera.
    """
    base = poses[1, :, :3, 3] - poses[0, :, :3, 3]
    base = base / np.maximum(np.linalg.norm(base, axis=1, keepdims=True), _TINY)
    one, two = (np.einsum("mij,smj->smi", poses[side, :, :3, :3], rays[:, side]) for side in (0, 1))
    normal = [np.cross(two[0], base), np.cross(base, one[0])]
    missed = np.einsum("mi,mi->m", two[0], normal[1])
    slopes = [np.einsum("smi,mi->sm", seen[1:] - seen[0], normal[side]) / _STEP_PX
              for side, seen in enumerate((one, two))]  # fmt: skip
    size = np.linalg.norm(np.concatenate(slopes), axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return missed / size


def _move_pixels(
    cameras: Sequence[Camera], matches: Matches, pixels: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """Returns where the given lenses see what the changed ones see at `pixels`.

    Args:
        cameras: the lenses.
        matches: their pixels.
        pixels: (..., 2, M, 2) at the matches or beside them.
        x: (4,) change of the lenses, as `LensFit.values`.
    """
    centers = _find_principal_points(cameras)[matches.lens]
    away = (pixels - x[1:3] - centers) / np.exp(x[0])
    radius = np.linalg.norm(away, axis=-1, keepdims=True) / (matches.diagonal / 2)
    return centers + away / (1 + x[3] * radius**2)


def _find_principal_points(cameras: Sequence[Camera]) -> np.ndarray:
    return np.array([find_principal_point(camera) for camera in cameras])


def find_principal_point(camera: Camera) -> np.ndarray:
    """Returns the pixel (2,) of the optical axis, or the image's middle if it has none."""
    place, valid = camera.project(np.array([[0.0, 0.0, 1.0]]))
    return place[0] if valid[0] else np.array([camera.width, camera.height]) / 2
