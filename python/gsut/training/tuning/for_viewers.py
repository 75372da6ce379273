"""Fine-tunes a scene so that viewers, which splat by EWA, show it as gsut does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.lens import Camera
from gsut.metrics import psnr
from gsut.optimize import GaussianOptimizer, LearningRates, choose_view
from gsut.render import render
from gsut.sampling import choose_evenly
from gsut.training.first import center_on_cameras
from gsut.training.loop import SSIM_WEIGHT
from gsut.training.tuning.ewa import EwaSplats, make_viewer_rule, render_ewa

# Steps of the fine-tune by default; more gain little.
VIEWER_STEPS = 300
# Pixels of the screen that is trained for.
_SCREEN = (1280, 960)
# Pixels of the part of the screen that is rendered in one step: a step then takes a quarter.
_WINDOW = (640, 480)
# Fields of view across the screen in degrees, the range that viewers offer.
_FIELDS_DEGREES = (60.0, 90.0)
# Poses that are measured, at both ends and the middle of the fields.
_MEASURED = 3
# Learning rates of 3DGS; the centres' are those of the end of its training.
_RATES = {
    "means": 3.2e-6,
    "quats": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 5e-2,
    "sh0": 2.5e-3,
    "sh_rest": 1.25e-4,
}
# Ratio of the last learning rates to the first: the result then settles.
_FINAL_FACTOR = 0.1


@dataclasses.dataclass(frozen=True)
class ForViewers:
    """The result of the fine-tune.

    Attributes:
        gaussians: the tuned ones; their number stays.
        psnr_before, psnr_after: of viewers' pictures against exact pictures of the original scene;
            mean over fields of 60 to 90 degrees at held-out poses (training poses if none is held
            out).
    """

    gaussians: Gaussians
    psnr_before: float
    psnr_after: float


def tune_for_viewers(
    scene: Scene,
    gaussians: Gaussians,
    steps: int = VIEWER_STEPS,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    on_step: Callable[[int, float], object] = lambda step, loss: None,
) -> ForViewers:
    """Fine-tunes Gaussians for EWA splatting with the screen's widening of 0.3 pixels squared.

    No photograph is used: the targets are exact pictures of the scene, from the training poses
    turned at random within what their lens saw, through a pinhole.

    Args:
        scene: whose poses are used.
        gaussians: trained, of the same world.
        steps: of one picture each.
        background: colour behind everything.
        on_step: called after each step with its number and loss.

    Returns:
        The Gaussians, and how close viewers come before and after. The bits do not depend on the
        number of threads.

    Raises:
        InputError: no training view, or fewer than one step.
    """
    if steps < 1 or not scene.train_indices:
        raise InputError(
            f"{steps} steps and {len(scene.train_indices)} training views: both must be at least 1"
        )
    near, teacher = center_on_cameras(scene, gaussians)
    teacher = teacher.to_dtype(np.float32)
    shift, scene = near.world_offset - scene.world_offset, near
    # What viewers draw by; the teacher's pictures are of its own response and order.
    optimizer = GaussianOptimizer(
        dataclasses.replace(
            teacher.to_primitive(Gaussians.PRIMITIVES[0]),
            response=Gaussians.RESPONSES[0],
            order=Gaussians.ORDERS[0],
        ),
        seed=0,
    )
    renderer, rule = _core.Renderer(), make_viewer_rule()
    extent = scene.extent
    for step in range(1, steps + 1):
        view = choose_view(scene.train_indices, step, 0)
        rng = np.random.default_rng([0, step])
        camera = _draw_window(rng)
        pose = _turn_pose(rng, scene, view)
        truth = render(teacher, camera, pose, background=background).image
        splats = EwaSplats(optimizer.gaussians, camera, pose)
        image = np.zeros_like(truth)
        job = _core.RenderJob(
            camera, pose, rule=rule, background=tuple(background), sh_degree=teacher.sh_degree
        )
        renderer.render(splats.discs, job, image)
        loss, dimage = _core.photometric_loss(
            _core.PhotometricTarget(truth), image, None, SSIM_WEIGHT
        )
        gradients = splats.discs.make_zeros()
        touched = np.zeros(len(teacher), np.uint8)
        renderer.backward(dimage, gradients, touched, with_poses=False)
        splats.backpropagate(gradients)
        optimizer.step(gradients, _lower_rates(step / steps, extent), touched)
        on_step(step, float(loss))
    tuned = optimizer.gaussians.copy()
    before, after = _compare_candidates(scene, teacher, (teacher, tuned), background)
    return ForViewers(tuned.translate(shift), before, after)


def _lower_rates(fraction: float, extent: float) -> LearningRates:
    falling = {name: rate * _FINAL_FACTOR**fraction for name, rate in _RATES.items()}
    return LearningRates(**falling | {"means": falling["means"] * extent})


def _make_pinhole(field_degrees: float, size: tuple[int, int], corner: Sequence[float]) -> Camera:
    """Returns a camera for the window of the screen whose top left corner is `corner`."""
    focal = _SCREEN[0] / 2 / np.tan(np.radians(field_degrees) / 2)
    center = [_SCREEN[i] / 2 - corner[i] for i in range(2)]
    return Camera("pinhole", [focal, focal, *center], *size)


def _draw_window(rng: np.random.Generator) -> Camera:
    free = [_SCREEN[i] - _WINDOW[i] for i in range(2)]
    corner = [int(rng.integers(0, most + 1)) for most in free]
    return _make_pinhole(rng.uniform(*_FIELDS_DEGREES), _WINDOW, corner)


def _turn_pose(rng: np.random.Generator, scene: Scene, view: int) -> np.ndarray:
    """Returns the view's pose turned about its vertical, with the screen within the lens' field."""
    pose = scene.views[view].camera_from_world
    field = min(scene.camera(view).max_angle, np.pi)
    limit = scene.camera(view).valid_field_angle
    free = max(0.0, min(field, limit or _measure_seen_angle(scene.camera(view))) - np.pi / 4)
    angle = rng.uniform(-free, free)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return turn @ pose


def _measure_seen_angle(camera: Camera) -> float:
    """Returns the angle from the axis to the middle of the right edge; 0 if that has no ray."""
    rays, valid = camera.unproject(np.array([[camera.width - 0.5, camera.height / 2]]))
    return float(np.arccos(np.clip(rays[0, 2], -1, 1))) if valid[0] else 0.0


def _compare_candidates(
    scene: Scene,
    teacher: Gaussians,
    candidates: Sequence[Gaussians],
    background: Sequence[float],
) -> list[float]:
    """Returns the mean PSNR of each candidate's EWA pictures against the teacher's exact ones."""
    rows = choose_evenly(scene.test_indices or scene.train_indices, _MEASURED)
    fields = np.linspace(*_FIELDS_DEGREES, 3)
    sums: list[Any] = [0.0] * len(candidates)
    for row in rows:
        pose = scene.views[row].camera_from_world
        for field in fields:
            camera = _make_pinhole(float(field), _SCREEN, (0, 0))
            truth = np.clip(render(teacher, camera, pose, background=background).image, 0, 1)
            for i, gaussians in enumerate(candidates):
                image = render_ewa(gaussians, camera, pose, background=background).image
                sums[i] += psnr(truth, np.clip(image, 0, 1))
    return [float(total) / (len(rows) * len(fields)) for total in sums]
