"""What pixels say about a pose: residuals, slopes, and the covariance by leaving out blocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut._core import Shutter, SolveError

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
POSE = 6  # unknowns of a pose: centre (world axes), rotation vector (camera axes)
# Colour difference beyond which a pixel counts less (Huber).
LOSS_SCALE = 0.1


@dataclasses.dataclass(frozen=True)
class PixelRows:
    """Residuals and slopes of N pixels at a solution.

    Attributes:
        pixels: (N,) row-major indices in an image of `width` columns and `height` rows.
        residuals: (N, 3) gain x render + bias - photograph.
        weights: (N,) of a robust loss.
        by_pose: (N, 3, 6). by_gain: (N, 3, 2); of no columns where gain and bias are held.
        by_motion: (N, 3, 6) under a rolling shutter, where measured; None: by the lines' times.
    """

    pixels: np.ndarray
    width: int
    height: int
    residuals: np.ndarray
    weights: np.ndarray
    by_pose: np.ndarray
    by_gain: np.ndarray
    by_motion: np.ndarray | None = None

    def stack_slopes(self, shutter: Shutter | None) -> np.ndarray:
        """Returns (N, 3, K) slopes by pose, by motion unless the shutter is global, and by gain."""
        parts = [self.by_pose]
        if shutter is not None and not shutter.is_global:
            moved = self.by_motion
            if moved is None:
                times = find_line_times(shutter, self.pixels, self.width, self.height)
                moved = times[:, None, None] * self.by_pose
            parts.append(moved)
        return np.concatenate([*parts, self.by_gain], axis=2)


def find_line_times(shutter: Shutter, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Returns (N,) times at which the lines of pixels are read, -0.5 to 0.5 of the readout."""
    rows, columns = np.divmod(pixels.astype(np.int64), width)
    is_row = shutter.direction in ("top_to_bottom", "bottom_to_top")
    share = (rows + 0.5) / height if is_row else (columns + 0.5) / width
    sign = 1.0 if shutter.direction in ("top_to_bottom", "left_to_right") else -1.0
    return sign * (share - 0.5)


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
    matrix, right = weigh_equations(rows, slopes)
    both = np.column_stack([matrix, right]).reshape(len(slopes), 3, size + 1)
    covariance = np.zeros((size, size))
    for blocks in sizes:
        block, count = _number_blocks(rows, blocks)
        ends = np.cumsum(np.bincount(block, minlength=count))[:-1]
        parts = np.split(both[np.argsort(block, kind="stable")], ends)
        flat = [part.reshape(-1, size + 1) for part in parts]
        products = np.stack([part.T @ part for part in flat])
        normals, rights = products[:, :size, :size], products[:, :size, size]
        normal = normals.sum(axis=0)
        diagonal = np.diag(normal)
        if not (diagonal > 0).all():
            raise report_undetermined()
        scale = 1 / np.sqrt(diagonal)
        units = np.outer(scale, scale)
        if not np.linalg.eigvalsh(normal * units)[0] > _SINGULAR:
            raise report_undetermined()
        others = (normal - _LEFT_OUT * normals) * units
        moved = scale * np.linalg.solve(others, (scale * rights)[:, :, None])[:, :, 0]
        covariance += (count - 1) / count * moved.T @ moved
    if not np.linalg.eigvalsh(covariance / units)[0] > 0:
        raise report_undetermined()
    return covariance


def weigh_equations(rows: PixelRows, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns slopes (3 N, K) and residuals (3 N,), both times the root of their pixel's weight."""
    root = np.sqrt(rows.weights)[:, None]
    return (root[:, :, None] * slopes).reshape(-1, slopes.shape[2]), (root * rows.residuals).ravel()


def estimate_step(rows: PixelRows, slopes: np.ndarray) -> np.ndarray:
    """Returns (K,) the step of Gauss-Newton by these slopes (N, 3, K)."""
    matrix, right = weigh_equations(rows, slopes)
    return -np.linalg.solve(matrix.T @ matrix, matrix.T @ right)


def estimate_sum_error(rows: PixelRows, values: np.ndarray) -> float:
    """Estimates the standard deviation of the sum of values (N,) of pixels, by blocks of noise."""
    block, count = _number_blocks(rows, *NOISE_BLOCKS)
    return float(np.sqrt(count) * np.std(np.bincount(block, values, count), ddof=1))


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


def compute_losses(residuals: np.ndarray) -> np.ndarray:
    """Computes Huber's loss (N,) of colour differences (N, 3)."""
    length = np.linalg.norm(residuals, axis=1)
    inner = np.minimum(length, LOSS_SCALE)
    return inner * (2 * length - inner)


def report_undetermined() -> SolveError:
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
