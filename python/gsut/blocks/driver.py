"""A training in blocks, stage after stage: read `train_blocks` first."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.blocks.block_map import write_map
from gsut.blocks.board import Board, Counter
from gsut.blocks.cluster import Cluster
from gsut.blocks.coarse import Coarse, train_coarse
from gsut.blocks.layout import Layout, bisect
from gsut.blocks.plan import (
    check_memory,
    check_trainable,
    choose_count,
    coarse_options,
    coarse_scale,
    training_bytes,
)
from gsut.blocks.shares import Shares, find_shares, work_of
from gsut.blocks.task import gaussian_arrays
from gsut.blocks.tasks import TaskMaker
from gsut.blocks.workers import Job, Workers, write_state
from gsut.data import Scene, scene_digests
from gsut.evaluate import mean_psnr
from gsut.files import UNFINISHED, plain
from gsut.gaussians import Gaussians, merged, order_for_reading
from gsut.run import (
    BLOCKS,
    PLAN,
    BlockOptions,
    Progress,
    RunFolder,
    TrainOptions,
    describe_environment,
    read_plan,
)
from gsut.training import (
    choose_complexity,
    measure,
    plain_background,
    prepare_scene,
    with_most,
    write_results,
)

_CURVE_VIEWS = 8  # held out, that each round is measured on
_LAYOUT, _STAGES = f"{BLOCKS}/layout.json", f"{BLOCKS}/stages.json"


@dataclasses.dataclass(frozen=True)
class BlocksResult:
    """The result of `train_blocks`.

    Attributes:
        gaussians: of all blocks, in the dataset's coordinates.
        metrics: the content of metrics.json; what concerns the blocks is in its "blocks".
        scene: at the size trained at, with the poses and lens as the coarse model found them.
        layout: which block a point lies in.
    """

    gaussians: Gaussians
    metrics: dict[str, Any]
    scene: Scene
    layout: Layout

    def __repr__(self) -> str:
        psnr = self.metrics["psnr"]
        judged = "" if psnr is None else f", {psnr:.2f} dB on {self.metrics['evaluated_on']}"
        return f"BlocksResult({self.gaussians}, {len(self.layout)} blocks{judged})"


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
        blocks: how it is divided; None: in as few blocks as the free memory allows.
        out: run folder, which gets what `train` writes and the blocks' states.
        resume: go on from the states in `out`, to the same bits.
        progress: show bars.

    Returns:
        Gaussians, metrics, scene, layout. The same seed gives the same bits with any number of
        workers and threads, whichever of them are killed meanwhile, given one instruction set.

    Raises:
        InputError: an option out of range or not there for blocks, memory that does not suffice,
            `out` holds a run, or a worker fails again and again.
        DatasetError: a photograph or a mask cannot be used.
    """
    o, b = options or TrainOptions(), blocks or BlockOptions()
    check_trainable(o)
    _core.set_num_threads(o.threads)
    if not scene.train_indices:
        raise InputError(f"{scene.path} has no training view; hold out fewer (--test-every)")
    near = prepare_scene(scene.centred, o.resolved())
    near.check_pixels()
    engine = Workers(b.workers, o.threads) if b.cluster is None else Cluster(b.cluster)
    run, o = _open_run(out, o, b, scene, resume)
    training = _Training(run, o, b, near, engine, progress)
    with training.stage("coarse"):
        training.coarse = training.train_coarse()  # everything; poses, lens and light, then frozen
    with training.stage("layout"):
        training.layout = training.choose_layout()  # bisection of the work
    gaussians = training.coarse.gaussians
    for number in range(b.rounds):
        for turn in training.turns(number):
            with training.stage(f"tasks {number + 1}"):
                jobs = training.write_tasks(number, turn, gaussians)  # views, pixels, context
            with training.stage(f"round {number + 1}"):
                gaussians = training.run_turn(jobs, gaussians)  # workers; merge by ownership
        training.note(number, gaussians)
    with training.stage("measure"):
        return training.finish(gaussians, scene)


