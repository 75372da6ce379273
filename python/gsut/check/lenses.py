"""Tries other lenses than the dataset's: scaled, shifted, of another model, with other k."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gsut._core import InputError
from gsut.check.epipolar import Matches, find_rays
from gsut.lens import Camera

# Factors on the image's size that programs resize by, and that a lens may not have followed.
_SIZES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0, 4.0)
# Hundredths of the logarithm of a factor on the focal length: from half to double.
_FOCALS = range(-68, 69, 4)
_NEAR = (-3, -2, -1, 1, 2, 3)  # likewise, around the best of _FOCALS
_FISHEYE_K1 = (0.0, 0.02, 0.05, -0.02, -0.05)  # of fisheyes in use, about an equidistant one
_BARREL_K1 = (-0.4, -0.3, -0.2, -0.1, -0.05, 0.05, 0.1)  # of lenses in use, mostly barrels
# Other orders of radial-tangential coefficients, and where OpenCV's k1 k2 p1 p2 k3 stand in them.
_COEFFICIENT_ORDERS = {"k1 k2 k3 p1 p2": (0, 1, 3, 4, 2), "p1 p2 k1 k2 k3": (2, 3, 0, 1, 4)}
_ITERATIONS = 8  # of the reweighted fit, which settles within half of them
_SETTLED = 0.05  # of the differences' steps: a fit that moves less has settled
_NORMAL = 1.4826  # standard deviation of a normal law over the median of its absolute values
# Standard deviation with which a lens is known beforehand, of its focal length, diagonal and
# distortion: what a straight path does not determine stays as it is given.
_KNOWN = 0.25
_TINY = 1e-12  # keeps quotients finite
_STEP_PX = 0.01  # of differences between rays: small beside a pixel, large beside rounding
_FEWEST = 40  # matches to which the four numbers are fitted


Change = Callable[[Camera], "Camera | None"]


@dataclasses.dataclass(frozen=True)
class OtherLens:
    """Lenses that may have been meant instead of the dataset's.

    Args:
        name: completes "the photographs fit ...".
        advice: the edit that mends the data.
        cameras: one for each of the dataset's.
    """

    name: str
    advice: str
    cameras: list[Camera]


@dataclasses.dataclass(frozen=True)
class LensFit:
    """A correction of the lens, fitted to the matches with the poses held.

    Args:
        values: (4,) logarithm of the factor on the focal lengths; pixels to add to cx and cy;
            factor minus 1 on the distance from the centre, at half the image's diagonal.
        covariance: (4, 4) of them, by what each view changes when it is left out.
        diagonal: of the image, pixels.
        freedom: views less the four values: degrees of freedom of the covariance.
    """

    values: np.ndarray
    covariance: np.ndarray
    diagonal: float
    freedom: int

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations (4,) of the values."""
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
        return _find_moved_rays(cameras, matches, self.values)

    @property
    def moves(self) -> np.ndarray:
        """The motion of pixels by focal length, principal point and distortion.

        (3,) in thousandths of the diagonal; the focal length a quarter of the diagonal from the
        centre, the distortion half of it.
        """
        scale, dx, dy, radial = np.abs(self.values)
        return 1000 * np.array([scale / 4, np.hypot(dx, dy) / self.diagonal, radial / 2])

    @property
    def significance(self) -> np.ndarray:
        """The same corrections (3,), in standard deviations of a normal law that are as rare."""
        ratio = np.abs(self.values) / np.maximum(self.sigmas, 1e-12)
        ratio = np.array([ratio[0], max(ratio[1], ratio[2]), ratio[3]])
        return convert_to_normal(ratio, self.freedom)


def convert_to_normal(ratio: np.ndarray, freedom: int) -> np.ndarray:
    """Converts Student's t to standard deviations of a normal law that are as rare.

    Few pairs underestimate a spread by chance, so that a large ratio is less rare (Wallace, "Bounds
    on normal approximations to Student's and the chi-square distributions", 1959).

    Args:
        ratio: values over estimated standard deviations.
        freedom: degrees of freedom of the estimate.
    """
    bend = (8 * freedom + 1) / (8 * freedom + 3)
    return bend * np.sqrt(freedom * np.log1p(np.square(ratio) / freedom))


