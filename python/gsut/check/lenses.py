"""Tries other lenses than the dataset's: scaled, shifted, of another model, with other k."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gsut._core import InputError
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


def list_other_models(cameras: Sequence[Camera]) -> Iterator[OtherLens]:
    """Yields the lenses that a mistake of reading gives: another model, order, sign or centre."""
    for name, advice, change in _list_misreadings():
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


def _list_misreadings() -> Iterator[tuple[str, str, Change]]:
    """Yields name, advice and change of lenses whose numbers were read as something else."""
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
    yield (
        "distortion of the other sign",
        "the coefficients undistort where they should distort: change their signs, or take them "
        "from the calibration as it was written",
        lambda c: _with_distortion(c, -np.array(c.params[4:])),
    )


def _list_changes() -> Iterator[tuple[str, str, Change | None]]:
    """Yields name, advice and change; None as the change marks the place of the focal lengths."""
    yield from _list_misreadings()
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