def _open_run(
    out: Any, options: TrainOptions, blocks: BlockOptions, scene: Scene, resume: bool
) -> tuple[RunFolder, TrainOptions]:
    """The folder, and the options as they were first given: those of a run have none left out.

    Raises:
        InputError: see `RunFolder.create`; or the run to resume was begun with another division,
            version or instruction set.
    """
    environment = describe_environment(scene.path) | {"digests": scene_digests(scene)}
    counted = blocks.count() or blocks.blocks == "auto"
    given = None if counted else Layout.read(blocks.blocks).as_dict()
    division = {"blocks": blocks.blocks if given is None else given, "rounds": blocks.rounds}
    now = plain(division | {"version": _core.__version__, "isa": _core.active_isa()})
    first = {"plan.json": now} | ({} if given is None else {"layout.json": given})
    run = RunFolder.create(out, options, resume=resume, environment=environment, blocks=first)
    plan = read_plan(run) or {}
    for name, value in now.items():
        if plan[name] != value:
            hint = " (set GSUT_ISA)" if name == "isa" else ""
            raise InputError(
                f"{run.path} was begun with {name} {plan[name]}, not {value}; a resumed run keeps "
                f"it{hint}, or begin a new run"
            )
    for leftover in (run.path / BLOCKS).rglob(UNFINISHED + "*"):
        leftover.unlink()
    return run, dataclasses.replace(run.begun_with(), threads=options.threads)


