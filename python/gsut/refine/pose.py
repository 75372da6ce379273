"""Refines the pose of a photograph taken in a known scene, from its colours."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import BlendRule, InputError
from gsut.data.images import shrink_image, shrink_mask
from gsut.gaussians import Gaussians, apply_low_pass, find_filter_radii
from gsut.render import DEFAULT_UNSCENTED, place_about

# Pixels along the shorter side of the coarsest image, at least: fewer show no shapes.
_SMALLEST_SIDE = 24
# Share of a lens' widest field angle within which pixels keep their rays while it is refined.
_INNER = 0.96
# Standard deviation of the filter that models the area of a coarse pixel, in such pixels.
_PIXEL_BLUR = 0.3


@dataclasses.dataclass
class RefinedPose:
    """The pose of a photograph, and how well its colours determine it.

    Attributes:
        camera_from_world: (4, 4) rigid transform.
        covariance: (6, 6) of the camera's centre (world axes and units) and then of a rotation
            vector w (camera axes, radians; R <- exp(w) R), by leaving out one block of a sixteenth
            of the image after the other (jackknife: Bell and McCaffrey 2002). Errors of the scene
            itself are not included; with them, errors of a pose are about twice as large.
        gain: the photograph is compared with gain x render + bias, the same for all channels.
        bias: added to the render after the gain; colours are in 0 ... 1.
        rms: root mean square of the remaining colour differences, per channel.
        converged: whether the finest level stopped because it no longer improved.
    """

    camera_from_world: np.ndarray
    covariance: np.ndarray
    gain: float
    bias: float
    rms: float
    converged: bool

    def __repr__(self) -> str:
        at = ", ".join(f"{value:.4g}" for value in self.center)
        state = "converged" if self.converged else "not converged"
        return f"RefinedPose(at ({at}), rms {self.rms:.4f}, {state})"

    @property
    def center(self) -> np.ndarray:
        """(3,) camera centre in the world, scene units."""
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    @property
    def center_std(self) -> np.ndarray:
        """The (3,) standard deviations of the centre, world axes, scene units."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def rotation_std(self) -> np.ndarray:
        """The (3,) standard deviations of the rotation about the camera's axes, degrees."""
        return np.degrees(np.sqrt(np.diag(self.covariance)[3:]))


def refine_pose(
    gaussians: Gaussians,
    camera: _core.Camera,
    camera_from_world: Any,
    image: np.ndarray,
    mask: np.ndarray | None = None,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    with_gain: bool = True,
    levels: int = 4,
    max_pixels: int = 20_000,
) -> RefinedPose:
    """Moves a camera until the render looks like the photograph.

    Runs Levenberg-Marquardt on the colours (Huber loss) from a coarse image to the full one. Each
    level halves the size, and the scene is low-pass filtered to match. The start may be wrong by a
    few pixels of the coarsest image.

    Args:
        gaussians: the scene; not changed.
        camera: lens with one centre, and image size; not changed.
        camera_from_world: (4, 4) start, or an object with such a `matrix`.
        image: (H, W, 3) photograph: uint8, or floats in 0 ... 1.
        mask: (H, W) bool, False where the photograph does not count.
        background: colour behind everything.
        with_gain: also estimate a gain and a bias of the photograph's brightness.
        levels: number of sizes at most, including the full one; sides keep 24 pixels or more.
        max_pixels: most pixels compared at each size, sampled uniformly with a fixed seed.

    Returns:
        The pose, its covariance and how well the render then fits the photograph.

    Raises:
        InputError: shapes differ, no pixel counts, a rolling shutter, or a lens without one centre.
        SolveError: the photograph does not determine its pose.
    """
    pose: Any = place_about(_require_one_pose(camera_from_world), gaussians.origin)
    pixels, valid = _check_photograph(camera, image, mask)
    if levels < 1 or max_pixels < 3:
        raise InputError("levels must be at least 1 and max_pixels at least 3")
    if not camera.is_central:
        raise InputError(f"refine_pose needs a lens with one centre, found {camera.model}")
    color = tuple(float(c) for c in background)
    scene = gaussians.to_dtype(np.float32)
    gain = (1.0, 0.0)
    found: dict[str, Any] = {}
    for level in reversed(range(levels)):
        size = [max(1, round(side / 2**level)) for side in (camera.width, camera.height)]
        if level > 0 and min(size) < _SMALLEST_SIDE:
            continue
        lens = camera if level == 0 else camera.resize(*size)
        seen = shrink_mask(valid, *size) & lens.rays()[1]
        chosen = choose_pixels(seen, max_pixels)
        if len(chosen) == 0:
            if level > 0:
                continue
            raise InputError("the mask leaves no pixel that has a ray")
        drawn = scene
        if level > 0:
            drawn = apply_low_pass(
                scene, find_filter_radii(scene.means, [lens], pose[None], _PIXEL_BLUR)
            )
        colors = shrink_image(pixels, *size).reshape(-1, 3)[chosen]
        found = _core.refine_photometric(
            drawn, [lens], [(0, pose, chosen, np.ascontiguousarray(colors))], BlendRule(), color,
            gaussians.sh_degree, DEFAULT_UNSCENTED,
            {"with_gain": with_gain, "covariances": level == 0},
        )  # fmt: skip
        pose, gain = found["camera_from_world"][0], found["gains"][0]
    pose = place_about(pose, -gaussians.origin)
    return RefinedPose(
        pose, found["covariances"][0], *gain, found["rms_after"], bool(found["converged"])
    )


