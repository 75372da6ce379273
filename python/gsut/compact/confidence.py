"""Measures how far renders of Gaussians are from photographs, and where."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.compact.scores import LONGER_SIDE, Passes, SeenView, paint_grey
from gsut.gaussians import SH_C0, Gaussians
from gsut.render import Confidence, Light, render
from gsut.sampling import ENOUGH_SAMPLES, choose_evenly


@name_wrong_kinds
def measure_confidence(
    scene: Any,
    gaussians: Gaussians,
    *,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    light: Light | None = None,
    on_view: Callable[[int, int], object] = lambda done, total: None,
) -> Confidence:
    """Measures how far renders are from photographs, for `render(confidence=...)`.

    Differences in training views, by blend weight, say where renders err; held-out views calibrate
    how much. What photographs agree on and is wrong, such as the room in a mirror, stays unknown.

    Args:
        scene: a `Scene`.
        gaussians: N that were trained on it, in its coordinates.
        background: colour behind everything, see `render`.
        light: of the photographs, if the run has found it.
        on_view: called after each view with the number of views done, and of all.

    Returns:
        What `render` takes. The same bits on any number of threads.

    Raises:
        InputError: the scene has no training view.
    """
    if not scene.train_indices:
        raise InputError(f"{scene.path} has no training view to compare renders with")
    gaussians = gaussians.order_by_centers()
    tests = choose_evenly(scene.test_indices)
    done, total = 0, len(scene.train_indices) + len(tests)
    weight, squares, differences = np.zeros((3, len(gaussians)))
    for each, difference in _sum_differences(scene, gaussians, background, light):
        weight += each
        squares += each**2
        differences += difference
        done += 1
        on_view(done, total)
    confidence = Confidence.from_sums(gaussians, weight, squares, differences)
    ratios = []
    for index in tests:
        result = render(
            gaussians, scene.camera(index), scene.views[index].motion, background=background,
            confidence=confidence,
        )  # fmt: skip
        found = _compare(scene, index, result.image, light) / confidence.expect_differences(result)
        found = found[scene.mask(index) & np.isfinite(found)]
        # Neighbouring pixels err alike: some, spread evenly, suffice.
        ratios.append(found[:: -(-found.size // ENOUGH_SAMPLES) or 1])
        done += 1
        on_view(done, total)
    return confidence.calibrate([each for each in ratios if each.size])


def _sum_differences(
    scene: Any, gaussians: Gaussians, background: Sequence[float] | None, light: Light | None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields of each training view blend weights (N,), and their sum times the differences."""
    longest = max(max(camera.width, camera.height) for camera in scene.cameras)
    small = scene.scale_images(min(1.0, LONGER_SIDE / longest))
    drawn, grey = Passes(gaussians, background or (0.0, 0.0, 0.0)), paint_grey(gaussians)
    weights = Passes(grey)
    for index in small.train_indices:
        view = SeenView(small.camera(index), small.views[index].motion, small.mask(index))
        image, _ = drawn.render(view, keep=False)
        dimage = np.zeros_like(image)
        dimage[..., 0] = view.mask
        dimage[..., 1] = _compare(small, index, image, light) * view.mask
        weights.render(view)
        sums = weights.backpropagate(dimage).sh[:, 0].astype(np.float64) / SH_C0
        yield np.maximum(sums[:, 0], 0.0), np.maximum(sums[:, 1], 0.0)


def _compare(scene: Any, index: int, image: np.ndarray, light: Light | None) -> np.ndarray:
    """Computes the mean absolute difference (H, W) of a render's colours to its photograph."""
    if light is not None:
        image = image * light.on(scene.camera(index), index, scene.views[index].camera_index)
    truth = scene.image(index).astype(np.float32) / np.float32(255)
    return np.abs(np.clip(image, 0.0, 1.0) - truth).mean(axis=2)
