"""Runs the stages of a training in blocks; each leaves its result in the folder."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut.blocks.board import Board, Counter
from gsut.blocks.cluster import Cluster
from gsut.blocks.coarse import Coarse, train_coarse
from gsut.blocks.layout import Layout, cut_scene
from gsut.blocks.plan import (
    ROUNDS,
    TrainingSize,
    check_memory,
    choose_coarse_scale,
    choose_count,
    limit_cache_bytes,
    limit_drawn_bytes,
    make_coarse_options,
)
from gsut.blocks.shares import Shares, find_shares, measure_work
from gsut.blocks.stage_clock import StageClock
from gsut.blocks.store import BlockStore
from gsut.blocks.task import Trained
from gsut.blocks.tasks import TaskMaker
from gsut.blocks.workers import FIGURES, Job, Workers, write_state
from gsut.data import Scene
from gsut.data.scene import keep_at_most
from gsut.evaluate import evaluate
from gsut.formats import load_ply, open_ply
from gsut.gaussians import Gaussians
from gsut.run import (
    BlockOptions,
    Progress,
    RunFile,
    RunFolder,
    TrainOptions,
    read_plan,
)
from gsut.system import rename_over
from gsut.training.first import choose_number, find_plain_background
from gsut.training.record import (
    TrainedRun,
    describe_place,
    list_scene_comments,
    measure,
    write_findings,
)

# Held-out views that each round is measured on, spread evenly.
_CURVE_VIEWS = 8
# Path of the layout in the run's folder.
_LAYOUT = f"{RunFile.BLOCKS}/layout.json"


@dataclasses.dataclass(frozen=True)
class BlocksResult:
    """The result of `train_blocks`.

    Attributes:
        path: of scene.ply.
        metrics: the content of metrics.json; "blocks" is about the blocks.
        scene: at the size trained at, with the poses and lens of the coarse model.
        layout: which block a point lies in.
    """

    path: Path
    metrics: dict[str, Any]
    scene: Scene
    layout: Layout

    @functools.cached_property
    def gaussians(self) -> Gaussians:
        """The Gaussians in the dataset's coordinates; read at the first use."""
        return load_ply(self.path)

    def __repr__(self) -> str:
        psnr, count = self.metrics["psnr"], self.metrics["num_gaussians"]
        judged = "" if psnr is None else f", {psnr:.2f} dB on {self.metrics['evaluated_on']}"
        return f"BlocksResult({count} Gaussians, {len(self.layout)} blocks{judged})"


