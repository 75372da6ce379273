"""Cameras: a lens with its parameters and image size, between points, pixels and rays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import show
from gsut.lens.plausible import find_fault

_NO_LIMIT = math.inf
MOST_PIXELS = 1 << 16  # of a side of an image: more than any file format in use holds


def camera_models() -> list[str]:
    """Names of all lenses that `Camera` takes as its model.

    Returns:
        Sorted names, such as "kannala_brandt"; docs/lenses.md describes each.
    """
    return _core.camera_models()


class Camera(_core.Camera):
    """A camera without its pose: one lens, its parameters and the image's size. Immutable.

    Points are in the camera frame: x right, y down, z forward. Pixel (0.5, 0.5) is the centre of
    the top-left pixel. "Valid" means inside the lens' one-to-one domain; whether the pixel lies
    inside the image is another question. Results have the same bits on any number of threads.

    Args:
        model: one of `camera_models()`.
        params: (K,) fx fy cx cy in pixels, then the lens' coefficients; see `param_names`.
        width, height: of the image, in pixels.
        valid_field_angle: radians from the axis up to which the calibration is trusted; points and
            pixels beyond it are invalid. None: the lens' whole domain.
        extrinsics: (6,) Rodrigues rotation and translation reference -> camera, as carried by a
            .cameramodel file (rt_cam_ref); kept for saving, used by nothing here.
        valid_region: (M, 2) polygon of trusted pixels, as carried by a .cameramodel file
            (valid_intrinsics_region); kept for saving, used by nothing here.

    Attributes:
        model, params, width, height: the arguments; params is (K,) float64, a copy.
        max_angle: radians from the axis at which the domain ends, pi at most.
        is_central: whether all rays meet in one point; is_parallel: whether all are parallel.
        is_cone: whether `max_angle` alone bounds the domain, all around the axis.

    Raises:
        InputError: unknown model (the known ones are listed), wrong number of parameters, a size
            that is no whole number of pixels, values that no lens has: focal lengths more than 4
            times one another or far from the image's size, and what leaves pixels without rays,
            or all with the same. The message names the parameter.
    """

    extrinsics: np.ndarray | None
    valid_region: np.ndarray | None
    solved_from: tuple[str, ...] = ()  # lines of a .cameramodel file; not of a changed lens

    def __init__(
        self,
        model: str,
        params: Sequence[float] | np.ndarray,
        width: int,
        height: int,
        *,
        valid_field_angle: float | None = None,
        extrinsics: Sequence[float] | np.ndarray | None = None,
        valid_region: Sequence[Sequence[float]] | np.ndarray | None = None,
    ) -> None:
        self._take(model, params, width, height, valid_field_angle, extrinsics, valid_region)
        doubt = find_fault(self)
        if doubt is not None:
            raise InputError(f"{model}: this is no lens: {doubt}")

    def _take(
        self,
        model: str,
        params: Sequence[float] | np.ndarray,
        width: int,
        height: int,
        valid_field_angle: float | None = None,
        extrinsics: Sequence[float] | np.ndarray | None = None,
        valid_region: Sequence[Sequence[float]] | np.ndarray | None = None,
    ) -> Camera:
        """Initializes the camera without asking whether a real lens can have these numbers."""
        limit = _convert_field_angle(valid_field_angle)
        values = [float(value) for value in _core.read_array(params, "params").ravel()]
        super().__init__(show(model), values, *_convert_size(width, height), limit)
        self.extrinsics = _copy_checked(extrinsics, "extrinsics", (6,))
        self.valid_region = _copy_checked(valid_region, "valid_region", (None, 2))
        return self

    @property
    def valid_field_angle(self) -> float | None:  # type: ignore[override]  # None, not infinity
        """The angle from the axis up to which the lens is trusted, in radians; None: unlimited."""
        limit = super().valid_field_angle
        return None if limit == _NO_LIMIT else limit

    @property
    def param_names(self) -> str:
        """The names of `params` in order; "..." means any number of further coefficients."""
        return _core.camera_param_names(self.model)

    def project(self, points_in_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Projects points to pixels.

        Args:
            points_in_camera: (N, 3) of any length but 0.

        Returns:
            pixels (N, 2) float64, NaN where invalid; valid (N,) bool.

        Raises:
            InputError: wrong shape.
        """
        return super().project(points_in_camera)

    def unproject(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the rays of pixels.

        Args:
            pixels: (N, 2), anywhere: also outside the image.

        Returns:
            rays (N, 3) float64 of unit length, NaN where invalid; valid (N,) bool. A valid ray
            projects to its pixel within 1e-9 px (for coordinates below 1e6).

        Raises:
            InputError: wrong shape.
        """
        return super().unproject(pixels)

    def ray_origins(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the points, in the camera frame, at which the rays of pixels start.

        Args:
            pixels: (N, 2), anywhere: also outside the image.

        Returns:
            origins (N, 3) float64, 0 for a central lens and NaN where invalid; valid (N,) bool.
            origin + t ray, t > 0, projects to the pixel.

        Raises:
            InputError: wrong shape.
        """
        return super().ray_origins(pixels)

    def origins(self) -> np.ndarray:
        """Returns the points at which the rays of all pixel centres start.

        Returns:
            (H, W, 3) float64 points in the camera frame; 0 for a central lens.
        """
        return super().origins()

    def project_jacobian(
        self, points_in_camera: np.ndarray, with_params: bool | Sequence[int] | np.ndarray = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Computes exact derivatives of `project`, by forward-mode differentiation.

        Args:
            points_in_camera: (N, 3).
            with_params: False: dpixel_dparams has no rows, which takes a fraction of the time; or
                the indices of the F parameters that it is wanted for.

        Returns:
            dpixel_dpoint (N, 2, 3) in pixels per unit of the points; dpixel_dparams (N, 2, K), or
            (N, 2, F) in the order of the indices. NaN where the point is invalid.

        Raises:
            InputError: wrong shape, or an index of no parameter.
        """
        return super().project_jacobian(points_in_camera, with_params)

    def subtract_pixels(self, pixels: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Returns `pixels - others`, through a panorama the short way round its seam.

        Args:
            pixels, others: (N, 2) pixels.

        Returns:
            (N, 2) pixels.
        """
        difference = pixels - others
        for axis, period in enumerate(self.period):
            if period > 0:
                difference[..., axis] -= period * np.round(difference[..., axis] / period)
        return difference

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the rays of all pixel centres, which are computed once and kept.

        Returns:
            rays (H, W, 3) float64 of unit length, NaN where invalid; valid (H, W) bool. Read-only
            views. Each valid ray was checked to project back to its pixel within 1e-6 px.
        """
        return super().rays()

    def resize(self, width: int, height: int) -> Camera:
        """Returns the lens of the image resized to this size, scaled about the pixel corner (0, 0).

        Args:
            width, height: of the new image, pixels.

        Returns:
            The lens with its parameters in pixels of the new image.

        Raises:
            InputError: a size that is not positive.
        """
        region = self.valid_region
        if region is not None:
            region = region * (width / self.width, height / self.height)
        resized = super().resize(*_convert_size(width, height))
        return self._with(resized, valid_region=region)

    def with_params(self, params: Sequence[float] | np.ndarray) -> Camera:
        """Returns another lens of the same model, image size and field angle.

        Pose and trusted region, which belong to this lens, are left out. Solvers go through
        numbers that no lens has: those are taken here.

        Args:
            params: (K,) in the model's order.

        Raises:
            InputError: wrong number of parameters, or values outside the model's domain.
        """
        return Camera.__new__(Camera)._take(
            self.model, params, self.width, self.height, self.valid_field_angle
        )

    def with_valid_field_angle(self, valid_field_angle: float | None) -> Camera:
        """Returns the lens trusted up to this angle from the axis (radians; None: everywhere)."""
        limit = _convert_field_angle(valid_field_angle)
        return self._with(super().with_valid_field_angle(limit), valid_region=self.valid_region)

    def _with(self, core: _core.Camera, valid_region: np.ndarray | None) -> Camera:
        return Camera.__new__(Camera)._take(
            core.model, core.params, core.width, core.height, core.valid_field_angle,
            self.extrinsics, valid_region,
        )  # fmt: skip

    def __eq__(self, other: object) -> bool:
        """Returns whether model, parameters, size and valid field angle are equal."""
        if not isinstance(other, _core.Camera):
            return NotImplemented
        return bool(_core.Camera.__eq__(self, other))

    def __hash__(self) -> int:
        return hash((self.model, tuple(self.params), self.width, self.height))

    def __reduce__(self) -> tuple[Any, ...]:
        keywords = (self.valid_field_angle, self.extrinsics, self.valid_region)
        return _restore, (self.model, self.params, self.width, self.height, *keywords)

    def __repr__(self) -> str:
        if "extrinsics" not in self.__dict__:  # refused by __init__, and seen by a debugger
            return "Camera(refused)"
        values = ", ".join(f"{value:.10g}" for value in self.params)
        limit = self.valid_field_angle
        field = "" if limit is None else f", valid_field_angle={limit:.6g}"
        return f"Camera({self.model!r}, [{values}], {self.width}, {self.height}{field})"


def _restore(*given: Any) -> Camera:
    return Camera.__new__(Camera)._take(*given)


def _convert_size(width: Any, height: Any) -> tuple[int, int]:
    """Converts the image's sides to whole numbers; 640.0 counts as 640."""
    try:
        size = int(width), int(height)
        good = size == (width, height) and all(0 < side <= MOST_PIXELS for side in size)
        good = good and not any(isinstance(side, (bool, np.bool_)) for side in (width, height))
    except (TypeError, ValueError, OverflowError):
        good = False
    if not good:
        raise InputError(
            f"width and height are whole numbers of pixels from 1 to {MOST_PIXELS}, found "
            f"{show(width)} x {show(height)}"
        )
    return size


def _convert_field_angle(angle: float | None) -> float:
    """Converts a limit of the field to radians without None; refuses what must be degrees."""
    limit = _NO_LIMIT if angle is None else float(angle)
    if limit != _NO_LIMIT and limit > math.pi:
        raise InputError(
            f"valid_field_angle is in radians from the axis, at most pi, found {limit:g}; if these "
            f"are degrees, give math.radians({limit:g})"
        )
    return limit


def _copy_checked(values: Any, name: str, shape: tuple[int | None, ...]) -> np.ndarray | None:
    if values is None:
        return None
    array = np.array(values, dtype=np.float64)
    same = array.ndim == len(shape) and all(
        want is None or want == found for want, found in zip(shape, array.shape, strict=True)
    )
    if not same:
        raise InputError(f"{name} must have shape {shape}, found {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite numbers, found {array.tolist()}")
    array.flags.writeable = False
    return array
