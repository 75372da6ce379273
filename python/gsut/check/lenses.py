"""Tries other lenses than the dataset's: scaled, shifted, of another model, with other k."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gsut._core import InputError
from gsut.check.epipolar import Matches, find_rays
from gsut.lens import Camera
from gsut.sfm.points import measure_angular_errors, measure_pixels_per_radian

# Factors on the image's size that programs resize by, and that a lens may not have followed.
_SIZES = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0, 3.0, 4.0)
# Hundredths of the logarithm of a factor on the focal length: from half to double.
_FOCALS = range(-68, 69, 4)
_NEAR = (-3, -2, -1, 1, 2, 3)  # likewise, around the best of _FOCALS
_FISHEYE_K1 = (0.0, 0.02, 0.05, -0.02, -0.05)  # of fisheyes in use, about an equidistant one
_BARREL_K1 = (-0.4, -0.3, -0.2, -0.1, -0.05, 0.05, 0.1)  # of lenses in use, mostly barrels
_ITERATIONS = 8  # of the reweighted fit, which settles within half of them
_SETTLED = 0.05  # of the differences' steps: a fit that moves less has settled
_NORMAL = 1.4826  # standard deviation of a normal law over the median of its absolute values
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
        covariance: (4, 4) of them, pairs of images taken as independent.
        diagonal: of the image, pixels.
    """

    values: np.ndarray
    covariance: np.ndarray
    diagonal: float

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations (4,) of the values."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def shift_distance(self, shift: np.ndarray) -> float:
        """Returns the Mahalanobis distance of the correction of cx and cy from a shift (2,)."""
        off = self.values[1:3] - shift
        return float(np.sqrt(off @ np.linalg.pinv(self.covariance[1:3, 1:3]) @ off))

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
        """The same corrections (3,), in standard deviations."""
        ratio = np.abs(self.values) / np.maximum(self.sigmas, 1e-12)
        return np.array([ratio[0], max(ratio[1], ratio[2]), ratio[3]])


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
    focal = measure_pixels_per_radian(cameras[0])
    steps = np.diag([1e-3, 0.1, 0.1, 1e-3])

    def find_errors(x: np.ndarray) -> np.ndarray:
        return (
            measure_angular_errors(_find_moved_rays(cameras, matches, x), poses, signed=True)
            * focal
        )

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
        pull = weight[:, None] * slope * now[good, None]
        bread = np.linalg.pinv(slope.T @ (weight[:, None] * slope), hermitian=True)
        of_pairs = np.stack(
            [np.bincount(matches.pair[good], column, len(matches.pairs)) for column in pull.T]
        )
        covariance = bread @ (of_pairs @ of_pairs.T) @ bread
        step = np.clip(bread @ pull.sum(axis=0), [-0.2, -50, -50, -0.1], [0.2, 50, 50, 0.1])
        x = x - step
        if np.all(np.abs(step) < _SETTLED * steps.max(axis=1)):
            break
    return LensFit(x, covariance, matches.diagonal)


def _find_moved_rays(cameras: Sequence[Camera], matches: Matches, x: np.ndarray) -> np.ndarray:
    """Returns the rays (2, M, 3) of the matches through lenses changed by `LensFit.values`."""
    centers = np.array([_find_principal_point(camera) for camera in cameras])[matches.lens]
    away = (matches.pixels - x[1:3] - centers) / np.exp(x[0])
    radius = np.linalg.norm(away, axis=-1, keepdims=True) / (matches.diagonal / 2)
    moved = centers + away / (1 + x[3] * radius**2)
    return find_rays(cameras, dataclasses.replace(matches, pixels=moved))


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
