"""Refines the pose of a photograph taken in a known scene, from its colours."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gsut import _core
from gsut._core import BlendRule, InputError, Shutter
from gsut.bounds import name_wrong_kinds
from gsut.data.images import shrink_image, shrink_mask
from gsut.data.poses import find_centers
from gsut.gaussians import Gaussians, find_pixel_sizes
from gsut.lens import measure_pixel_angle
from gsut.refine.pixel_rows import NOISE_BLOCKS, POSE
from gsut.refine.secants import (
    MOST_ROUNDS,
    SecantPose,
    refine_by_secants,
)
from gsut.render import DEFAULT_UNSCENTED, PixelFilter, place_about

# Share of a lens' widest field angle within which pixels keep their rays while it is refined.
_INNER = 0.96
# Pixels along the shorter side of a photograph and of its coarsest image: fewer show no place.
SMALLEST_SIDE = 24
# Standard deviation of the filter that models the area of a coarse pixel, in such pixels.
PIXEL_BLUR = 0.3
# Sizes, the full one included, at which the motion during a readout is estimated: coarser images
# hardly show it.
LEVELS_WITH_MOTION = 3
# Pixels of a size by which its refinement moves a picture at most: what is farther outside is not
# drawn.
_MARGIN_PIXELS = 16
# Measurements of slopes at the smaller sizes: the next size does the rest.
_COARSE_ROUNDS = 2


@dataclasses.dataclass
class RefinedPose:
    """The pose of a photograph, and how well its colours determine it.

    Attributes:
        camera_from_world: (4, 4) rigid transform.
        covariance: (6, 6) of the camera's centre (world axes and units) and then of a rotation
            vector w (camera axes, radians; R <- exp(w) R), by leaving out one block of a sixteenth
            of the image after the other (jackknife: Bell and McCaffrey 2002), times the square of
            how much flatter the cost is than its slopes say. Errors that larger parts of the image
            share are not included; with them, errors of a pose are about twice as large.
        gain: the photograph is compared with gain x render + bias, the same for all channels.
        bias: added to the render after the gain; colours are in 0 ... 1.
        rms: root mean square of the remaining colour differences, per channel.
        converged: whether the finest level stopped because it no longer improved.
        shutter: how the lines were read, or None for all at once. The pose is that in the middle.
        motion: (6,) from the start of the readout to its end, how far the centre moves and the
            camera turns, axes as of the covariance; None without a shutter.
        motion_covariance: (6, 6) of the motion, or None.
    """

    camera_from_world: np.ndarray
    covariance: np.ndarray
    gain: float
    bias: float
    rms: float
    converged: bool
    shutter: Shutter | None = None
    motion: np.ndarray | None = None
    motion_covariance: np.ndarray | None = None

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


@name_wrong_kinds
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
    shutter: Shutter | None = None,
) -> RefinedPose:
    """Moves a camera until the render looks like the photograph.

    Runs Levenberg-Marquardt on the colours (Huber loss) from a coarse image to the full one. Each
    level halves the size, and the scene is low-pass filtered to match. The full image is refined by
    differences of renders, and under a rolling shutter so are the motion during the readout and the
    levels that show it. The start may be wrong by a few pixels of the coarsest image.

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
        shutter: rolling: each line has its own pose, and the camera's motion is estimated too;
            None or global: all lines are read at once.

    Returns:
        The pose, its covariance and how well the render then fits the photograph.

    Raises:
        InputError: shapes differ, no pixel counts, several poses, or a lens without one centre.
        SolveError: the photograph does not determine its pose.
    """
    if shutter is not None and shutter.is_global:
        shutter = None
    pose: Any = place_about(_require_one_pose(camera_from_world), gaussians.origin)
    pixels, valid = check_photograph(camera, image, mask)
    if levels < 1 or max_pixels < 3:
        raise InputError("levels must be at least 1 and max_pixels at least 3")
    if not camera.is_central:
        raise InputError(f"refine_pose needs a lens with one centre, found {camera.model}")
    found = refine_levels(
        gaussians, camera, pose, pixels, valid, background, with_gain, levels, max_pixels, shutter
    )
    return make_refined_pose(found, shutter, gaussians.origin)


def refine_levels(
    gaussians: Gaussians,
    camera: _core.Camera,
    pose: np.ndarray,
    pixels: np.ndarray,
    valid: np.ndarray,
    background: Sequence[float],
    with_gain: bool,
    levels: int,
    max_pixels: int,
    shutter: Shutter | None,
) -> SecantPose:
    """Refines a pose about the Gaussians' origin from a coarse image to the full one."""
    scene = gaussians.to_dtype(np.float32).translate(-gaussians.origin)
    photograph = Photograph(scene, camera, pixels, valid, tuple(background), max_pixels)
    first = 0 if shutter is None else min(levels, LEVELS_WITH_MOTION) - 1
    coarse = photograph.refine_coarsely(pose, range(first, levels), with_gain)
    return photograph.refine_finely(coarse, first, with_gain, shutter)