def fit_lens(cameras: Sequence[Camera], matches: Matches, poses: np.ndarray) -> LensFit:
    """Fits one scale, shift and radial term for all lenses to the epipolar errors.

    Least squares, iteratively reweighted (Cauchy), with derivatives by differences. A lens scaled
    about its principal point sees a pixel where it saw one nearer or farther, so pixels are moved
    instead of making lenses.

    Args:
        cameras: the lenses.
        matches: their pixels.
        poses: (2, M, 4, 4) world_from_camera.
    """
    steps = np.diag([1e-3, 0.1, 0.1, 1e-3])
    known = np.array([1.0, matches.diagonal, matches.diagonal, 1.0]) * _KNOWN

    def find_errors(x: np.ndarray) -> np.ndarray:
        return _find_moved_errors(cameras, matches, poses, x)

    freedom = max(1, len(np.unique(matches.pairs[matches.pair])) - len(steps))
    x, covariance = np.zeros(4), np.full((4, 4), np.inf)
    for _ in range(_ITERATIONS):
        now = find_errors(x)
        slopes = np.stack(
            [(find_errors(x + d) - find_errors(x - d)) / (2 * d.max()) for d in steps], axis=1
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
        covariance = _leave_views_out(
            matches.pairs[matches.pair[good]], whole, slope, weighted, now[good] - slope @ step
        )
        step = np.clip(step, [-0.2, -50, -50, -0.1], [0.2, 50, 50, 0.1])
        x = x - step
        if np.all(np.abs(step) < _SETTLED * steps.max(axis=1)):
            break
    return LensFit(x, covariance, matches.diagonal, freedom)


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
        whole: (4, 4) normal matrix of all matches.
        slope, weighted: (M, 4) derivatives of the errors, and the same times the weights.
        errors: (M,) that the fit leaves.
    """
    used, moves = np.unique(views), []
    for view in used:
        rows = (views == view).any(axis=1)
        rest = whole - slope[rows].T @ weighted[rows]
        moves.append(np.linalg.solve(rest, weighted[rows].T @ errors[rows]))
    return (len(used) - 2) / (2 * len(used)) * np.array(moves).T @ np.array(moves)


def _find_moved_errors(
    cameras: Sequence[Camera], matches: Matches, poses: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """Returns how far matches (M,) lie from each other's epipolar lines, pixels, signed.

    In pixels of the given images, whatever the lens makes of them (Sampson's distance; Hartley and
    Zisserman, "Multiple view geometry", 2003, equation 11.9). Angles would not do: a longer focal
    length makes all of them smaller, and fits no better for it.

    Args:
        cameras: the lenses.
        matches: their pixels.
        poses: (2, M, 4, 4) world_from_camera.
        x: (4,) change of the lenses, as `LensFit.values`.
    """
    one, two = poses[..., :3, :3]
    base = poses[1, :, :3, 3] - poses[0, :, :3, 3]
    base = base / np.maximum(np.linalg.norm(base, axis=1, keepdims=True), _TINY)
    right, down = np.array([_STEP_PX, 0.0]), np.array([0.0, _STEP_PX])
    rays = [_find_moved_rays(cameras, matches, x, step) for step in (0.0, right, down)]
    seen = [np.einsum("mij,smj->smi", turn, [each[side] for each in rays])
            for side, turn in enumerate((one, two))]  # fmt: skip
    normal = [np.cross(seen[1][0], base), np.cross(base, seen[0][0])]
    missed = np.einsum("mi,mi->m", seen[1][0], normal[1])
    slopes = [np.einsum("smi,mi->sm", seen[side][1:] - seen[side][0], normal[side]) / _STEP_PX
              for side in (0, 1)]  # fmt: skip
    size = np.linalg.norm(np.concatenate(slopes), axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return missed / size


def _find_moved_rays(
    cameras: Sequence[Camera], matches: Matches, x: np.ndarray, step: np.ndarray | float = 0.0
) -> np.ndarray:
    """Returns the rays (2, M, 3) of pixels a step (2,) beside the matches through changed lenses.

    Args:
        cameras: the lenses.
        matches: their pixels.
        x: (4,) change of the lenses, as `LensFit.values`.
        step: (2,) pixels.
    """
    centers = _find_principal_points(cameras)[matches.lens]
    away = (matches.pixels + step - x[1:3] - centers) / np.exp(x[0])
    radius = np.linalg.norm(away, axis=-1, keepdims=True) / (matches.diagonal / 2)
    moved = centers + away / (1 + x[3] * radius**2)
    return find_rays(cameras, dataclasses.replace(matches, pixels=moved))


def _find_principal_points(cameras: Sequence[Camera]) -> np.ndarray:
    return np.array([_find_principal_point(camera) for camera in cameras])


def list_other_lenses(
    cameras: Sequence[Camera], cost_of: Callable[[list[Camera]], float]
) -> Iterator[OtherLens]:
    """Yields all other lenses to try, the likelier first.

    Args:
        cameras: the dataset's.
        cost_of: rates lenses; near the best focal length more are tried.
    """
    focals = {k: _make_lens(cameras, *_scale_focal(k)) for k in _FOCALS}
    costs = {k: cost_of(lens.cameras) for k, lens in focals.items() if lens is not None}
    if costs:
        best = min(costs, key=lambda k: costs[k])
        focals |= {best + k: _make_lens(cameras, *_scale_focal(best + k)) for k in _NEAR}
    for name, advice, change in _list_changes():
        if change is None:
            yield from (lens for _, lens in sorted(focals.items()) if lens is not None)
            continue
        made = _make_lens(cameras, name, advice, change)
        if made is not None:
            yield made


def _make_lens(
    cameras: Sequence[Camera], name: str, advice: str, change: Change
) -> OtherLens | None:
    """Changes the lenses; returns None if one cannot be changed so, or none changes."""
    try:
        made = [change(camera) for camera in cameras]
    except (InputError, ValueError, KeyError):
        return None
    known = [camera for camera in made if camera is not None]
    same = len(known) < len(cameras) or known == list(cameras)
    return None if same else OtherLens(name, advice, known)


def _scale_focal(hundredths: int) -> tuple[str, str, Change]:
    s = float(np.exp(hundredths / 100))
    return (
        f"a focal length times {s:.3f}",
        f"multiply fx and fy by about {s:.3f}, or calibrate anew",
        functools.partial(_with, scale=s),
    )


def _list_changes() -> Iterator[tuple[str, str, Change | None]]:
    """Yields name, advice and change; None as the change marks the place of the focal lengths."""
    yield (
        "a lens without distortion: they have been undistorted",
        "give the lens that the undistorted photographs have (pinhole, no k), or the originals",
        without_distortion,
    )
    yield (
        "a fisheye (Kannala-Brandt) with these coefficients, not radial-tangential ones",
        'name the model: camera_model "OPENCV_FISHEYE" (kannala_brandt)',
        _as_fisheye,
    )
    yield (
        "a radial-tangential lens (OpenCV) with these coefficients, not a fisheye",
        'name the model: camera_model "OPENCV"',
        _as_opencv,
    )
    for name, order in _COEFFICIENT_ORDERS.items():
        yield (
            f"coefficients in the order {name}, not k1 k2 p1 p2 k3",
            "write the coefficients in OpenCV's order, k1 k2 p1 p2 k3, or by their names",
            functools.partial(_reorder_coefficients, order=order),
        )
    yield (
        "a principal point with cx and cy swapped",
        "swap cx and cy (and width and height, where they are swapped, too)",
        lambda c: _with(c, cx=c.params[3], cy=c.params[2]),
    )
    yield (
        "a principal point mirrored in the image's middle",
        "the images were turned by 180 degrees, or mirrored, after calibration: cx = width - cx",
        lambda c: _with(c, cx=c.width - c.params[2], cy=c.height - c.params[3]),
    )
    yield (
        "a principal point in the image's middle",
        "set cx, cy to half of width and height",
        lambda c: _with(c, cx=c.width / 2, cy=c.height / 2),
    )
    for s in _SIZES:
        yield (
            f"focal length and principal point times {s:.3g}: the lens is for images of another "
            "size",
            f"multiply fx, fy, cx and cy by {s:.4g}, or give the width and height they are for",
            functools.partial(_scale, scale=s, center=s),
        )
        yield (
            f"a principal point times {s:.3g}",
            f"multiply cx and cy by {s:.4g}: they are for images of another size",
            functools.partial(_scale, scale=1.0, center=s),
        )
    yield "", "", None
    for k in _FISHEYE_K1:
        yield (
            "a fisheye: they are not undistorted, as the lens says",
            "give the lens file of the original photographs, or calibrate (gsut calibrate)",
            functools.partial(_add_distortion, model="kannala_brandt", k1=k),
        )
    for k in _BARREL_K1:
        yield (
            f"a lens with distortion (k1 of about {k:g}): they are not undistorted, as the lens "
            "says",
            "give the lens file of the original photographs, or calibrate (gsut calibrate)",
            functools.partial(_add_distortion, model="opencv4", k1=k),
        )
    yield (
        "distortion of the other sign",
        "the coefficients undistort where they should distort: change their signs, or take them "
        "from the calibration as it was written",
        lambda c: _with_distortion(c, -np.array(c.params[4:])),
    )


def _find_principal_point(camera: Camera) -> np.ndarray:
    place, valid = camera.project(np.array([[0.0, 0.0, 1.0]]))
    return place[0] if valid[0] else np.array([camera.width, camera.height]) / 2


def _has_four(camera: Camera) -> bool:
    return camera.param_names.split()[:4] == ["fx", "fy", "cx", "cy"]


def _drop_limit(camera: Camera) -> Camera:
    return camera if camera.valid_field_angle is None else camera.with_valid_field_angle(None)


def _with(
    camera: Camera, scale: float = 1.0, cx: float | None = None, cy: float | None = None
) -> Camera | None:
    if not _has_four(camera):
        return None
    params = np.array(camera.params)
    params[:2] *= scale
    params[2] = params[2] if cx is None else cx
    params[3] = params[3] if cy is None else cy
    return _drop_limit(camera).with_params(params)


def _scale(camera: Camera, scale: float, center: float) -> Camera | None:
    return _with(camera, scale, center * camera.params[2], center * camera.params[3])


def _with_distortion(camera: Camera, values: np.ndarray) -> Camera | None:
    if not _has_four(camera) or not np.any(values):
        return None
    params = np.concatenate([camera.params[:4], values])
    return _drop_limit(camera).with_params(params)


def _reorder_coefficients(camera: Camera, order: tuple[int, ...]) -> Camera | None:
    if not camera.model.startswith("opencv") or len(camera.params) < 4 + len(order):
        return None
    params = np.array(camera.params)
    params[4 : 4 + len(order)] = params[4 : 4 + len(order)][list(order)]
    return _drop_limit(camera).with_params(params)


def without_distortion(camera: Camera) -> Camera | None:
    """Returns the pinhole of a lens, or None if it is one, or has none."""
    if not _has_four(camera) or camera.model == "pinhole":
        return None
    return Camera("pinhole", camera.params[:4], camera.width, camera.height)


def is_free_of_distortion(camera: Camera) -> bool:
    """Returns whether the lens is a pinhole, or its coefficients are all zero."""
    return _has_four(camera) and not np.any(camera.params[4:])


def _add_distortion(camera: Camera, model: str, k1: float) -> Camera | None:
    if not is_free_of_distortion(camera):
        return None
    return Camera(model, [*camera.params[:4], k1, 0, 0, 0], camera.width, camera.height)


def _as_fisheye(camera: Camera) -> Camera | None:
    if not camera.model.startswith("opencv") or not _has_four(camera):
        return None
    return Camera("kannala_brandt", list(camera.params[:8]), camera.width, camera.height)


def _as_opencv(camera: Camera) -> Camera | None:
    if camera.model != "kannala_brandt":
        return None
    return Camera("opencv4", list(camera.params[:8]), camera.width, camera.height)
