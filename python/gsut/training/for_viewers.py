"""A short fine-tune that makes a scene look the same in viewers, which splat by EWA, as in gsut."""

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
from gsut.optimize import GaussianOptimizer, LearningRates, view_of_step
from gsut.render import DEFAULT_UNSCENTED, EwaSplats, psnr, render, render_ewa, viewer_rule
from gsut.training.start import about_cameras

VIEWER_STEPS = 300
_SCREEN = (1280, 960)  # pixels of the screen that is trained for
_WINDOW = (640, 480)  # of it, seen in one step
_FIELDS_DEGREES = (60.0, 90.0)  # across the screen
_MEASURED = 3  # poses, at both ends and the middle of the fields
# Of 3DGS' training, and the centres' those of its end; all fall to a tenth. On fox (100 000 at a
# quarter of the size), 300 steps on the training poses, seen from the held-out ones.
_RATES = {
    "means": 3.2e-6,
    "quats": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 5e-2,
    "sh0": 2.5e-3,
    "sh_rest": 1.25e-4,
}
_FINAL_FACTOR = 0.1
_SSIM_WEIGHT = 0.2


@dataclasses.dataclass(frozen=True)
class ForViewers:
    """What the fine-tune gives.

    Attributes:
        gaussians: as many as there were.
        psnr_before, psnr_after: of what viewers draw, against the exact pictures of the scene as it
            was; mean over poses that were not trained on where there are, at 60 to 90 degrees.
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
    shrink: float = 1.0,
    seed: int = 0,
    on_step: Callable[[int, float], object] = lambda step, loss: None,
) -> ForViewers:
    """Fine-tunes Gaussians for EWA splatting with the screen's widening of 0.3 pixels squared.

    No photograph is used: the pictures to come near to are the scene's own, exact ones, from the
    training poses turned at random within what their lens saw, through a pinhole.

    Args:
        scene: whose poses are looked from.
        gaussians: trained, of the same world.
        steps: one picture each.
        background: colour behind everything.
        shrink: of the viewers' splats, see `EwaSplats`.
        seed: of fields of view, windows and turns.
        on_step: called after each step with its number and loss.

    Returns:
        The Gaussians, and how near viewers come before and after. The same bits on any number of
        threads.

    Raises:
        InputError: no training view, or fewer than one step.
    """
    if steps < 1 or not scene.train_indices:
        raise InputError(f"{steps} steps and {len(scene.train_indices)} training views: 1 at least")
    near, teacher = about_cameras(scene, gaussians)
    teacher = teacher.to_dtype(np.float32)
    shift, scene = near.world_offset - scene.world_offset, near
    optimizer = GaussianOptimizer(teacher, seed=seed)
    renderer, rule = _core.Renderer(), viewer_rule()
    extent = scene.extent
    for step in range(1, steps + 1):
        view = view_of_step(scene.train_indices, step, seed)
        rng = np.random.default_rng([seed, step])
        camera = _window(rng)
        pose = _turned(rng, scene, view)
        truth = render(teacher, camera, pose, background=background).image
        splats = EwaSplats(optimizer.gaussians, camera, pose, shrink=shrink)
        image = np.zeros_like(truth)
        renderer.render(
            splats.discs, camera, pose, rule, tuple(background), teacher.sh_degree,
            DEFAULT_UNSCENTED, image, None, None, True,
        )  # fmt: skip
        loss, dimage = _core.photometric_loss(
            _core.PhotometricTarget(truth), image, None, _SSIM_WEIGHT
        )
        gradients = splats.discs.make_zeros()
        touched = np.zeros(len(teacher), np.uint8)
        renderer.backward(dimage, None, None, gradients, touched, True, False)
        splats.backward(gradients)
        optimizer.step(gradients, _rates(step / steps, extent), touched)
        on_step(step, float(loss))
    tuned = optimizer.gaussians.copy()
    before, after = _compared(scene, teacher, (teacher, tuned), background, shrink)
    return ForViewers(tuned.translate(shift), before, after)


def _rates(fraction: float, extent: float) -> LearningRates:
    falling = {name: rate * _FINAL_FACTOR**fraction for name, rate in _RATES.items()}
    return LearningRates(**falling | {"means": falling["means"] * extent})


def _pinhole(field_degrees: float, size: tuple[int, int], corner: Sequence[float]) -> Camera:
    """A window of the screen, whose top left corner lies there."""
    focal = _SCREEN[0] / 2 / np.tan(np.radians(field_degrees) / 2)
    center = [_SCREEN[i] / 2 - corner[i] for i in range(2)]
    return Camera("pinhole", [focal, focal, *center], *size)


def _window(rng: np.random.Generator) -> Camera:
    free = [_SCREEN[i] - _WINDOW[i] for i in range(2)]
    corner = [int(rng.integers(0, most + 1)) for most in free]
    return _pinhole(rng.uniform(*_FIELDS_DEGREES), _WINDOW, corner)


def _turned(rng: np.random.Generator, scene: Scene, view: int) -> np.ndarray:
    """The view's pose, turned about its vertical as far as the screen stays within its field."""
    pose = scene.views[view].camera_from_world
    field = min(scene.camera(view).max_angle, np.pi)
    limit = scene.camera(view).valid_field_angle
    free = max(0.0, min(field, limit or _seen_angle(scene.camera(view))) - np.pi / 4)
    angle = rng.uniform(-free, free)
    turn = np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return turn @ pose


def _seen_angle(camera: Camera) -> float:
    """From the axis to the middle of the image's right edge, 0 if that has no ray."""
    rays, valid = camera.unproject(np.array([[camera.width - 0.5, camera.height / 2]]))
    return float(np.arccos(np.clip(rays[0, 2], -1, 1))) if valid[0] else 0.0


def _compared(
    scene: Scene,
    teacher: Gaussians,
    candidates: Sequence[Gaussians],
    background: Sequence[float],
    shrink: float,
) -> list[float]:
    """Mean PSNR of each candidate's EWA pictures against the teacher's exact ones."""
    rows = list(scene.test_indices or scene.train_indices)
    rows = [rows[i] for i in np.unique(np.linspace(0, len(rows) - 1, _MEASURED).astype(int))]
    fields = np.linspace(*_FIELDS_DEGREES, 3)
    sums: list[Any] = [0.0] * len(candidates)
    for row in rows:
        pose = scene.views[row].camera_from_world
        for field in fields:
            camera = _pinhole(float(field), _SCREEN, (0, 0))
            truth = np.clip(render(teacher, camera, pose, background=background).image, 0, 1)
            for i, gaussians in enumerate(candidates):
                image = render_ewa(
                    gaussians, camera, pose, background=background, shrink=shrink
                ).image
                sums[i] += psnr(truth, np.clip(image, 0, 1))
    return [float(total) / (len(rows) * len(fields)) for total in sums]