@dataclasses.dataclass(frozen=True)
class CoarsePose:
    """A pose from derivatives of colours, or to start from; see `RefinedPose`.

    Attributes:
        focal_change: logarithm of the factor on the focal length, where that was refined, too.
    """

    camera_from_world: np.ndarray
    gain: tuple[float, float] = (1.0, 0.0)
    rms: float = float("inf")
    converged: bool = False
    motion: np.ndarray | None = None
    focal_change: float = 0.0


class _Level(NamedTuple):
    """A photograph at one of its sizes: the scene filtered for it, lens, pixels and colours."""

    drawn: Gaussians
    lens: _core.Camera
    chosen: np.ndarray
    colors: np.ndarray


@dataclasses.dataclass(frozen=True)
class Photograph:
    """A photograph, see `check_photograph`, before a scene whose origin is zero.

    Attributes:
        sizes: of blocks by which errors are stated, see `estimate_covariance`.
    """

    scene: Gaussians
    camera: _core.Camera
    pixels: np.ndarray
    valid: np.ndarray
    background: tuple[float, ...]
    max_pixels: int
    sizes: Sequence[int] = NOISE_BLOCKS

    def shrink(
        self, level: int, pose: np.ndarray, motion: np.ndarray | None = None
    ) -> _Level | None:
        """Halves the photograph `level` times; None where that is too small or shows nothing.

        The scene is what the photograph may show from about `pose`, and during the motion (6,).

        Raises:
            InputError: the full photograph has no pixel that counts.
        """
        camera = self.camera
        size = [max(1, round(side / 2**level)) for side in (camera.width, camera.height)]
        if level > 0 and min(size) < SMALLEST_SIDE:
            return None
        lens = camera if level == 0 else camera.resize(*size)
        chosen = choose_pixels(shrink_mask(self.valid, *size) & lens.rays()[1], self.max_pixels)
        if len(chosen) == 0:
            if level > 0:
                return None
            raise InputError("the mask leaves no pixel that has a ray")
        rays, seen = lens.rays()
        moved = np.zeros(POSE) if motion is None else motion
        margin = _MARGIN_PIXELS * measure_pixel_angle(lens) + np.linalg.norm(moved[3:]) / 2
        drawn = self.scene.select_seen(
            find_centers(pose[None])[0], rays[seen] @ pose[:3, :3], float(margin),
            around=float(np.linalg.norm(moved[:3])) / 2,
        )  # fmt: skip
        if level > 0:
            sizes = find_pixel_sizes(drawn.means, [lens], pose[None])
            drawn = PixelFilter.widen_by(drawn, (PIXEL_BLUR * sizes) ** 2, pose)
        colors = shrink_image(self.pixels, *size).reshape(-1, 3)[chosen]
        return _Level(drawn, lens, chosen, np.ascontiguousarray(colors))

    def refine_coarsely(
        self, pose: np.ndarray, levels: range, with_gain: bool, with_focal_length: bool = False
    ) -> CoarsePose:
        """Refines a pose by derivatives of colours at these levels, or finer ones if none is.

        With the focal length, the first two parameters of the lens are refined, too.
        """
        found = CoarsePose(pose)
        for level in reversed(range(levels.stop)):
            if level < levels.start and np.isfinite(found.rms):
                break
            camera = self.camera
            if with_focal_length:
                camera = scale_focal_length(camera, found.focal_change)
            part = dataclasses.replace(self, camera=camera).shrink(level, found.camera_from_world)
            if part is None:
                continue
            params = np.array(part.lens.params)
            free = [[int(k < 2) for k in range(len(params))]] if with_focal_length else []
            solved = _core.refine_photometric(
                part.drawn, [part.lens],
                [(0, found.camera_from_world, part.chosen, part.colors)], BlendRule(),
                self.background, self.scene.sh_degree, DEFAULT_UNSCENTED,
                {"with_gain": with_gain, "lens_free": free},
            )  # fmt: skip
            change = found.focal_change
            if with_focal_length:
                new = np.array(solved["lens_params"][0])
                change += float(np.mean(np.log(new[:2] / params[:2])))
            found = CoarsePose(
                solved["camera_from_world"][0], solved["gains"][0], solved["rms_after"],
                bool(solved["converged"]), focal_change=change,
            )  # fmt: skip
        return found

    def refine_finely(
        self, coarse: CoarsePose, first: int, with_gain: bool, shutter: Shutter | None
    ) -> SecantPose:
        """Refines a pose by differences of renders from level `first` to the full size."""
        pose, gain, motion = coarse.camera_from_world, coarse.gain, coarse.motion
        for level in reversed(range(first + 1)):
            part = self.shrink(level, pose, motion)
            if part is None:
                continue
            fine = refine_by_secants(
                part.drawn, part.lens, pose, part.chosen, part.colors.astype(np.float64),
                shutter=shutter, motion=motion, gain=gain, background=self.background,
                with_gain=with_gain, rounds=_COARSE_ROUNDS if level else MOST_ROUNDS,
                sizes=self.sizes,
            )  # fmt: skip
            pose, gain, motion = fine.camera_from_world, fine.gain, fine.motion
        return fine


