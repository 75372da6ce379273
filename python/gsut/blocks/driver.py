"""Trains a scene in blocks, stage after stage: read `train_blocks` first."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.blocks.cluster import Cluster
from gsut.blocks.plan import ROUNDS, check_trainable, limit_cache_bytes
from gsut.blocks.stages import BlocksResult, Stages
from gsut.blocks.workers import Workers
from gsut.bounds import name_wrong_kinds
from gsut.data import Scene
from gsut.data.scene import digest_scene, keep_at_most
from gsut.files import UNFINISHED, to_plain
from gsut.run import (
    BlockOptions,
    Progress,
    RunFile,
    RunFolder,
    TrainOptions,
    describe_environment,
    read_plan,
)
from gsut.training import choose_degree
from gsut.training.first import prepare_scene
from gsut.training.surface import check_maps

# Version of the tasks' format; tasks of another version cannot be resumed.
_TASKS = 5


@name_wrong_kinds
def train_blocks(
    scene: Scene,
    options: TrainOptions | None = None,
    blocks: BlockOptions | None = None,
    *,
    out: str | os.PathLike[str],
    resume: bool = False,
    progress: bool = True,
) -> BlocksResult:
    """Trains a scene in blocks: in bounded memory, side by side, on one machine or many.

    Args:
        scene: from `load_dataset`.
        options: every setting of the run; None: the defaults.
        blocks: how it is divided; None: as few blocks as the free memory allows.
        out: run folder, which gets what `train` writes and the blocks' states.
        resume: continue from the states in `out`, to the same bits.
        progress: show bars.

    Returns:
        Gaussians, metrics, scene, layout. The same seed gives the same bits with any number of
        workers and threads, even if some are killed, given one instruction set.

    Raises:
        InputError: an option is out of range or not supported for blocks, memory does not suffice,
            `out` holds a run, or a worker fails repeatedly.
        DatasetError: a photograph or a mask cannot be used.
    """
    o, b = options or TrainOptions(), blocks or BlockOptions()
    check_trainable(o)
    _core.set_num_threads(o.threads)
    if not scene.train_indices:
        raise InputError(f"{scene.path} has no training view; hold out fewer (--test-every)")
    near = prepare_scene(scene.centred, o)
    keep_at_most(near, limit_cache_bytes(b))
    near.check_pixels()
    check_maps(near)
    with Progress(progress) as bar:
        o, degree_because = choose_degree(near, o, bar.show)
    engine = Workers(b.workers, o.threads) if b.cluster is None else Cluster(b.cluster)
    run, o = _open_run(out, o, b, scene, resume)
    training = Stages(run, o, b, near, engine, progress, degree_because)
    with training.clock.stage("coarse"):
        training.coarse = training.train_coarse()  # everything; poses, lens and light, then frozen
    with training.clock.stage("layout"):
        training.layout = training.choose_layout()  # bisection of the work
    for number in range(ROUNDS):
        for turn in training.list_turns(number):
            with training.clock.stage(f"tasks {number + 1}"):
                jobs = training.write_tasks(number, turn)  # views, pixels, context
            with training.clock.stage(f"round {number + 1}"):
                training.run_turn(jobs)  # workers; merge by ownership
        training.note(number)
    with training.clock.stage("measure"):
        return training.finish()


def _open_run(
    out: Any, options: TrainOptions, blocks: BlockOptions, scene: Scene, resume: bool
) -> tuple[RunFolder, TrainOptions]:
    """Opens the run's folder; returns it and the options that the run started with.

    Raises:
        InputError: see `RunFolder.create`; or the run to resume has another division, version or
            instruction set.
    """
    environment = describe_environment(scene.path) | {"digests": digest_scene(scene)}
    now = to_plain({
        "blocks": blocks.blocks, "tasks": _TASKS, "version": _core.__version__,
        "isa": _core.active_isa(),
    })  # fmt: skip
    run = RunFolder.create(
        out, options, resume=resume, environment=environment, blocks={"plan.json": now}
    )
    plan = read_plan(run) or {}
    for name, value in now.items():
        if plan.get(name) != value:
            hint = " (set GSUT_ISA)" if name == "isa" else ""
            raise InputError(
                f"{run.path} was started with {name} {plan.get(name)}, not {value}; a resumed run "
                f"keeps it{hint}, or start a new run"
            )
    for leftover in (run.path / RunFile.BLOCKS).rglob(UNFINISHED + "*"):
        leftover.unlink()
    return run, dataclasses.replace(run.read_given_options(), threads=options.threads)
