"""Compares the memory that a training takes with what is free."""

from __future__ import annotations

from collections.abc import Iterator

from gsut.check.findings import Finding
from gsut.data import DatasetError, Scene
from gsut.gaussians import count_bytes_per_gaussian
from gsut.optimize import DENSIFY_FROM, compute_target_size, find_last_densification
from gsut.run import PROGRAM_BYTES, TrainOptions, format_size, free_memory

# Lower bounds: a training that exceeds them cannot run.
_ROWS = 4  # arrays of a Gaussian's size: parameters, gradient and two moments
_PIXEL_BYTES = 100  # of a pixel's ray, target, image, gradient and loss


def check_memory(scene: Scene, options: TrainOptions | None = None) -> Iterator[Finding]:
    """Estimates the least memory that a training takes; an error if it is not free.

    Args:
        scene: from `load_dataset`, not yet at the size to train at.
        options: of the training; None: the defaults.
    """
    o = options or TrainOptions()
    width, height = _find_largest(scene, o)
    count = _count_gaussians(scene, o)
    row = count_bytes_per_gaussian(o.sh_degree) * _ROWS
    size = width * height * _PIXEL_BYTES + count * row + PROGRAM_BYTES
    what = (
        f"training takes {format_size(size)} of memory at least (images of up to {width} x "
        f"{height}, {count:,} Gaussians of degree {o.sh_degree})"
    )
    free = free_memory()
    if free is None or size <= free:
        yield Finding("info", str(scene.path), what)
        return
    yield Finding(
        "error", str(scene.path), f"{what}, and {format_size(free)} are free",
        "use smaller images (--max-side), fewer Gaussians (--max-gaussians) or --blocks",
    )  # fmt: skip


def refuse_too_large(scene: Scene, options: TrainOptions) -> None:
    """Raises a DatasetError if the free memory does not suffice."""
    for found in check_memory(scene, options):
        if found.severity == "error":
            raise DatasetError(found.where, found.what, found.advice)


def _find_largest(scene: Scene, options: TrainOptions) -> tuple[int, int]:
    """Returns width and height of the image with the most pixels, as it is trained on."""
    sizes = [(camera.width, camera.height) for camera in scene.cameras]
    width, height = max(sizes, key=lambda size: size[0] * size[1])
    factor, longer = options.scale, max(map(max, sizes))
    if factor == 1.0 and 0 < options.max_side < longer:
        factor = options.max_side / longer
    return max(1, round(factor * width)), max(1, round(factor * height))


def _count_gaussians(scene: Scene, options: TrainOptions) -> int:
    """Counts the Gaussians that there will be in any case; only mcmc's follow from the steps."""
    most, steps = options.most_gaussians, options.steps
    first = min(max(1, len(scene.points)), most)
    recipe = options.recipe
    last = find_last_densification(recipe, steps)
    if options.strategy != "mcmc" or last < max(1.0, DENSIFY_FROM * steps):
        return first
    due = range(recipe.densify_every, last + 1, recipe.densify_every)
    sizes = (compute_target_size(most, first, at / steps, recipe.overgrowth) for at in due)
    return max(first, *sizes)
