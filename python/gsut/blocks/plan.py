"""How large the coarse model and the blocks are, how long they train, and what memory they take."""

from __future__ import annotations

import dataclasses
import math

from gsut._core import InputError
from gsut.data import Scene
from gsut.gaussians import count_bytes_per_gaussian
from gsut.run import BlockOptions, TrainOptions, free_memory, size_text
from gsut.training import limit_gaussians

# Of all Gaussians and steps; at half the size. With many blocks it has as many Gaussians as fit
# into the memory of one of them with its context, but for a least share.
_COARSE_GAUSSIANS, _COARSE_LEAST, _COARSE_STEPS, _COARSE_SCALE = 0.8, 0.02, 0.6, 0.5
_COARSE_BLOCKS = 3.3
SEEDED = 0.8  # of a block's Gaussians, that it begins with where the scene has points
_FEWEST_STEPS, _FEWEST_GAUSSIANS = 50, 500
_SMALLEST_SIDE = 64  # pixels, of a coarse model's images
# Fraction of a block's steps after which the first of two rounds ends.
FIRST_ROUND = 0.8
SEGMENTS = 8  # states a round
CONTEXT_MOST = 3.0  # Gaussians drawn around a block, of its own
# Bytes. A Gaussian that is trained has parameters, two moments, gradient, mean and a copy for
# drawing, one of the context three of these; both have a frame's records and lists.
_TRAINED_ROWS, _CONTEXT_ROWS, _FRAME_BYTES = 6, 3, 600
_PIXEL_BYTES, _TARGET_BYTES = 200, 40
_IMAGE_BYTES = 3  # of a pixel that is decoded
_PHOTOGRAPHS_KEPT = 3 << 30  # decoded ones, of one training; what is not kept is decoded again
_FEW_VIEWS = 8  # photographs that are kept even where memory is short
_PROGRAM_BYTES = 160 << 20
_CACHE_PART = 16  # of the memory limit, for what the driver keeps decoded
_USED = 0.8  # of the free memory, where no limit is given
_UNEVEN = 1.5  # the largest block over the mean


def coarse_scale(scene: Scene) -> float:
    """Size of the coarse model's images, of the scene's."""
    side = min(min(camera.width, camera.height) for camera in scene.cameras)
    return _COARSE_SCALE if side * _COARSE_SCALE >= _SMALLEST_SIDE else 1.0


def coarse_options(options: TrainOptions, blocks: int) -> TrainOptions:
    """The options of the coarse model, resolved."""
    most = options.most_gaussians
    share = max(_COARSE_LEAST, min(_COARSE_GAUSSIANS, _COARSE_BLOCKS / blocks))
    small = limit_gaussians(options, min(most, max(_FEWEST_GAUSSIANS, round(share * most))))
    steps = max(_FEWEST_STEPS, round(_COARSE_STEPS * options.steps))
    return dataclasses.replace(small, steps=steps, eval_every=0).resolved()


def block_options(
    options: TrainOptions, blocks: BlockOptions, visits: float, most: int
) -> TrainOptions:
    """The options of one block over all rounds, resolved.

    Args:
        options: of the run, not resolved.
        blocks: how it is divided.
        visits: how often it is trained on a view, the mean over the scene's views: 0 to 1.
        most: Gaussians that it may grow to.
    """
    until = FIRST_ROUND if blocks.rounds == 2 else 1.0
    # The regularisers are means over all Gaussians: over a block's alone each would weigh more.
    part = min(1.0, most / options.most_gaussians)
    return dataclasses.replace(
        limit_gaussians(options, most), steps=max(_FEWEST_STEPS, round(visits * options.steps)),
        opacity_regularizer=part * options.opacity_regularizer,
        scale_regularizer=part * options.scale_regularizer,
        eval_every=0, refine_poses=False, refine_lens=False, sh_every=1, test_names=None,
        densify_until=min(until, options.densify_until), init_count=None, exposure="off",
        coarse_to_fine=(0.0, 0.0),
    ).resolved()  # fmt: skip


def gaussian_bytes(sh_degree: int, trained: bool = True) -> int:
    """What a Gaussian takes in training, or as context."""
    rows = _TRAINED_ROWS if trained else _CONTEXT_ROWS
    return count_bytes_per_gaussian(sh_degree) * rows + _FRAME_BYTES


def training_bytes(scene: Scene, sh_degree: int, own: int, context: int, views: int) -> int:
    """An estimate of the memory that one training takes.

    Args:
        scene: at the size to train at.
        sh_degree: of the Gaussians.
        own, context: their numbers.
        views: whose photographs are kept decoded.
    """
    return (
        _PROGRAM_BYTES
        + own * gaussian_bytes(sh_degree)
        + context * gaussian_bytes(sh_degree, False)
        + _pixels(scene) * _PIXEL_BYTES
        + min(_PHOTOGRAPHS_KEPT, views * _pixels(scene) * (_TARGET_BYTES + _IMAGE_BYTES))
    )


