"""Refines a pose, and the camera's motion during the readout, by differences of whole renders.

A trained scene holds Gaussians narrower than a pixel. They dominate the derivatives of colours,
which then say how a picture changes over a hundredth of a pixel, not over the error of a pose: a
solver that uses them stops early, and its normal equations are far too sure. Differences of renders
a fraction of a pixel apart show the change that counts, also under a rolling shutter, whose lines
move together with the pose in the middle of the readout. The renders come closer together as the
pose does to its solution: differences over more than its error miss the bottom of the valley.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsut._core import Camera, CameraMotion, Renderer, RenderJob, Shutter, moved_pose
from gsut.gaussians import OPAQUE, Gaussians
from gsut.least_squares import minimize_least_squares
from gsut.lens import measure_pixel_angle
from gsut.refine.pixel_rows import (
    LOSS_SCALE,
    NOISE_BLOCKS,
    POSE,
    SCENE_BLOCKS,
    PixelRows,
    compute_losses,
    compute_square,
    estimate_covariance,
    find_line_times,
    report_undetermined,
    weigh_equations,
)
from gsut.render import DEFAULT_UNSCENTED, render

# Pixels that a picture shifts by on either side of a difference, at first: about what a pose is
# still off by. Six directions take a pair of renders each.
_FIRST_SHIFT = 0.5
# Least shift of the slopes by which errors are stated: over less, a pose seems surer than it is.
_STATED_SHIFT = 0.25
# The least shift: pictures of good scenes determine a pose to this.
_FINEST_SHIFT = 0.02
# Shift up to which differences are taken on both sides of a pose at the full size, and not ahead of
# it only, which takes half the renders: the steps before only bring the pose near.
_BOTH_SIDES = 0.25
# Shifts of one round over that of the round before, at most.
_SHRINK = 0.5
# Shift over what the pose moved by in the round before: about the error that is left.
_SHIFT_BY_MOVE = 0.5
# Square of a move by the covariance, per unknown, below which a pose has settled.
_SETTLED = 0.1
# Measurements of the slopes at most; a few suffice.
MOST_ROUNDS = 8
# Least curvature of the cost over that of the slopes: a flatter cost bounds no error.
_LEAST_CURVATURE = 0.01
# Measurements of the cost about a pose at most, each of which moves it to the middle of its valley.
_MOST_ENDS = 4
# The farthest that the cost on both sides is followed, in distances of these sides.
_MOST_AHEAD = 2.0
# Steps between two measurements of slopes at most; each corrects the slopes by what it changed.
_STEPS = 4
# Share of the cost by which a step must lower it to be followed by another with these slopes.
_LEAST_GAIN = 0.01
# Factor by which the damping rises after a worse step, which costs a render.
_RISE = 10.0
# Damping whose step is far shorter than what the slopes are taken over.
_MOST_DAMPING = 1.0


@dataclasses.dataclass(frozen=True)
class SecantPose:
    """A pose from a photograph's colours, and what they say about it.

    Attributes:
        camera_from_world: (4, 4), in the middle of the readout.
        motion: (6,) from the start of the readout to its end: how far the centre moves (world axes)
            and the camera turns (rotation vector, camera axes); zeros for a global shutter.
        gain: gain and bias of the photograph's brightness.
        rms: root mean square of the remaining colour differences, per channel.
        converged: whether the last steps moved the pose by less than noise does, or no step lowered
            the cost.
        rows: what the pixels say there.
        looseness: (6, 6), or (12, 12) with the motion: maps errors of a cost that curves as the
            slopes say to those of the cost itself, see `refine_by_secants`.
    """

    camera_from_world: np.ndarray
    motion: np.ndarray
    gain: tuple[float, float]
    rms: float
    converged: bool
    rows: PixelRows
    looseness: np.ndarray

    def estimate_errors(self, shutter: Shutter | None, sizes: Sequence[int]) -> np.ndarray:
        """Estimates the covariance (6, 6) of the pose, or (12, 12) with the motion.

        Args:
            shutter: with which the pose was refined. sizes: of blocks, see `estimate_covariance`.
        """
        slopes = self.rows.stack_slopes(shutter)
        size = len(self.looseness)
        covariance = estimate_covariance(self.rows, slopes, sizes)[:size, :size]
        return self.looseness @ covariance @ self.looseness.T


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
    rounds: int = MOST_ROUNDS,
    sizes: Sequence[int] = NOISE_BLOCKS,
) -> SecantPose:
    """Refines a pose that is off by less than a pixel or so, and with a shutter the motion.

    Between two measurements, the slopes of each pixel follow the change that a step has brought
    (Broyden, "A class of methods for solving nonlinear simultaneous equations", 1965).

    Errors are stated by slopes over the errors themselves, and by the curvature of the cost (Huber,
    "The behavior of maximum likelihood estimates under nonstandard conditions", 1967): where a
    scene errs, what is left over follows the pose, and the cost is flatter than its slopes say. In
    so flat a valley steps by slopes end early. Costs on both sides of the pose along the principal
    axes of its errors show where the middle is, and the pose moves there.

    Args:
        gaussians: the scene. camera: the photograph's lens.
        start: (4, 4) camera_from_world in the middle of the readout.
        pixels: (N,) row-major indices of the pixels that are compared.
        colors: (N, 3) of the photograph there, 0 to 1.
        shutter: how the lines are read; None or global: all at once.
        motion: (6,) start, see `SecantPose`; None: zeros.
        gain: gain and bias to start from. with_gain: estimate both.
        rounds: measurements of the slopes at most. With fewer than `MOST_ROUNDS` the pose is only a
            start for a larger image, and `rows` has the slopes of the last round, not those by
            which errors are stated.
        sizes: of blocks by which errors are stated: the pose need not be nearer to the middle.

    Raises:
        SolveError: the photograph does not determine the pose.
    """
    problem = _Problem(
        gaussians, camera, start, pixels, colors, shutter, background, with_gain,
        _measure_units(gaussians, camera, start),
    )  # fmt: skip
    at = np.concatenate([np.zeros(POSE), np.zeros(POSE) if motion is None else motion, gain])
    shift, settled, cost = _FIRST_SHIFT, False, np.inf
    for _ in range(rounds):
        both_sides = rounds >= MOST_ROUNDS and shift <= _BOTH_SIDES
        found, rows = problem.run_round(at, shift, both_sides)
        moved = (found - at)[problem.free]
        noise = estimate_covariance(rows, rows.stack_slopes(shutter))
        left = _compute_loss(rows.residuals)
        settled = compute_square(moved, noise) < _SETTLED or left >= (1 - _LEAST_GAIN) * cost
        at, cost = found, left
        if settled and shift <= _BOTH_SIDES:
            break
        pixels_moved = float(np.max(np.abs(moved[:POSE] / problem.unit)))
        shift = max(_FINEST_SHIFT, min(_SHRINK * shift, _SHIFT_BY_MOVE * pixels_moved))
    looseness = np.eye(2 * POSE if problem.is_rolling else POSE)
    for _ in range(_MOST_ENDS if rounds >= MOST_ROUNDS else 0):
        rows, looseness, step = problem.look_along_axes(at, rows)
        lower = problem.find_lower(at, step)
        if lower is None:
            settled = True
            break
        at, moved = lower, (lower - at)[problem.free]
        rows = dataclasses.replace(rows, residuals=problem.compare(at))
        spread = np.eye(len(moved))
        spread[: problem.moving, : problem.moving] = looseness
        errors = spread @ estimate_covariance(rows, rows.stack_slopes(shutter), sizes) @ spread.T
        settled = compute_square(moved, errors) < _SETTLED
        if settled:
            break
    return SecantPose(
        problem.place_pose(at), at[POSE : 2 * POSE], (float(at[-2]), float(at[-1])),
        float(np.sqrt(np.mean(rows.residuals**2))), settled, rows, looseness,
    )  # fmt: skip


@dataclasses.dataclass
class _Problem:
    """The pixels of a photograph as functions of pose, motion, gain and bias (14 unknowns).

    Attributes:
        unit: (6,) steps of the pose that move the picture by about a pixel.
        slopes: (N, 3, 6) of the render by the pose, where it was drawn last.
    """

    gaussians: Gaussians
    camera: Camera
    start: np.ndarray
    pixels: np.ndarray
    colors: np.ndarray
    shutter: Shutter | None
    background: Sequence[float]
    with_gain: bool
    unit: np.ndarray

    def __post_init__(self) -> None:
        self.is_rolling = self.shutter is not None and not self.shutter.is_global
        self.moving = 2 * POSE if self.is_rolling else POSE  # unknowns beside the gain
        self.free = np.r_[: self.moving, 2 * POSE : 2 * POSE + 2 * self.with_gain]
        self.times = np.zeros(len(self.pixels))
        if self.shutter is not None and self.is_rolling:
            size = self.camera.width, self.camera.height
            self.times = find_line_times(self.shutter, self.pixels, *size)
        self._drawn: dict[bytes, np.ndarray] = {}  # by the pose: the solver comes back to the best
        self._renderer = Renderer()
        self._image = np.zeros((self.camera.height, self.camera.width, 3), np.float32)

    def place_pose(self, at: np.ndarray) -> np.ndarray:
        """Returns (4, 4) the pose in the middle of the readout."""
        return moved_pose(self.start, at[:POSE], 1.0)

    def _draw(self, pose: np.ndarray, moved: np.ndarray) -> np.ndarray:
        job = RenderJob(
            self.camera, place_lines(pose, moved, self.shutter), background=self.background,
            sh_degree=self.gaussians.sh_degree, unscented=DEFAULT_UNSCENTED, keep=False,
        )  # fmt: skip
        self._renderer.render(self.gaussians, job, self._image)
        return self._image.reshape(-1, 3)[self.pixels].astype(np.float64)

    def _draw_at(self, at: np.ndarray) -> np.ndarray:
        key = at[: 2 * POSE].tobytes()
        if key not in self._drawn:
            self._drawn[key] = self._draw(self.place_pose(at), at[POSE : 2 * POSE])
        return self._drawn[key]

    def compare(self, at: np.ndarray) -> np.ndarray:
        return at[-2] * self._draw_at(at) + at[-1] - self.colors

    def _follow_step(self, slopes: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Corrects slopes (N, 3, 6) so that they give the change of colours of a step."""
        step = (after - before)[: 2 * POSE].reshape(2, POSE) / self.unit
        by_pixel = step[0] + self.times[:, None] * step[1]
        change = self._draw_at(after) - self._draw_at(before)
        missing = change - np.einsum("nck,nk->nc", slopes, by_pixel * self.unit)
        square = np.maximum(np.sum(by_pixel**2, axis=1), np.finfo(float).tiny)
        return slopes + missing[:, :, None] * (by_pixel / square[:, None] / self.unit)[:, None, :]

    def measure_slopes(self, at: np.ndarray, shift: float, both_sides: bool) -> np.ndarray:
        """Measures (N, 3, 6) slopes by the pose over this many pixels ahead, or on both sides."""
        pose, motion, columns = self.place_pose(at), at[POSE : 2 * POSE], []
        for change in np.diag(shift * self.unit):
            ahead = self._draw(moved_pose(pose, change, 1.0), motion)
            if both_sides:
                columns.append((ahead - self._draw(moved_pose(pose, -change, 1.0), motion)) / 2)
            else:
                columns.append(ahead - self._draw_at(at))
        return np.stack(columns, axis=2) / (shift * self.unit)

    def list_rows(self, at: np.ndarray, slopes: np.ndarray) -> PixelRows:
        """Returns residuals at these unknowns with these slopes of the render."""
        seen, residuals = self._draw_at(at), self.compare(at)
        weights = LOSS_SCALE / np.maximum(np.linalg.norm(residuals, axis=1), LOSS_SCALE)
        by_gain = np.stack([seen, np.ones_like(seen)], axis=2)[:, :, : 2 * self.with_gain]
        return PixelRows(
            self.pixels, self.camera.width, self.camera.height, residuals, weights,
            at[-2] * slopes, by_gain,
        )  # fmt: skip

    def run_round(
        self, first: np.ndarray, shift: float, both_sides: bool
    ) -> tuple[np.ndarray, PixelRows]:
        """Takes some steps with slopes of `measure_slopes`; returns the best unknowns (14,)."""
        slopes = measured = self.measure_slopes(first, shift, both_sides)
        last = first

        def fill(unknowns: np.ndarray) -> np.ndarray:
            at = first.copy()
            at[self.free] = unknowns
            return at

        def compute_cost(unknowns: np.ndarray) -> float:
            return _compute_loss(self.compare(fill(unknowns)))

        def make_normal_equations(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            nonlocal slopes, last
            at = fill(unknowns)
            if not np.array_equal(at, last):
                slopes = self._follow_step(slopes, last, at)
            last = at
            rows = self.list_rows(at, slopes)
            matrix, right = weigh_equations(rows, rows.stack_slopes(self.shutter))
            return matrix.T @ right, matrix.T @ matrix

        unknowns, _ = minimize_least_squares(
            first[self.free], compute_cost, make_normal_equations,
            max_steps=_STEPS, least_gain=_LEAST_GAIN, rise=_RISE, most_damping=_MOST_DAMPING,
        )  # fmt: skip
        best = fill(unknowns)
        self._drawn = {best[: 2 * POSE].tobytes(): self._draw_at(best)}
        return best, self.list_rows(best, measured)

    def find_lower(self, at: np.ndarray, step: np.ndarray) -> np.ndarray | None:
        """Returns the unknowns after a step or half of it if the cost is lower there.

        Raises:
            SolveError: the step is not finite, since rounding hides an axis of the errors.
        """
        if not np.isfinite(step).all():
            raise report_undetermined()
        least = _compute_loss(self.compare(at))
        tried = (at + share * step for share in (1.0, 0.5))
        return next((to for to in tried if _compute_loss(self.compare(to)) < least), None)

    def look_along_axes(
        self, at: np.ndarray, rows: PixelRows
    ) -> tuple[PixelRows, np.ndarray, np.ndarray]:
        """Measures slopes, and the cost, on both sides along the principal axes of errors.

        Args:
            at: (14,) unknowns. rows: with slopes there.

        Returns:
            Rows with slopes over these errors, the looseness of `SecantPose`, and the step (14,) to
            where the cost is as high on both sides of each axis.
        """
        size = self.moving
        slopes = rows.stack_slopes(self.shutter)
        covariance = estimate_covariance(rows, slopes, SCENE_BLOCKS)[:size, :size]
        unit = np.tile(self.unit, size // POSE)
        squares, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
        length = np.maximum(np.sqrt(squares), _STATED_SHIFT / np.abs(axes).max(axis=0))
        steps = unit[:, None] * axes * length
        pose, motion = self.place_pose(at), at[POSE : 2 * POSE]
        least = _compute_loss(self.compare(at))
        columns, curvatures, tilts = [], [], []
        for step in steps.T:
            moved = step[POSE:] if self.is_rolling else np.zeros(POSE)
            sides = [
                self._draw(moved_pose(pose, sign * step[:POSE], 1.0), motion + sign * moved)
                for sign in (1.0, -1.0)
            ]
            columns.append(at[-2] * (sides[0] - sides[1]) / 2)
            costs = [_compute_loss(at[-2] * side + at[-1] - self.colors) for side in sides]
            curvatures.append(np.mean(costs) - least)
            tilts.append((costs[0] - costs[1]) / 4)
        along = np.concatenate([np.stack(columns, axis=2), rows.by_gain], axis=2)
        matrix, right = weigh_equations(rows, along)
        normal = matrix.T @ matrix
        expected = np.diag(normal)[:size]
        # A cost that curves more than its slopes say shows the grain of renders.
        flatness = expected / np.clip(curvatures, _LEAST_CURVATURE * expected, expected)
        gradient = np.concatenate([tilts, (matrix.T @ right)[size:]])
        scale = np.concatenate([1 / np.sqrt(flatness), np.ones(len(gradient) - size)])
        ahead = -np.linalg.solve(normal * np.outer(scale, scale), gradient)
        ahead[:size] = np.clip(ahead[:size], -_MOST_AHEAD, _MOST_AHEAD)
        step = np.zeros(len(at))
        step[self.free] = np.concatenate([steps @ ahead[:size], ahead[size:]])
        back = np.linalg.inv(steps)
        by_unknowns = along[:, :, :size] @ back
        rows = dataclasses.replace(
            rows, by_pose=by_unknowns[:, :, :POSE],
            by_motion=by_unknowns[:, :, POSE:] if self.is_rolling else None,
        )  # fmt: skip
        return rows, (steps * flatness) @ back, step


def _compute_loss(residuals: np.ndarray) -> float:
    return float(np.sum(compute_losses(residuals)))


def place_lines(
    pose: np.ndarray, motion: np.ndarray, shutter: Shutter | None
) -> np.ndarray | CameraMotion:
    """Returns what `render` takes for a middle pose and the motion during the readout."""
    if shutter is None or shutter.is_global:
        return pose
    start, end = (moved_pose(pose, motion, share) for share in (-0.5, 0.5))
    return CameraMotion(start, end, shutter)


def _measure_units(gaussians: Gaussians, camera: Camera, pose: np.ndarray) -> np.ndarray:
    """Measures (6,) how far the centre moves, and the camera turns, for a pixel on the axis."""
    seen = render(gaussians, camera, pose, watch=False)
    opaque = seen.alpha > OPAQUE
    distance = 1.0
    if opaque.any():
        # Parallax is that of the mean inverse distance.
        distance = 1.0 / float(np.mean(seen.alpha[opaque] / seen.depth[opaque]))
    return measure_pixel_angle(camera) * np.repeat([distance, 1.0], 3)
