"""Fits one lens by another over the image, and says how far apart they are by field angle."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math

import numpy as np

from gsut._core import InputError
from gsut.cameras import Camera, camera_models, load_camera

# Lenses whose parameters after fx fy cx cy are found by least squares, with a first guess.
_STARTS: dict[str, list[float]] = {
    "pinhole": [],
    "opencv4": [0.0] * 4,
    "opencv5": [0.0] * 5,
    "opencv8": [0.0] * 8,
    "opencv12": [0.0] * 12,
    "opencv14": [0.0] * 14,
    "kannala_brandt": [0.0] * 4,
    "thin_prism_fisheye": [0.0] * 8,
    "fisheye624": [0.0] * 12,
    "unified": [0.5],
    "extended_unified": [0.5, 1.0],
    "double_sphere": [0.0, 0.5],
    "division": [-0.1],
    "fov": [0.5],
    "mei": [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    "stereographic": [],
    "cahvor": [0.0] * 5,
    "lonlat": [],
    "latlon": [],
}
_FIXED = {"mei": (4,)}  # skew stays 0
# Points along the longer side of the image at which the lenses are compared.
_SAMPLES = 48
_MAX_STEPS = 200
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


def convert_camera(
    camera: Camera, model: str, max_angle: float | None = None, num_params: int | None = None
) -> Conversion:
    """The lens of another model that sends the rays of the image to the same pixels.

    Minimises the sum of squared pixel distances (Levenberg-Marquardt with the lens' exact
    derivatives) over a grid of pixels that covers the image.

    Args:
        camera: what to imitate.
        model: the lens to fit; see `camera_models()`.
        max_angle: radians; rays farther from the axis are left out. None: all rays of the image.
        num_params: of a lens with any number of coefficients (kannala_brandt); None: four of them.

    Returns:
        The fitted lens, with the valid field angle of the original, and its error.

    Raises:
        InputError: the model is unknown, or not one that can be fitted, or the image has no rays.
    """
    start = _first_guess(camera, model, num_params)
    rays, pixels = _samples(camera, max_angle)
    params = _fit(model, start, camera, rays, pixels)
    fitted = Camera(
        model,
        params,
        camera.width,
        camera.height,
        valid_field_angle=camera.valid_field_angle,
        extrinsics=camera.extrinsics,
        valid_region=camera.valid_region,
    )
    distance, angle = _distances(fitted, rays, pixels)
    edges = np.linspace(0.0, np.nextafter(angle.max(), np.inf), _RINGS + 1)
    rings = []
    for low, high in itertools.pairwise(edges):
        inside = distance[(angle >= low) & (angle <= high)]
        rings.append(
            Ring(math.degrees(low), math.degrees(high), len(inside), _rms(inside), _worst(inside))
        )
    return Conversion(fitted, rings, _rms(distance), _worst(distance))


def format_conversion(conversion: Conversion) -> str:
    """A table of the error by field angle, for people."""
    lines = ["field angle (degrees)   rays   rms (px)   worst (px)"]
    for ring in conversion.rings:
        lines.append(
            f"{ring.from_degrees:8.2f} to {ring.to_degrees:6.2f} {ring.points:9d}"
            f" {ring.rms:10.3g} {ring.worst:12.3g}"
        )
    total = sum(ring.points for ring in conversion.rings)
    lines.append(f"{'all':>18} {total:9d} {conversion.rms:10.3g} {conversion.worst:12.3g}")
    return "\n".join(lines)


def _first_guess(camera: Camera, model: str, num_params: int | None) -> np.ndarray:
    if model not in camera_models():
        raise InputError(f"unknown camera model '{model}'; known: {', '.join(camera_models())}")
    if model not in _STARTS:
        raise InputError(f"'{model}' cannot be fitted; lenses that can: {', '.join(_STARTS)}")
    tail = list(_STARTS[model])
    if num_params is not None:
        if model != "kannala_brandt" or num_params < 4:
            raise InputError(f"'{model}' does not take {num_params} parameters")
        tail = [0.0] * (num_params - 4)
    axis = np.array([[0.0, 0.0, 1.0]])
    (centre,), _ = camera.project(axis)
    jacobian, _ = camera.project_jacobian(axis)
    focal = np.abs([jacobian[0, 0, 0], jacobian[0, 1, 1]])
    # Models that divide by 1 + xi on the axis, or so.
    if model == "mei":
        focal = focal * (1.0 + tail[1])
    return np.array([*focal, *centre, *tail])


def _samples(camera: Camera, max_angle: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Rays (N, 3) and pixels (N, 2) of a grid over the image, its edges included."""
    step = max(camera.width, camera.height) / _SAMPLES
    columns = np.linspace(0.5, camera.width - 0.5, max(2, round(camera.width / step)))
    rows = np.linspace(0.5, camera.height - 0.5, max(2, round(camera.height / step)))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays, valid = camera.unproject(pixels)
    if max_angle is not None:
        valid &= _angles(rays) <= max_angle
    if valid.sum() < 8:
        raise InputError(f"only {valid.sum()} of {len(pixels)} sampled pixels have a ray to fit")
    return rays[valid], pixels[valid]


