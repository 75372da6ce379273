"""Plans a training in blocks: sizes of the coarse model and the blocks, their steps and memory."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

from gsut._core import InputError
from gsut.data import Scene
from gsut.data.scene import SMALLEST_SIDE
from gsut.gaussians import count_bytes_per_gaussian
from gsut.run import PROGRAM_BYTES, BlockOptions, TrainOptions, format_size, free_memory
from gsut.run.options import Recipe

# Share of all Gaussians that the coarse model of few blocks has: blocks need room to grow.
_COARSE_GAUSSIANS = 0.8
# Gaussians of the coarse model, x those of a block: what fits into its memory with its context.
_COARSE_BLOCKS = 3.3
# Share of all steps that the coarse model is trained for: blocks refine it.
_COARSE_STEPS = 0.6
# Size of the coarse model's images relative to the scene's.
_COARSE_SCALE = 0.5
# Share of a block's Gaussians that it begins with, if the scene has points; the others grow.
SEEDED = 0.8
# Fewest steps of the coarse model and of a block: fewer do not settle.
_FEWEST_STEPS = 50
# Fewest Gaussians of the coarse model and of a block.
_FEWEST_GAUSSIANS = 500
# Rounds of training: in the second one, blocks see the results of their neighbours.
ROUNDS = 2
# Fraction of a block's steps after which the first round ends.
_FIRST_ROUND = 0.8
# States that are written in a round: at most an eighth of it is lost to an interruption.
SEGMENTS = 8
# Most Gaussians drawn around a block, x its own.
CONTEXT_MOST = 3.0
# Arrays of a trained Gaussian: parameters, two moments, gradient, mean and a copy for drawing.
_TRAINED_ROWS = 6
# Arrays of a Gaussian of the context: parameters, gradient and a copy for drawing.
_CONTEXT_ROWS = 3
# Bytes of a Gaussian's records and lists in a frame, whether trained or not.
_FRAME_BYTES = 600
# Bytes of a pixel of the image, its gradient and the loss' buffers.
_PIXEL_BYTES = 200
# Bytes of a pixel of a photograph: decoded, and of its precomputed target.
_PHOTOGRAPH_BYTES = 43
# Most bytes of decoded photographs that a training keeps; others are decoded again.
_PHOTOGRAPHS_KEPT = 3 << 30
# Photographs that are kept decoded even if memory is short.
_FEW_VIEWS = 8
# Part of the memory limit for pictures that the driver keeps decoded: a sixteenth.
_CACHE_PART = 16
# Share of the free memory that is used if no limit is given: other programs need some.
_USED = 0.8
# Size of the largest block relative to the mean.
_UNEVEN = 1.5


class TrainingSize(NamedTuple):
    """What the memory of one training depends on.

    Attributes:
        scene: at the size to train at.
        sh_degree: of the Gaussians.
        own: number of trained Gaussians.
        context: number of Gaussians that are only drawn.
        views: number of views whose photographs are kept decoded.
    """

    scene: Scene
    sh_degree: int
    own: int
    context: int
    views: int

    def estimate_bytes(self) -> int:
        """Estimates the memory that the training takes."""
        row = count_bytes_per_gaussian(self.sh_degree)
        return (
            PROGRAM_BYTES
            + self.own * (row * _TRAINED_ROWS + _FRAME_BYTES)
            + self.context * (row * _CONTEXT_ROWS + _FRAME_BYTES)
            + _count_pixels(self.scene) * _PIXEL_BYTES
            + _estimate_photograph_bytes(self.scene, self.views)
        )

    def estimate_least_bytes(self) -> int:
        """Estimates the memory if few photographs are kept decoded."""
        return self._replace(views=min(self.views, _FEW_VIEWS)).estimate_bytes()

    def limit_photograph_bytes(self, blocks: BlockOptions) -> int:
        """Returns the bytes of photographs that fit into the limit beside everything else."""
        limit = find_memory_limit(blocks)
        if limit is None:
            return _PHOTOGRAPHS_KEPT
        free = limit // count_at_once(blocks) - self._replace(views=0).estimate_bytes()
        few = _estimate_photograph_bytes(self.scene, _FEW_VIEWS)
        return min(_PHOTOGRAPHS_KEPT, max(few, free))


def _count_pixels(scene: Scene) -> int:
    return max(camera.width * camera.height for camera in scene.cameras)


def _estimate_photograph_bytes(scene: Scene, views: int) -> int:
    """Estimates the memory of the decoded photographs of some views."""
    return min(_PHOTOGRAPHS_KEPT, views * _count_pixels(scene) * _PHOTOGRAPH_BYTES)


def choose_coarse_scale(scene: Scene) -> float:
    """Chooses the size of the coarse model's images relative to the scene's."""
    side = min(min(camera.width, camera.height) for camera in scene.cameras)
    return _COARSE_SCALE if side * _COARSE_SCALE >= SMALLEST_SIDE else 1.0


def make_coarse_options(options: TrainOptions, blocks: int) -> TrainOptions:
    """Returns the options of the coarse model."""
    most = options.most_gaussians
    share = min(_COARSE_GAUSSIANS, _COARSE_BLOCKS / blocks)
    few = min(most, max(_FEWEST_GAUSSIANS, round(share * most)))
    steps = max(_FEWEST_STEPS, round(_COARSE_STEPS * options.steps))
    return dataclasses.replace(options, max_gaussians=few, steps=steps)


def make_block_options(options: TrainOptions, visits: float, most: int) -> TrainOptions:
    """Returns the options of one block over all rounds.

    Args:
        options: of the run.
        visits: how often the block is trained on a view, the mean over the scene's views: 0 to 1.
        most: number of Gaussians that it may grow to.
    """
    return dataclasses.replace(
        options, max_gaussians=most, steps=max(_FEWEST_STEPS, round(visits * options.steps)),
        refine_poses=False, refine_lens=False, test_names=None, exposure="off",
    )  # fmt: skip


def make_block_recipe(options: TrainOptions, share: float) -> Recipe:
    """Returns the recipe of one block.

    Args:
        options: of `make_block_options`.
        share: of all the scene's Gaussians that the block has at most. The regularizers are means
            over all Gaussians: over a block's alone each would weigh more.
    """
    recipe, part = options.recipe, min(1.0, share)
    return dataclasses.replace(
        recipe, regularizer=part * recipe.regularizer, sh_every=1, coarse_to_fine=(0.0, 0.0)
    )


def limit_cache_bytes(blocks: BlockOptions) -> float:
    """Returns the bytes of decoded pictures, and again of masks, that the driver keeps."""
    limit = find_memory_limit(blocks)
    return math.inf if limit is None else limit // _CACHE_PART


def limit_drawn_bytes(blocks: BlockOptions) -> int | None:
    """Returns the bytes of Gaussians drawn for measurement; None: what is free."""
    limit = blocks.parse_memory()
    return None if limit is None else max(limit - PROGRAM_BYTES, limit // _CACHE_PART)


def count_at_once(blocks: BlockOptions) -> int:
    """Returns the number of blocks that share the memory of a machine."""
    return blocks.workers if blocks.cluster is None else 1


def find_memory_limit(blocks: BlockOptions) -> int | None:
    """Returns the bytes that all workers together may take; None if the system does not say."""
    free = free_memory()
    return blocks.parse_memory() or (None if free is None else int(_USED * free))


def choose_count(scene: Scene, options: TrainOptions, blocks: BlockOptions) -> int:
    """Chooses the number of blocks: the requested one, or as few as memory and workers allow.

    Raises:
        InputError: not even blocks of few Gaussians fit.
    """
    requested = blocks.count()
    if requested is not None:
        return requested
    limit, total = find_memory_limit(blocks), options.most_gaussians
    count = 1 if blocks.workers == 1 and blocks.cluster is None else 2 * blocks.workers
    while limit is not None and estimate_total_bytes(scene, options, blocks, count) > limit:
        count += 1 + count // 4
        if total / count < _FEWEST_GAUSSIANS:
            smallest = estimate_total_bytes(scene, options, blocks, count)
            raise InputError(
                f"--memory {format_size(limit)}: even blocks of {total // count:,} Gaussians take "
                f"{format_size(smallest)} with {blocks.workers} worker(s); give more memory, fewer "
                "--workers or smaller images (--max-side)"
            )
    return count


def estimate_total_bytes(
    scene: Scene, options: TrainOptions, blocks: BlockOptions, count: int
) -> int:
    """Estimates the memory that all workers take together with `count` blocks."""
    total, views = options.most_gaussians, len(scene.train_indices)
    own = round(total / count * (_UNEVEN if count > 1 else 1.0))
    context = min(round(CONTEXT_MOST * own), total - own) if count > 1 else 0
    size = TrainingSize(scene, options.sh_degree, own, max(context, 0), views)
    return count_at_once(blocks) * size.estimate_least_bytes()


def check_memory(sizes: dict[str, int], blocks: BlockOptions) -> None:
    """Checks that each part fits into memory before it starts.

    Args:
        sizes: bytes of each part, by a name for messages.
        blocks: limit and number of workers.

    Raises:
        InputError: the given limit is less than the largest part takes.
    """
    limit = blocks.parse_memory()
    name, size = max(sizes.items(), key=lambda item: item[1])
    together = size * count_at_once(blocks)
    if limit is not None and together > limit:
        raise InputError(
            f"--memory {format_size(limit)}: {name} takes about {format_size(size)}"
            f"{f', times {blocks.workers} workers' if together > size else ''}; give more "
            "--blocks, fewer --workers, fewer --max-gaussians or smaller images (--max-side)"
        )


def find_round_steps(options: TrainOptions, number: int) -> tuple[int, int]:
    """Returns the first and last step of a block's round `number` (from 0)."""
    middle = round(_FIRST_ROUND * options.steps)
    return (0, middle) if number == 0 else (middle, options.steps)


def check_trainable(options: TrainOptions) -> None:
    """Rejects options that a training in blocks does not support.

    Raises:
        InputError: names the first of them.
    """
    unsupported = {
        "--robust": options.robust,
        "--surface": options.surface,
        "response=extinction": options.response != "maximum",
        f"--order {options.order}": options.order != "distance",
        f"--primitive {options.primitive}": options.primitive not in ("gaussian", "surfel"),
        "strategy=mini": options.strategy == "mini",
    }
    for flag, given in unsupported.items():
        if given:
            raise InputError(f"{flag} cannot be combined with --blocks; leave one of the two out")