class Stages:
    """Holds a training in blocks and runs its stages.

    Args:
        run: folder, with the plan that the run started with.
        options: of the run as they were first given.
        blocks: how it is divided.
        scene: at the size to train at, centred on its cameras.
        engine: trains blocks.
        progress: show bars.
        degree_because: see `choose_degree`.

    Attributes:
        clock: of the stages.
    """

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
        degree_because: str = "",
    ) -> None:
        self._run, self._blocks, self._progress = run, blocks, progress
        self._engine = engine
        if options.background is None:
            options = dataclasses.replace(options, background=find_plain_background(scene))
        number, self._notes = choose_number(scene, options)
        self._notes += [degree_because] if degree_because else []
        self._options = dataclasses.replace(options, max_gaussians=number)
        self._scene = scene
        self._folder = run.path / RunFile.BLOCKS
        self.clock = StageClock(run)
        self._peak: dict[int, float] = {}
        self._count = self._choose_count()
        self._shares: Shares | None = None
        self._turn = 0  # of the store

    def _choose_count(self) -> int:
        """Returns the number of blocks; a resumed run keeps its own."""
        plan = read_plan(self._run) or {}
        if "count" not in plan:
            plan["count"] = choose_count(self._scene, self._options, self._blocks)
            self._run.write_json(RunFile.PLAN, plan)
        return int(plan["count"])

    def train_coarse(self) -> Coarse:
        """Trains the coarse model, if it fits into memory."""
        options = make_coarse_options(self._options, self._count)
        scale = choose_coarse_scale(self._scene)
        small = self._scene if scale == 1.0 else self._scene.scale_images(scale)
        views = len(small.train_indices)
        size = TrainingSize(small, options.sh_degree, options.most_gaussians, 0, views)
        alone = dataclasses.replace(self._blocks, workers=1)
        if self._blocks.parse_memory():
            check_memory({"the coarse model": size.estimate_least_bytes()}, alone)
        keep = size.limit_photograph_bytes(alone)
        coarse = train_coarse(self._scene, options, self._folder, self._progress, keep)
        keep_at_most(self._scene, 0)
        return coarse

    def choose_layout(self) -> Layout:
        """Reads the layout of the run, or chooses one by bisection."""
        path, g, scene = self._run.path / _LAYOUT, self.coarse.gaussians, self.coarse.scene
        if path.is_file():
            layout = Layout.read(str(path))
        else:
            small = scene.scale_images(choose_coarse_scale(scene))
            with Progress(self._progress) as bar:
                seen = Counter(bar, "layout", len(scene.train_indices))
                work = measure_work(g, small, scene.train_indices, seen.advance)
            points = g.means.astype(np.float64) + scene.world_offset
            layout = cut_scene(points, work, self._count)
            self._run.write_json(_LAYOUT, layout.as_dict())
        self._store = BlockStore(self._folder, layout, self._scene.world_offset)
        self._store.begin(Trained(g))
        return layout

    def list_turns(self, number: int) -> list[range]:
        """Returns the blocks of a round that are trained beside each other, turn after turn.

        In the second round blocks correct what their seams show. Two that do so at once would both
        correct it, so that one half sees what the other has become.
        """
        count = len(self.layout)
        list_turns = [range(count)] if number == 0 else [range(0, count, 2), range(1, count, 2)]
        return [turn for turn in list_turns if turn]

    def write_tasks(self, number: int, turn: range) -> list[Job]:
        """Writes the tasks of some blocks in a round, from the Gaussians of all.

        Raises:
            InputError: a block would exceed the given memory.
        """
        jobs = [self._make_job(block, number) for block in turn]
        missing = [job for job in jobs if not (job.task.is_file() or job.state.is_file())]
        if not missing:
            return jobs
        coarse, scene = self.coarse, self.coarse.scene
        small = scene.scale_images(choose_coarse_scale(scene))
        keep_at_most(small, limit_cache_bytes(self._blocks))
        with Progress(self._progress) as bar:
            if self._shares is None:
                seen = Counter(bar, "views", len(scene.train_indices))
                self._shares = find_shares(
                    coarse.gaussians, self._store.find_owners(coarse.gaussians), len(self.layout),
                    small, scene, scene.train_indices, seen.advance,
                )  # fmt: skip
            maker = TaskMaker(
                self._options, self._blocks, coarse, small, self._shares, self._store, self._turn,
                number,
            )  # fmt: skip
            check_memory(
                {f"block {job.block}": maker.estimate_memory(job.block) for job in jobs},
                self._blocks,
            )
            for job in bar.iterate("tasks", missing):
                job.task.parent.mkdir(exist_ok=True)
                task = maker.make_task(job.block)
                if task is None:  # nothing to train, or no view that shows it
                    write_state(job.state, _make_untrained_state(maker.make_own(job.block)))
                else:
                    write_state(job.task, task.as_dict())
        return jobs

    def _make_job(self, block: int, number: int) -> Job:
        folder = self._folder / f"b{block:03d}"
        return Job(block, folder / f"task{number + 1}.npz", folder / f"state{number + 1}.npz")

    def run_turn(self, jobs: list[Job]) -> None:
        """Trains blocks and replaces their Gaussians by the trained ones."""
        board = Board(jobs, self._progress)
        try:
            self._engine.run(jobs, board.report)
        finally:
            board.close()
            _core.set_num_threads(self._options.threads)
        self._peak |= {b: max(self._peak.get(b, 0.0), mb) for b, mb in board.peaks.items()}
        trained = {job.block: job for job in jobs}

        def read_part(block: int) -> Trained:
            if block in trained:
                return Trained.from_dict(_read_figures(trained[block], ("own", "moments")))
            return self._store.read_block(block, self._turn)

        parts = [functools.partial(read_part, block) for block in range(len(self.layout))]
        self._store.sort(self._turn + 1, parts)
        self._turn += 1

    def note(self, number: int) -> None:
        """Writes the scene after a round, and a row of the history."""
        flat = self._options.primitive == "surfel"
        comments = list_scene_comments(self._run, self.coarse.light is not None)
        self._place = self._store.save(self._folder / RunFile.SCENE, self._turn, comments, flat)
        jobs = (self._make_job(block, number) for block in range(len(self.layout)))
        step = sum(int(_read_figures(job)["step"]) for job in jobs)
        scene = self.coarse.scene
        row: dict[str, Any] = {
            "step": step, "num_gaussians": sum(self._store.count_gaussians(self._turn)),
            "seconds": sum(self.clock.seconds.values()),
        }  # fmt: skip
        test = scene.test_indices
        if test and not self._options.refine_poses:
            chosen = test[:: -(-len(test) // _CURVE_VIEWS)]
            light, background = self.coarse.light, self._options.background
            figures = evaluate(
                self._open_scene(), scene, chosen, background=background, light=light
            )  # fmt: skip
            row["psnr"] = figures["psnr"]
        self._run.history.roll_back(step - 1)
        self._run.history.append(row)

    def _open_scene(self) -> Any:
        """Opens all Gaussians in the scene's coordinates; they stay in their file if memory is
        short."""
        limit = limit_drawn_bytes(self._blocks)
        return open_ply(self._folder / RunFile.SCENE, limit).translate(-self._scene.world_offset)

    def finish(self) -> BlocksResult:
        """Measures the scene and writes what `train` writes, with figures of the blocks."""
        scene, o = self.coarse.scene, self._options
        rows = self._make_rows()
        steps = sum(row["steps"] for row in rows)
        seconds = self.coarse.seconds + sum(row["seconds"] for row in rows)
        chosen = scene.test_indices or scene.train_indices[:_CURVE_VIEWS]
        scene, metrics = measure(
            TrainedRun(o, scene, self._open_scene(), self.coarse.light), chosen, self._run,
            steps=steps, train_seconds=seconds, align=o.refine_poses,
        )  # fmt: skip
        metrics["notes"] += self._notes
        if self.coarse.figures is not None:
            metrics["refinement"] = self.coarse.figures
        metrics["blocks"] = {
            "count": len(self.layout), "rounds": ROUNDS,
            "workers": self._blocks.workers, "rows": rows, "stages": self.clock.seconds,
            "coarse": {"gaussians": len(self.coarse.gaussians), "pixels": self.coarse.pixels,
                       "steps": make_coarse_options(o, self._count).steps,
                       "seconds": self.coarse.seconds},
            "pixels": self.coarse.pixels + sum(row["pixels"] for row in rows),
        }  # fmt: skip
        metrics["notes"] += describe_place(self._place)
        rename_over(self._folder / RunFile.SCENE, self._run.path / RunFile.SCENE)
        write_findings(
            self._run, metrics, scene.path, scene if o.refine_poses else None,
            self._run.read_given_options(), self._blocks.list_words(),
        )  # fmt: skip
        scene = scene.move_origin((0.0, 0.0, 0.0))
        return BlocksResult(self._run.path / RunFile.SCENE, metrics, scene, self.layout)

    def _make_rows(self) -> list[dict[str, Any]]:
        """Returns the figures of each block over all rounds."""
        counts = self._store.count_gaussians(self._turn)
        rows = []
        for block in range(len(self.layout)):
            jobs = [self._make_job(block, number) for number in range(ROUNDS)]
            states = [_read_figures(job) for job in jobs]
            rows.append({
                "block": block, "gaussians": counts[block],
                "views": max(int(state.get("views", 0)) for state in states),
                "steps": int(states[-1]["step"]),
                "seconds": sum(float(state["seconds"]) for state in states),
                "pixels": sum(int(state["pixels"]) for state in states),
                "bytes": sum(f.stat().st_size for f in jobs[0].state.parent.glob("*.npz")),
                "peak_rss_mb": self._peak.get(block),
            })  # fmt: skip
        return rows


def _read_figures(job: Job, names: Collection[str] = FIGURES) -> dict[str, Any]:
    """Reads entries of the state of a trained block."""
    state = job.read_state(names)
    assert state is not None
    return state


def _make_untrained_state(own: Trained) -> dict[str, Any]:
    """Returns the state of a block that no view shows."""
    empty: dict[str, Any] = dict.fromkeys(FIGURES, 0)
    return empty | {"finished": True} | own.as_dict()
