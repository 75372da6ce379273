"""Fits one lens by another over the image, and says how far apart they are by field angle."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.lens.camera import Camera
from gsut.lens.fit import CONTROL_COLUMNS, FitTarget, check_model, find_angles, fit_lens

# Points along the longer side of the image at which the lenses are compared.
_SAMPLES = 48
_SAMPLES_A_POINT = 3  # along that side, of a spline: more than it has control points
# World units at which points count as infinitely far from a lens whose rays nearly meet.
_FAR = 1e6
# Distance of a second set of points over that of the first: shows where rays start.
_FARTHER = 4.0
_RINGS = 6


@dataclasses.dataclass(frozen=True)
class Ring:
    """The error between two field angles.

    Attributes:
        from_degrees, to_degrees: angles from the axis.
        points: rays compared; 0 if the image has none there.
        rms: root of the mean squared distance, pixels; NaN without points.
        worst: the largest distance, pixels; infinite where the new lens does not see a ray.
    """

    from_degrees: float
    to_degrees: float
    points: int
    rms: float
    worst: float


@dataclasses.dataclass(frozen=True)
class Conversion:
    """A lens fitted to another.

    Attributes:
        camera: the fitted lens.
        rings: the error by field angle.
        rms, worst: over the whole image, pixels.
    """

    camera: Camera
    rings: list[Ring]
    rms: float
    worst: float

    def format_rings(self) -> str:
        """Formats the error by field angle as a table."""
        lines = ["field angle (degrees)   rays   rms (px)   worst (px)"]
        for ring in self.rings:
            lines.append(
                f"{ring.from_degrees:8.2f} to {ring.to_degrees:6.2f} {ring.points:9d}"
                f" {ring.rms:10.3g} {ring.worst:12.3g}"
            )
        total = sum(ring.points for ring in self.rings)
        lines.append(f"{'all':>18} {total:9d} {self.rms:10.3g} {self.worst:12.3g}")
        return "\n".join(lines)


@name_wrong_kinds
def convert_camera(
    camera: Camera,
    model: str,
    max_angle: float | None = None,
    num_params: int | None = None,
    *,
    columns: int = CONTROL_COLUMNS,
    distance: float | None = None,
) -> Conversion:
    """Fits a lens of another model that sends the rays of the image to the same pixels.

    Minimises the sum of squared pixel distances over a grid of pixels that covers the image: by
    Levenberg-Marquardt with the lens' exact derivatives, for control points in one linear step. A
    lens without parameters has nothing to fit: only the error is found.

    Args:
        camera: what to imitate.
        model: the lens to fit; see `camera_models()`.
        max_angle: radians; points farther from the axis are left out. None: all of the image.
        num_params: of a lens with any number of coefficients; None: the usual number, of the same
            model the camera's own.
        columns: control points of a splined lens across the image.
        distance: of the points that both lenses are to see alike, in world units, for lenses whose
            rays do not meet. None: far away, which orthographic cannot do.

    Returns:
        The fitted lens, with the valid field angle of the original, and its error.

    Raises:
        InputError: the model is unknown, or cannot see what the other sees, or the image has no
            rays.
    """
    if model == camera.model and num_params is None and not _core.camera_traits(model).has_table:
        num_params = len(camera.params)
    check_model(model, num_params)
    target = _make_target(camera, model, max_angle, columns, distance)
    params = fit_lens(target, model, num_params, columns)
    fitted = Camera(
        model,
        params,
        camera.width,
        camera.height,
        valid_field_angle=camera.valid_field_angle,
        extrinsics=camera.extrinsics,
        valid_region=camera.valid_region,
    )
    distances, angle = _measure_errors(fitted, target), find_angles(target.points)
    edges = np.linspace(0.0, np.nextafter(angle.max(), np.inf), _RINGS + 1)
    rings = []
    for low, high in itertools.pairwise(edges):
        inside = distances[(angle >= low) & (angle <= high)]
        rings.append(
            Ring(
                math.degrees(low),
                math.degrees(high),
                len(inside),
                _find_rms(inside),
                _find_worst(inside),
            )
        )
    return Conversion(fitted, rings, _find_rms(distances), _find_worst(distances))


def _make_target(
    camera: Camera,
    model: str,
    max_angle: float | None,
    columns: int,
    distance: float | None,
) -> FitTarget:
    """Points and pixels of a grid over the image, its edges included."""
    if distance is not None and not (distance > 0 and math.isfinite(distance)):
        raise InputError(f"the distance must be a positive number, found {distance}")
    traits = _core.camera_traits(model)
    if (camera.is_parallel or traits.is_parallel) and distance is None:
        raise InputError(
            f"the rays of '{model if traits.is_parallel else camera.model}' are parallel: it and "
            "another lens agree at one distance only; give that distance (--distance)"
        )
    samples = _SAMPLES
    if traits.has_table:
        samples = max(samples, _SAMPLES_A_POINT * columns)
    step = max(camera.width, camera.height) / samples
    x = np.linspace(0.5, camera.width - 0.5, max(2, round(camera.width / step)))
    y = np.linspace(0.5, camera.height - 0.5, max(2, round(camera.height / step)))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays, valid = camera.unproject(pixels)
    origins, _ = camera.ray_origins(pixels)
    near = distance if distance is not None else 1.0 if camera.is_central else _FAR
    # Points at two distances distinguish lenses whose rays do not meet.
    several = not camera.is_central and distance is not None and bool(traits.fit_near)
    places = (near, _FARTHER * near) if several else (near,)
    points = np.concatenate([origins + place * rays for place in places])
    pixels, valid = (np.concatenate([array] * len(places)) for array in (pixels, valid))
    if max_angle is not None:
        valid = valid & (find_angles(points) <= max_angle)
    if valid.sum() < 8:
        raise InputError(f"only {valid.sum()} of {len(pixels)} sampled pixels have a ray to fit")
    return FitTarget(camera, points[valid], pixels[valid], near, several)


def _measure_errors(camera: Camera, target: FitTarget) -> np.ndarray:
    """Returns the distances (N,) in pixels between projected points and their targets."""
    found, valid = camera.project(target.points)
    off = np.linalg.norm(np.nan_to_num(found) - target.pixels, axis=1)
    return np.where(valid, off, np.inf)


def _find_rms(distance: np.ndarray) -> float:
    return float(np.sqrt(np.mean(distance**2))) if len(distance) else math.nan


def _find_worst(distance: np.ndarray) -> float:
    return float(distance.max()) if len(distance) else math.nan
