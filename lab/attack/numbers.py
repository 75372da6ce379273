"""Renders Gaussians of extreme numbers, which float32 draws like the double reference or names."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator

import numpy as np

import gsut
from random_scenes import gaussians_in_view, pinhole, random_pose

Scene = tuple[gsut.Gaussians, np.ndarray]
FOLLOWED = 1e-5  # rms of the image, in units of its largest value: what `gsut.render` states
EXPONENTS = (-30, -20, -14, -12, -10, -5, 5, 10, 12, 14, 20, 30)  # of ten


def rescale(factor: float) -> Callable[[Scene], Scene]:
    """The whole scene in other units."""

    def change(scene: Scene) -> Scene:
        g, pose = scene
        pose = pose.copy()
        pose[:3, 3] *= factor
        scales = g.log_scales + np.log(factor)
        return dataclasses.replace(g, means=g.means * factor, log_scales=scales), pose

    return change


def replace_scales(*scales: float | None) -> Callable[[Scene], Scene]:
    """Other standard deviations along the axes of each Gaussian; None: as they are."""

    def change(scene: Scene) -> Scene:
        log_scales = scene[0].log_scales.copy()
        for axis, scale in enumerate(scales):
            if scale is not None:
                log_scales[:, axis] = np.log(scale)
        return dataclasses.replace(scene[0], log_scales=log_scales), scene[1]

    return change


def move_away(far: float) -> Callable[[Scene], Scene]:
    """Scene and camera far from the world's zero."""

    way = np.array([far, -far, 0.1 * far])

    def change(scene: Scene) -> Scene:
        g, pose = scene
        pose = pose.copy()
        pose[:3, 3] -= pose[:3, :3] @ way
        return dataclasses.replace(g, means=g.means + way), pose

    return change


def multiply(name: str, factor: float) -> Callable[[Scene], Scene]:
    """One array times a factor."""
    return lambda scene: (
        dataclasses.replace(scene[0], **{name: getattr(scene[0], name) * factor}), scene[1]
    )  # fmt: skip


ROWS: dict[str, Callable[[Scene], Scene]] = {
    **{f"a scene times 1e{e}": rescale(10.0**e) for e in EXPONENTS},
    **{f"discs of 6e{e}": replace_scales(None, None, 6.0 * 10.0**e) for e in (-16, -14, -12, -8)},
    **{f"scales of e^{k}": replace_scales(*[float(np.exp(k))] * 3) for k in (20, 28, 44, 80, 300)},
    **{f"one scale of e^{k}": replace_scales(float(np.exp(k))) for k in (20, 28, 44, 80, 300)},
    **{f"needles of 1e{e}": replace_scales(10.0 ** (e / 2 - 1), *[10.0 ** (-e / 2 - 1)] * 2)
       for e in range(2, 10)},
    **{f"1e{e} away": move_away(10.0**e) for e in (3, 5, 7, 9)},
    **{f"quaternions times 1e{e}": multiply("quats", 10.0**e) for e in (-45, -38, -36, 30, 36)},
    **{f"colours times 1e{e}": multiply("sh", 10.0**e) for e in (3, 10, 30)},
    **{f"logits times 1e{e}": multiply("opacity_logits", 10.0**e) for e in (2, 5, 30)},
}  # fmt: skip


def list_numbers() -> Iterator[tuple[str, str]]:
    """Lists the kind and title of each row."""
    for name in ROWS:
        yield "number", f"number: {name}"


def render_numbers(title: str) -> str | None:
    """Renders the scenes of a row in both precisions and returns the fault, if any."""
    rng = np.random.default_rng(2)
    camera = pinhole(48)
    for _ in range(4):
        pose = random_pose(rng)
        g = gaussians_in_view(rng, camera, pose, 20)
        g, pose = ROWS[title.removeprefix("number: ")]((g, pose))
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            image = gsut.render(g, camera, pose).image
        exact = gsut.render(g, camera, pose, dtype="float64").image
        off = np.sqrt(np.mean((image - exact) ** 2)) / max(1.0, exact.max())
        if not said and not off <= FOLLOWED:
            return f"drawn {off:.1e} off without a word"
    return None