def _require_one_pose(camera_from_world: Any) -> np.ndarray:
    matrix = getattr(camera_from_world, "matrix", camera_from_world)
    if isinstance(matrix, _core.CameraMotion) or np.shape(matrix) != (4, 4):
        raise InputError(
            "camera_from_world must be one pose (4, 4): refine_pose is for a global shutter; a "
            "rolling shutter's motion is not refined"
        )
    return _core.checked_pose(matrix)


def _check_photograph(
    camera: _core.Camera, image: np.ndarray, mask: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Returns colours (H, W, 3) float32 in 0 ... 1 and a mask (H, W) of the pixels that count."""
    size = (camera.height, camera.width)
    image = _core.read_array(image, "image")
    if image.shape != (*size, 3):
        raise InputError(f"image must have shape {(*size, 3)}, the camera's, found {image.shape}")
    scale = 255.0 if image.dtype == np.uint8 else 1.0
    pixels = (image / np.float32(scale)).astype(np.float32)
    valid = np.ones(size, bool) if mask is None else _core.read_array(mask, "mask") != 0
    if valid.shape != size:
        raise InputError(f"mask must have shape {size}, the camera's, found {valid.shape}")
    valid = valid & camera.rays()[1]
    if not np.isfinite(pixels[valid]).all():
        raise InputError("image has values that are not finite where the mask lets it count")
    return np.where(valid[:, :, None], pixels, np.float32(0)), valid


def choose_pixels(seen: np.ndarray, count: int, seed: Any = 0) -> np.ndarray:
    """Chooses at most `count` of the pixels that are True, at random.

    Args:
        seen: (H, W) bool.
        count: most pixels to choose.
        seed: of numpy's generator: a number or several.

    Returns:
        Row-major indices, uint32, rising.
    """
    indices = np.flatnonzero(seen).astype(np.uint32)
    if len(indices) > count:
        indices = np.sort(np.random.default_rng(seed).choice(indices, count, replace=False))
    return indices


def select_inner_pixels(camera: _core.Camera) -> np.ndarray:
    """Returns (H, W) bool: pixels that keep a ray if the lens changes by a few percent."""
    rays, valid = camera.rays()
    angles = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    widest = float(np.max(angles[valid], initial=0.0))
    with np.errstate(invalid="ignore"):
        return valid & (angles <= _INNER * widest)
