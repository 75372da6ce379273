"""Refines a pose, and the camera's motion during the readout, by differences of whole renders.

A trained scene holds Gaussians narrower than a pixel. They dominate the derivatives of colours,
which then say how a picture changes over a hundredth of a pixel, not over the error of a pose: a
solver that uses them stops early, and its normal equations are far too sure. Differences of renders
a fraction of a pixel apart show the change that counts, also under a rolling shutter, whose lines
move together with the pose in the middle of the readout.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import Camera, CameraMotion, Shutter, SolveError, moved_pose
from gsut.gaussians import Gaussians
from gsut.least_squares import minimize_least_squares
from gsut.render import render

# Pixels that a picture shifts by on either side of a difference, in the solver's first steps: about
# what a pose is still off by, so that the slopes are those of the way that is left. Each takes a
# pair of renders in six directions; further steps keep the last slopes.
_SHIFTS = (0.5, 0.25, 0.15)
# Colour difference beyond which a pixel counts less (Huber).
_LOSS_SCALE = 0.1
# Steps of the solver at most.
_STEPS = 12
# Share of the cost by which a step must lower it to be followed by another.
_LEAST_GAIN = 1e-6
# Factor by which the damping rises after a worse step, which costs a render.
_RISE = 10.0
# Damping whose step is far shorter than what the slopes are taken over.
_MOST_DAMPING = 1.0
# Blocks of the jackknife along the image's longer side: noise is shared by no larger ones.
NOISE_BLOCKS = (16,)
# The same for errors of a scene, which are small where many photographs agree and as large as an
# object where few do: the sum over these sizes.
SCENE_BLOCKS = (16, 8, 4)
# Blocks with pixels for each along the longer side, at least: else they are halved.
_FEWEST_BLOCKS = 2
# Share of a block that the jackknife leaves out: not all, so that a direction that only this block
# determines is not divided by zero.
_LEFT_OUT = 0.99
# Reciprocal condition of the normal equations, scaled to a diagonal of ones, below which a
# direction counts as undetermined.
_SINGULAR = 1e-12
# Alpha from which a rendered distance is that of a surface.
_OPAQUE = 0.5
POSE = 6  # unknowns of a pose: centre (world axes), rotation vector (camera axes)


@dataclasses.dataclass(frozen=True)
class SecantPose:
    """A pose from a photograph's colours, and what they say about it.

    Attributes:
        camera_from_world: (4, 4), in the middle of the readout.
        motion: (6,) from the start of the readout to its end: how far the centre moves (world axes)
            and the camera turns (rotation vector, camera axes); zeros for a global shutter.
        gain: gain and bias of the photograph's brightness.
        rms: root mean square of the remaining colour differences, per channel.
        converged: whether the last step no longer improved.
        rows: what the pixels say there.
    """

    camera_from_world: np.ndarray
    motion: np.ndarray
    gain: tuple[float, float]
    rms: float
    converged: bool
    rows: PixelRows


@dataclasses.dataclass(frozen=True)
class PixelRows:
    """Residuals and slopes of N pixels at a solution.

    Attributes:
        pixels: (N,) row-major indices in an image of `width` columns and `height` rows.
        residuals: (N, 3) gain x render + bias - photograph.
        weights: (N,) of a robust loss.
        by_pose: (N, 3, 6). by_gain: (N, 3, 2); of no columns where gain and bias are held.
    """

    pixels: np.ndarray
    width: int
    height: int
    residuals: np.ndarray
    weights: np.ndarray
    by_pose: np.ndarray
    by_gain: np.ndarray

    def stack_slopes(self, shutter: Shutter | None) -> np.ndarray:
        """Returns (N, 3, K) slopes by pose, by motion unless the shutter is global, and by gain."""
        parts = [self.by_pose]
        if shutter is not None and not shutter.is_global:
            times = find_line_times(shutter, self.pixels, self.width, self.height)
            parts.append(times[:, None, None] * self.by_pose)
        return np.concatenate([*parts, self.by_gain], axis=2)


def refine_by_secants(
    gaussians: Gaussians,
    camera: Camera,
    start: np.ndarray,
    pixels: np.ndarray,
    colors: np.ndarray,
    *,
    shutter: Shutter | None = None,
    motion: np.ndarray | None = None,
    gain: tuple[float, float] = (1.0, 0.0),
    background: Sequence[float] = (0.0, 0.0, 0.0),
    with_gain: bool = True,
) -> SecantPose:
    """Refines a pose that is off by less than a pixel or so, and with a shutter the motion.

    Args:
        gaussians: the scene. camera: the photograph's lens.
        start: (4, 4) camera_from_world in the middle of the readout.
        pixels: (N,) row-major indices of the pixels that are compared.
        colors: (N, 3) of the photograph there, 0 to 1.
        shutter: how the lines are read; None or global: all at once.
        motion: (6,) start, see `SecantPose`; None: zeros.
        gain: gain and bias to start from. with_gain: estimate both.

    Raises:
        SolveError: the photograph does not determine the pose.
    """
    moves = shutter is not None and not shutter.is_global
    unit = _measure_units(gaussians, camera, start)
    first = np.concatenate([np.zeros(POSE), np.zeros(POSE) if motion is None else motion, gain])
    num_gain = 2 if with_gain else 0
    free = np.r_[: 2 * POSE if moves else POSE, 2 * POSE : 2 * POSE + num_gain]

    def draw(pose: np.ndarray, moved: np.ndarray) -> np.ndarray:
        where = place_lines(pose, moved, shutter)
        image = render(gaussians, camera, where, background=background).image
        return image.reshape(-1, 3)[pixels].astype(np.float64)

    drawn: dict[bytes, np.ndarray] = {}  # by the unknowns: the solver comes back to the best

    def compare(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen = drawn.get(at.tobytes())
        if seen is None:
            seen = drawn[at.tobytes()] = draw(
                moved_pose(start, at[:POSE], 1.0), at[POSE : 2 * POSE]
            )
        return seen, at[-2] * seen + at[-1] - colors

    def compute_cost(unknowns: np.ndarray) -> float:
        at = first.copy()
        at[free] = unknowns
        length = np.linalg.norm(compare(at)[1], axis=1)
        inner = np.minimum(length, _LOSS_SCALE)
        return float(np.sum(inner * (2 * length - inner)))

    slopes: list[np.ndarray] = []  # (N, 3, 6) by the pose, of one step after the other

    def list_rows(unknowns: np.ndarray, is_last: bool = False) -> PixelRows:
        at = first.copy()
        at[free] = unknowns
        pose, moved = moved_pose(start, at[:POSE], 1.0), at[POSE : 2 * POSE]
        if len(slopes) < len(_SHIFTS) and not is_last:
            steps = _SHIFTS[len(slopes)] * unit
            slopes.append(_measure_slopes(lambda near: draw(near, moved), pose, steps))
        seen, residuals = compare(at)
        length = np.linalg.norm(residuals, axis=1)
        weights = _LOSS_SCALE / np.maximum(length, _LOSS_SCALE)
        by_gain = np.stack([seen, np.ones_like(seen)], axis=2)[:, :, :num_gain]
        return PixelRows(
            pixels, camera.width, camera.height, residuals, weights, at[-2] * slopes[-1], by_gain
        )

    steps = 0

    def make_normal_equations(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal steps
        steps += 1
        rows = list_rows(unknowns)
        weighted = np.sqrt(rows.weights)[:, None, None] * rows.stack_slopes(shutter)
        matrix = weighted.reshape(-1, len(free))
        right = (np.sqrt(rows.weights)[:, None] * rows.residuals).ravel()
        return matrix.T @ right, matrix.T @ matrix

    unknowns, _ = minimize_least_squares(
        first[free], compute_cost, make_normal_equations,
        max_steps=_STEPS, least_gain=_LEAST_GAIN, rise=_RISE, most_damping=_MOST_DAMPING,
    )  # fmt: skip
    rows = list_rows(unknowns, is_last=True)
    at = first.copy()
    at[free] = unknowns
    return SecantPose(
        moved_pose(start, at[:POSE], 1.0), at[POSE : 2 * POSE], (float(at[-2]), float(at[-1])),
        float(np.sqrt(np.mean(rows.residuals**2))), steps < _STEPS, rows,
    )  # fmt: skip


def _measure_slopes(
    draw: Callable[[np.ndarray], np.ndarray], pose: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Returns (N, 3, 6) slopes of the colours that `draw` gives, over steps (6,) either way."""
    columns = []
    for change in np.diag(steps):
        sides = [draw(moved_pose(pose, sign * change, 1.0)) for sign in (1.0, -1.0)]
        columns.append(sides[0] - sides[1])
    return np.stack(columns, axis=2) / (2 * steps)