def _angles(rays: np.ndarray) -> np.ndarray:
    return np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])


def _distances(
    camera: Camera, rays: np.ndarray, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    found, valid = camera.project(rays)
    distance = np.where(valid, np.linalg.norm(np.nan_to_num(found) - pixels, axis=1), np.inf)
    return distance, _angles(rays)


def _rms(distance: np.ndarray) -> float:
    return float(np.sqrt(np.mean(distance**2))) if len(distance) else math.nan


def _worst(distance: np.ndarray) -> float:
    return float(distance.max()) if len(distance) else math.nan


def _fit(
    model: str, start: np.ndarray, camera: Camera, rays: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Widening: from the centre of the field outwards, so that no ray starts outside the domain."""
    params = start
    angles = _angles(rays)
    for share in (0.25, 0.5, 0.75, 1.0):
        near = angles <= max(share * angles.max(), np.sort(angles)[min(60, len(angles) - 1)])
        # What fits the centre may have a pole just beyond it: the first guess gets its chance too.
        tries = [
            _levenberg_marquardt(model, guess, camera, rays[near], pixels[near])
            for guess in (params, start)
        ]
        params = min(tries, key=lambda found: found[1])[0]
    return params


def _levenberg_marquardt(
    model: str, params: np.ndarray, camera: Camera, rays: np.ndarray, pixels: np.ndarray
) -> tuple[np.ndarray, float]:
    """The parameters and their cost."""
    free = [i for i in range(len(params)) if i not in _FIXED.get(model, ())]
    lens = Camera(model, params, camera.width, camera.height)
    cost, residual, valid = _cost(lens, rays, pixels)
    damping = 1e-4
    for _ in range(_MAX_STEPS):
        jacobian = lens.project_jacobian(rays)[1][valid][:, :, free].reshape(-1, len(free))
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
        scaled = jacobian / scale
        normal, gradient = scaled.T @ scaled, scaled.T @ residual[valid].ravel()
        improved = False
        while damping < 1e8:
            step = np.linalg.solve(normal + damping * np.eye(len(free)), gradient) / scale
            moved = params.copy()
            moved[free] += step
            try:
                candidate = Camera(model, moved, camera.width, camera.height)
            except InputError:  # a parameter left its range
                damping *= 10
                continue
            new_cost, new_residual, new_valid = _cost(candidate, rays, pixels)
            if new_cost < cost:
                improved = True
                break
            damping *= 10
        if not improved:
            break
        gain = cost - new_cost
        params, lens, cost, residual, valid = moved, candidate, new_cost, new_residual, new_valid
        damping = max(damping / 10, 1e-12)
        if gain <= 1e-12 * cost:
            break
    return params, cost


def _cost(
    lens: Camera, rays: np.ndarray, pixels: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Sum of squares, with a ray that the lens does not see at the image's own size."""
    found, valid = lens.project(rays)
    residual = np.where(valid[:, None], pixels - np.nan_to_num(found), 0.0)
    unseen = float(lens.width**2 + lens.height**2)
    return float((residual**2).sum() + unseen * (~valid).sum()), residual, valid


def run_convert(arguments: argparse.Namespace) -> int:
    """`gsut camera convert`: reads, fits, prints the error by field angle, writes."""
    camera = load_camera(arguments.lens, camera_id=arguments.camera_id)
    limit = None if arguments.max_angle is None else math.radians(arguments.max_angle)
    conversion = convert_camera(camera, arguments.model, limit, arguments.num_params)
    print(f"{camera.model} -> {conversion.camera.model}, {camera.width} x {camera.height}")
    print(format_conversion(conversion))
    if arguments.out is not None:
        conversion.camera.save(arguments.out)
        print(f"wrote {arguments.out}")
    return 0