class _Training:
    """The stages of one training in blocks; what they leave is in the folder."""

    coarse: Coarse
    layout: Layout

    def __init__(
        self,
        run: RunFolder,
        options: TrainOptions,
        blocks: BlockOptions,
        scene: Scene,
        engine: Workers | Cluster,
        progress: bool,
    ) -> None:
        self._run, self._blocks, self._progress = run, blocks, progress
        self._engine = engine
        if options.background is None:
            options = dataclasses.replace(options, background=plain_background(scene))
        self._complexity = choose_complexity(scene, options.resolved())
        self._options = with_most(options, self._complexity.max_gaussians)
        self._scene = scene
        self._folder = run.path / BLOCKS
        self._stages: dict[str, dict[str, float]] = run.read_json(_STAGES) or {}
        self._peak: dict[int, float] = {}
        self._count = self._agreed_count()
        self._shares: Shares | None = None

    def _agreed_count(self) -> int:
        """The number of blocks; a run that is resumed keeps its own."""
        plan = read_plan(self._run) or {}
        if "count" not in plan:
            layout = self._run.path / _LAYOUT  # as it was given
            if layout.is_file():
                plan["count"] = len(Layout.read(str(layout)))
            else:
                plan["count"] = choose_count(self._scene, self._options, self._blocks)
            self._run.write_json(PLAN, plan)
        return int(plan["count"])

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the seconds of a stage, and what it wrote, to those of the run."""
        began, before = time.perf_counter(), self._bytes()
        try:
            yield
        finally:
            row = self._stages.setdefault(name, {"seconds": 0.0, "bytes": 0})
            row["seconds"] += time.perf_counter() - began
            row["bytes"] += self._bytes() - before
            self._run.write_json(_STAGES, self._stages)

    def _bytes(self) -> int:
        return sum(file.stat().st_size for file in self._folder.rglob("*.npz"))

    def train_coarse(self) -> Coarse:
        """The coarse model, after a look at whether it fits."""
        options = coarse_options(self._options, self._count)
        scale = coarse_scale(self._scene)
        small = self._scene if scale == 1.0 else self._scene.scaled(scale)
        views = len(small.train_indices)
        size = training_bytes(small, options.sh_degree, options.most_gaussians, 0, views)
        if self._blocks.memory_bytes():
            check_memory({"the coarse model": size}, dataclasses.replace(self._blocks, workers=1))
        return train_coarse(self._scene, options, self._folder, self._progress)

    def choose_layout(self) -> Layout:
        """As the file says that was given, as it was before, or by bisection."""
        path = self._run.path / _LAYOUT
        if path.is_file():
            return Layout.read(str(path))
        g, scene = self.coarse.gaussians, self.coarse.scene
        small = scene.scaled(coarse_scale(scene))
        with Progress(self._progress) as bar:
            seen = Counter(bar, "layout", len(scene.train_indices))
            work = work_of(g, small, scene.train_indices, seen.one)
        centers = np.array([scene.views[i].camera_center for i in scene.train_indices])
        points = g.means.astype(np.float64) + scene.world_offset
        layout = bisect(points, work, centers + scene.world_offset, self._count)
        self._run.write_json(_LAYOUT, layout.as_dict())
        return layout

    def _owners(self, gaussians: Gaussians) -> np.ndarray:
        points = gaussians.means.astype(np.float64) + self._scene.world_offset
        return self.layout.owners(points)

    def turns(self, number: int) -> list[range]:
        """The blocks of a round that are trained beside each other, turn after turn.

        In the second round, where blocks correct what their seams show, two that do so at once
        would both correct it: the one half sees what the other has become.
        """
        count = len(self.layout)
        turns = [range(count)] if number == 0 else [range(0, count, 2), range(1, count, 2)]
        return [turn for turn in turns if turn]

    def write_tasks(self, number: int, turn: range, gaussians: Gaussians) -> list[Job]:
        """The tasks of some blocks in a round, from the Gaussians of all.

        Raises:
            InputError: a block would take more than the memory that was given.
        """
        jobs = [self._job(block, number) for block in turn]
        missing = [job for job in jobs if not (job.task.is_file() or job.state.is_file())]
        if not missing:
            return jobs
        coarse, scene = self.coarse, self.coarse.scene
        small = scene.scaled(coarse_scale(scene))
        with Progress(self._progress) as bar:
            if self._shares is None:
                seen = Counter(bar, "views", len(scene.train_indices))
                self._shares = find_shares(
                    coarse.gaussians, self._owners(coarse.gaussians), len(self.layout), small,
                    scene, scene.train_indices, seen.one,
                )  # fmt: skip
            maker = TaskMaker(
                self._options, self._blocks, coarse, small, self._shares,
                self._owners(coarse.gaussians), gaussians, self._owners(gaussians), number,
            )  # fmt: skip
            check_memory(
                {f"block {job.block}": maker.memory(job.block) for job in jobs}, self._blocks
            )
            for job in bar.through("tasks", missing):
                job.task.parent.mkdir(exist_ok=True)
                task = maker.task(job.block)
                if task is None:  # nothing to train, or no view that shows it
                    write_state(job.state, _untrained(maker.own(job.block)))
                else:
                    write_state(job.task, task.as_dict())
        return jobs

    def _job(self, block: int, number: int) -> Job:
        folder = self._folder / f"b{block:03d}"
        return Job(block, folder / f"task{number + 1}.npz", folder / f"state{number + 1}.npz")

    def run_turn(self, jobs: list[Job], gaussians: Gaussians) -> Gaussians:
        """Trains blocks; the Gaussians of all, theirs replaced, in the order of the blocks."""
        board = Board(jobs, self._progress)
        try:
            self._engine.run(jobs, board.report)
        finally:
            board.close()
            _core.set_num_threads(self._options.threads)
        self._peak = {b: max(self._peak.get(b, 0.0), mb) for b, mb in board.peaks.items()}
        owners, parts = self._owners(gaussians), []
        trained = {job.block: job for job in jobs}
        for block in range(len(self.layout)):
            if block not in trained:
                parts.append(gaussians[owners == block])
                continue
            part = Gaussians(**_state_of(trained[block])["result"])
            parts.append(part[order_for_reading(part)])
        return merged(parts)

    def note(self, number: int, gaussians: Gaussians) -> None:
        """A row of the history: what a round came to."""
        jobs = (self._job(block, number) for block in range(len(self.layout)))
        step = sum(int(_state_of(job)["step"]) for job in jobs)
        scene = self.coarse.scene
        row: dict[str, Any] = {
            "step": step, "num_gaussians": len(gaussians),
            "seconds": sum(row["seconds"] for row in self._stages.values()),
        }  # fmt: skip
        test = scene.test_indices
        if test and not self._options.refine_poses:
            chosen = test[:: -(-len(test) // _CURVE_VIEWS)]
            light, background = self.coarse.light, self._options.background
            row["psnr"] = mean_psnr(scene, gaussians, chosen, background, light=light)
        self._run.roll_back_history(step - 1)
        self._run.append_history(row)

    def finish(self, gaussians: Gaussians, given: Scene) -> BlocksResult:
        """Measures and writes what `train` writes, and how the blocks went."""
        scene, o = self.coarse.scene, self._options
        resolved = dataclasses.replace(o.resolved(), background=o.background)
        rows = self._rows(gaussians)
        steps = sum(row["steps"] for row in rows)
        seconds = self.coarse.seconds + sum(row["seconds"] for row in rows)
        chosen = scene.test_indices or scene.train_indices[:_CURVE_VIEWS]
        scene, metrics = measure(
            gaussians, scene, chosen, resolved, self._run, steps=steps, train_seconds=seconds,
            align=o.refine_poses, light=self.coarse.light,
        )  # fmt: skip
        self._complexity.tell(metrics)
        if self.coarse.figures is not None:
            metrics["refinement"] = self.coarse.figures
        write_map(self._folder, gaussians, self._owners(gaussians), scene)
        metrics["blocks"] = {
            "count": len(self.layout), "rounds": self._blocks.rounds,
            "workers": self._blocks.workers, "rows": rows, "stages": self._stages,
            "coarse": {"gaussians": len(self.coarse.gaussians), "pixels": self.coarse.pixels,
                       "steps": coarse_options(o, self._count).steps,
                       "seconds": self.coarse.seconds},
            "pixels": self.coarse.pixels + sum(row["pixels"] for row in rows),
        }  # fmt: skip
        refined = scene if o.refine_poses else None
        write_results(self._run, gaussians, metrics, scene.path, refined)
        gaussians = gaussians.translated(scene.world_offset)
        return BlocksResult(gaussians, metrics, scene.about((0.0, 0.0, 0.0)), self.layout)

    def _rows(self, gaussians: Gaussians) -> list[dict[str, Any]]:
        """What each block took, of all rounds together."""
        counts = np.bincount(self._owners(gaussians), minlength=len(self.layout))
        rows = []
        for block in range(len(self.layout)):
            jobs = [self._job(block, number) for number in range(self._blocks.rounds)]
            states = [_state_of(job) for job in jobs]
            rows.append({
                "block": block, "gaussians": int(counts[block]),
                "views": max(int(state.get("views", 0)) for state in states),
                "steps": int(states[-1]["step"]),
                "seconds": sum(float(state["seconds"]) for state in states),
                "pixels": sum(int(state["pixels"]) for state in states),
                "bytes": sum(f.stat().st_size for f in jobs[0].state.parent.glob("*.npz")),
                "peak_rss_mb": self._peak.get(block),
            })  # fmt: skip
        return rows


def _state_of(job: Job) -> dict[str, Any]:
    """The state of a block that was trained."""
    state = job.read_state()
    assert state is not None
    return state


def _untrained(own: Gaussians) -> dict[str, Any]:
    """The state of a block that no view shows."""
    empty: dict[str, Any] = dict.fromkeys(("segment", "step", "seconds", "pixels", "views"), 0)
    return empty | {"result": gaussian_arrays(own)}
