"""The memory that a training takes, against what is free: of the doctor, and before training."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from gsut.check.findings import Finding
from gsut.data import DatasetError, Scene
from gsut.optimize import compute_target_size, find_last_densification
from gsut.run import TrainOptions, free_memory, size_text

_FIRST = 10_000  # Gaussians that a scene without points begins with, at least
# Counted, to be rather low: a Gaussian's parameters, gradient and two moments, with its records in
# a frame; a pixel's ray, target, image, gradient and loss; the program.
_ROWS, _RECORD_BYTES, _PIXEL_BYTES, _PROGRAM_BYTES = 4, 200, 100, 150 << 20


def check_memory(scene: Scene, options: TrainOptions | None = None) -> Iterator[Finding]:
    """What a training takes at least, an error where that is not free.

    Args:
        scene: from `load_dataset`, not yet at the size to train at.
        options: of the training; None: the defaults.
    """
    o = (options or TrainOptions()).resolved()
    width, height = _largest(scene, o)
    count = _gaussians(scene, o)
    size = width * height * _PIXEL_BYTES + count * _bytes_of(o.sh_degree) + _PROGRAM_BYTES
    what = (
        f"training takes about {size_text(size)} of memory (images of up to {width} x {height}, "
        f"{count:,} Gaussians of degree {o.sh_degree})"
    )
    free = free_memory()
    if free is None or size <= free:
        yield Finding("info", str(scene.path), what)
        return
    yield Finding(
        "error", str(scene.path), f"{what}, and {size_text(free)} are free",
        "use smaller images (--max-side), fewer Gaussians (--max-gaussians) or --blocks",
    )  # fmt: skip


def refuse_too_large(scene: Scene, options: TrainOptions) -> None:
    """Raises DatasetError where the memory that is free does not suffice."""
    for found in check_memory(scene, options):
        if found.severity == "error":
            raise DatasetError(found.where, found.what, found.advice)


def _bytes_of(sh_degree: int) -> int:
    return 4 * (11 + 3 * (sh_degree + 1) ** 2) * _ROWS + _RECORD_BYTES


def _largest(scene: Scene, options: TrainOptions) -> tuple[int, int]:
    """Width and height of the image with the most pixels, as it is trained on."""
    sizes = [(camera.width, camera.height) for camera in scene.cameras]
    width, height = max(sizes, key=lambda size: size[0] * size[1])
    factor, longer = options.scale, max(map(max, sizes))
    if factor == 1.0 and 0 < options.max_side < longer:
        factor = options.max_side / longer
    return max(1, round(factor * width)), max(1, round(factor * height))


def _gaussians(scene: Scene, options: TrainOptions) -> int:
    """How many there will be in any case: only mcmc's number follows from the steps."""
    o = dataclasses.replace(options, max_gaussians=options.most_gaussians)
    first = min(o.init_count or len(scene.points) or _FIRST, o.max_gaussians)
    last = find_last_densification(o)
    if o.strategy != "mcmc" or last < max(1.0, o.densify_from * o.steps):
        return first
    return max(first, compute_target_size(o, first, last / o.steps))