def scale_focal_length(camera: Any, change: float) -> Any:
    """Multiplies the first two parameters, fx and fy, by the exponential of `change`."""
    params = np.array(camera.params)
    params[:2] *= np.exp(change)
    return camera.with_params(params)


def make_refined_pose(
    found: SecantPose,
    shutter: Shutter | None,
    origin: np.ndarray,
    sizes: Sequence[int] = NOISE_BLOCKS,
) -> RefinedPose:
    """Makes a pose in the world, with its covariance, of one about the Gaussians' origin."""
    covariance = found.estimate_errors(shutter, sizes)
    moved: dict[str, Any] = {}
    if shutter is not None:
        moved = {
            "shutter": shutter,
            "motion": found.motion,
            "motion_covariance": covariance[POSE : 2 * POSE, POSE : 2 * POSE],
        }
    pose: Any = place_about(found.camera_from_world, -origin)
    return RefinedPose(
        pose, covariance[:POSE, :POSE], *found.gain, found.rms, found.converged, **moved
    )


def _require_one_pose(camera_from_world: Any) -> np.ndarray:
    matrix = getattr(camera_from_world, "matrix", camera_from_world)
    if isinstance(matrix, _core.CameraMotion) or np.shape(matrix) != (4, 4):
        raise InputError(
            "camera_from_world must be one pose (4, 4), with a rolling shutter that in the middle "
            "of the readout: give the shutter as shutter=, its motion is estimated"
        )
    return _core.checked_pose(matrix)


def check_photograph(
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