def least_bytes(scene: Scene, sh_degree: int, own: int, context: int, views: int) -> int:
    """`training_bytes` where few photographs are kept decoded."""
    return training_bytes(scene, sh_degree, own, context, min(views, _FEW_VIEWS))


def photograph_bytes(
    scene: Scene, sh_degree: int, own: int, context: int, views: int, blocks: BlockOptions
) -> int:
    """What the photographs of a training may take, beside all else that is within the limit."""
    least = least_bytes(scene, sh_degree, own, context, 0)
    limit, few = memory_limit(blocks), training_bytes(scene, sh_degree, 0, 0, _FEW_VIEWS)
    few -= training_bytes(scene, sh_degree, 0, 0, 0)
    if limit is None:
        return _PHOTOGRAPHS_KEPT
    return min(_PHOTOGRAPHS_KEPT, max(few, limit // at_once(blocks) - least))


def cache_bytes(blocks: BlockOptions) -> float:
    """Of decoded pictures, and again of masks, that the driver keeps."""
    limit = memory_limit(blocks)
    return math.inf if limit is None else limit // _CACHE_PART


def drawn_bytes(blocks: BlockOptions) -> int | None:
    """Of Gaussians that are drawn to be measured; None: as many as are free."""
    limit = blocks.memory_bytes()
    return None if limit is None else max(limit - _PROGRAM_BYTES, limit // _CACHE_PART)


def at_once(blocks: BlockOptions) -> int:
    """Blocks that share the memory of a machine."""
    return blocks.workers if blocks.cluster is None else 1


def _pixels(scene: Scene) -> int:
    return max(camera.width * camera.height for camera in scene.cameras)


def memory_limit(blocks: BlockOptions) -> int | None:
    """Bytes that all workers together may take; None: nobody knows."""
    free = free_memory()
    return blocks.memory_bytes() or (None if free is None else int(_USED * free))


def choose_count(scene: Scene, options: TrainOptions, blocks: BlockOptions) -> int:
    """How many blocks: what was asked for, or as few as the memory allows, and one a worker.

    Raises:
        InputError: not even blocks of few Gaussians fit.
    """
    asked = blocks.count()
    if asked is not None:
        return asked
    limit, total = memory_limit(blocks), options.most_gaussians
    least = 1 if blocks.workers == 1 and blocks.cluster is None else 2 * blocks.workers
    count = least
    while limit is not None and needed(scene, options, blocks, count) > limit:
        count += 1 + count // 4
        if total / count < _FEWEST_GAUSSIANS:
            smallest = needed(scene, options, blocks, count)
            raise InputError(
                f"--memory {size_text(limit)}: even blocks of {total // count:,} Gaussians take "
                f"{size_text(smallest)} with {blocks.workers} worker(s); give more memory, fewer "
                "--workers or smaller images (--max-side)"
            )
    return count


def needed(scene: Scene, options: TrainOptions, blocks: BlockOptions, count: int) -> int:
    """An estimate of the memory that all workers take together with so many blocks."""
    total, views = options.most_gaussians, len(scene.train_indices)
    own = round(total / count * (_UNEVEN if count > 1 else 1.0))
    context = min(round(CONTEXT_MOST * own), total - own) if count > 1 else 0
    return at_once(blocks) * least_bytes(scene, options.sh_degree, own, max(context, 0), views)


def check_memory(sizes: dict[str, int], blocks: BlockOptions) -> None:
    """Refuses what would not fit, before it is begun.

    Args:
        sizes: bytes of each part, by a name for messages.
        blocks: limit and number of workers.

    Raises:
        InputError: the limit that was given is less than the largest part takes.
    """
    limit = blocks.memory_bytes()
    name, size = max(sizes.items(), key=lambda item: item[1])
    together = size * at_once(blocks)
    if limit is not None and together > limit:
        raise InputError(
            f"--memory {size_text(limit)}: {name} takes about {size_text(size)}"
            f"{f', times {blocks.workers} workers' if together > size else ''}; give more "
            "--blocks, fewer --workers, fewer --max-gaussians or smaller images (--max-side)"
        )


def round_of(task_options: TrainOptions, blocks: BlockOptions, number: int) -> tuple[int, int]:
    """First and last step of a block's round (from 0)."""
    steps = task_options.steps
    if blocks.rounds == 1:
        return 0, steps
    middle = round(FIRST_ROUND * steps)
    return (0, middle) if number == 0 else (middle, steps)


def check_trainable(options: TrainOptions) -> None:
    """Refuses options that are not there for blocks.

    Raises:
        InputError: names the first of them.
    """
    refused = {
        "--robust": options.robust,
        "--motion-blur": options.motion_blur is not None,
        "--surface": options.surface,
        "--compact-at": options.compact_at is not None,
        "--low-pass": options.low_pass > 0,
        "--strategy mini": options.strategy == "mini",
    }
    for flag, given in refused.items():
        if given:
            raise InputError(f"{flag} is not there for --blocks; leave one of the two out")