def place_lines(
    pose: np.ndarray, motion: np.ndarray, shutter: Shutter | None
) -> np.ndarray | CameraMotion:
    """Returns what `render` takes for a middle pose and the motion during the readout."""
    if shutter is None or shutter.is_global:
        return pose
    start, end = (moved_pose(pose, motion, share) for share in (-0.5, 0.5))
    return CameraMotion(start, end, shutter)


def find_line_times(shutter: Shutter, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Returns (N,) times at which the lines of pixels are read, -0.5 to 0.5 of the readout."""
    rows, columns = np.divmod(pixels.astype(np.int64), width)
    is_row = shutter.direction in ("top_to_bottom", "bottom_to_top")
    share = (rows + 0.5) / height if is_row else (columns + 0.5) / width
    sign = 1.0 if shutter.direction in ("top_to_bottom", "left_to_right") else -1.0
    return sign * (share - 0.5)


def _measure_units(gaussians: Gaussians, camera: Camera, pose: np.ndarray) -> np.ndarray:
    """Measures (6,) how far the centre moves, and the camera turns, for a pixel on the axis."""
    seen = render(gaussians, camera, pose)
    opaque = seen.alpha > _OPAQUE
    distance = 1.0
    if opaque.any():
        # Parallax is that of the mean inverse distance.
        distance = 1.0 / float(np.mean(seen.alpha[opaque] / seen.depth[opaque]))
    return measure_pixel_angle(camera) * np.repeat([distance, 1.0], 3)


def measure_pixel_angle(camera: Camera) -> float:
    """Measures the median angle between the rays of neighbouring pixels, radians."""
    rays, valid = camera.rays()
    both = valid[:, 1:] & valid[:, :-1]
    apart = np.linalg.norm((rays[:, 1:] - rays[:, :-1])[both], axis=1)
    return float(np.median(apart)) if len(apart) else 1.0


def estimate_covariance(
    rows: PixelRows, slopes: np.ndarray, sizes: Sequence[int] = NOISE_BLOCKS
) -> np.ndarray:
    """Estimates the covariance of unknowns by leaving out one block of the image after the other.

    Pixels of a block may err together, and where few blocks determine a pose, residuals are
    smaller than errors, since each block has bent the pose towards itself (the jackknife, CR3 of
    Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
    samples", 2002).

    Args:
        rows: of the pixels. slopes: (N, 3, K) by the unknowns.
        sizes: how many blocks fit along the image's longer side. With several, the sum of the
            covariances that each size of blocks gives.

    Returns:
        (K, K).

    Raises:
        SolveError: the pixels do not determine the unknowns.
    """
    size = slopes.shape[2]
    weighted = rows.weights[:, None, None] * slopes
    products = np.einsum("nck,ncl->nkl", weighted, slopes).reshape(len(slopes), -1)
    right = np.einsum("nck,nc->nk", weighted, rows.residuals)
    normal = products.sum(axis=0).reshape(size, size)
    diagonal = np.diag(normal)
    if not (diagonal > 0).all():
        raise _report_undetermined()
    scale = 1 / np.sqrt(diagonal)
    units = np.outer(scale, scale)
    if not np.linalg.eigvalsh(normal * units)[0] > _SINGULAR:
        raise _report_undetermined()
    covariance = np.zeros((size, size))
    for blocks in sizes:
        block, count = _number_blocks(rows, blocks)
        normals = np.stack([np.bincount(block, p, count) for p in products.T], axis=1)
        others = (normal - _LEFT_OUT * normals.reshape(count, size, size)) * units
        rights = np.stack([np.bincount(block, r, count) for r in right.T], axis=1)
        moved = scale * np.linalg.solve(others, (scale * rights)[:, :, None])[:, :, 0]
        covariance += (count - 1) / count * moved.T @ moved
    return covariance


def estimate_step(rows: PixelRows, slopes: np.ndarray) -> np.ndarray:
    """Returns (K,) the step of Gauss-Newton by these slopes (N, 3, K)."""
    weighted = rows.weights[:, None, None] * slopes
    normal = np.einsum("nck,ncl->kl", weighted, slopes)
    return -np.linalg.solve(normal, np.einsum("nck,nc->k", weighted, rows.residuals))


def measure_unmodelled_motion(rows: PixelRows, shutter: Shutter) -> float:
    """Measures what motion during a readout the residuals of a global shutter still show.

    Returns:
        Its square by its covariance, per unknown: about 1 where there is none.
    """
    slopes = rows.stack_slopes(shutter)
    motion = slice(POSE, 2 * POSE)
    step = estimate_step(rows, slopes)[motion]
    return compute_square(step, estimate_covariance(rows, slopes)[motion, motion])


def compute_square(vector: np.ndarray, covariance: np.ndarray) -> float:
    """Returns the square of a vector by its covariance, per component."""
    return float(vector @ np.linalg.solve(covariance, vector)) / len(vector)


def _report_undetermined() -> SolveError:
    return SolveError("the photograph does not determine its pose: too little of it shows texture")


def _number_blocks(rows: PixelRows, blocks: int) -> tuple[np.ndarray, int]:
    """Returns the number of each pixel's block, (N,), and how many blocks there are."""
    y, x = np.divmod(rows.pixels.astype(np.int64), rows.width)
    side = -(-max(rows.width, rows.height) // blocks)
    while True:
        _, number = np.unique(y // side * rows.width + x // side, return_inverse=True)
        count = int(number.max()) + 1
        if count >= _FEWEST_BLOCKS * blocks or side == 1:
            return number, count
        side = (side + 1) // 2
