"""Compacts a finished run into a new one: number to keep, fine-tuning, evaluation, files."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.compact import (
    Compaction,
    SeenView,
    check_keep,
    check_method,
    compact,
    list_seen_views,
    needs_views,
    score_gaussians,
)
from gsut.evaluate import mean_psnr
from gsut.gaussians import Gaussians
from gsut.run import RunFile, RunFolder, describe_environment, read_plan
from gsut.training.first import center_on_cameras
from gsut.training.record import TrainedRun, find_run_movers, measure, write_results
from gsut.training.tuning.finetuning import finetune, finetune_options

# Ratio of its bounds at which the search for the smallest number stops: 5 % of a file's size.
_SEARCH_RATIO = 1.05
# Smallest share of the Gaussians that is searched: no scene is recognizable below.
_SEARCH_LEAST = 0.005


@dataclasses.dataclass(frozen=True)
class CompactOptions:
    """What to make of a run. Either keep or target_psnr_drop is set.

    Attributes:
        method: see `gsut.compact`.
        keep: fraction of the Gaussians, above 0 and at most 1.
        target_psnr_drop: dB of held-out PSNR (training views if none is held out) that may be lost,
            fine-tuning included; the smallest number that satisfies it is found by bisection.
        finetune: steps on the photographs afterwards, at a fixed number of Gaussians.
        seed: of the methods that draw.

    Raises:
        InputError: a value is out of range, or both or neither of them are set.
    """

    method: str = "ghap"
    keep: float | None = None
    target_psnr_drop: float | None = None
    finetune: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.keep is None) == (self.target_psnr_drop is None):
            raise InputError("give one of --keep and --target-psnr-drop")
        if self.keep is not None:
            check_keep(self.keep)
        drop = self.target_psnr_drop
        if drop is not None and not (math.isfinite(drop) and drop > 0):
            raise InputError(f"--target-psnr-drop must be above 0 (in dB), found {drop}")
        if self.finetune < 0:
            raise InputError(f"--finetune must be 0 or more steps, found {self.finetune}")
        check_method(self.method, True)


class RunCompactor:
    """Compacts one run's Gaussians, several times if a search requires it.

    Args:
        trained: the run, whose scene has the resolution of its training.
        options: what to make.
        on_view: called after each view that is rendered for scores.
        on_step: called after each step of fine-tuning with the loop and the loss.
        on_try: called with (number of Gaussians, PSNR) after each try of the search.
    """

    def __init__(
        self,
        trained: TrainedRun,
        options: CompactOptions,
        *,
        on_view: Callable[[], object] = lambda: None,
        on_step: Callable[[Any, float], object] = lambda loop, loss: None,
        on_try: Callable[[int, float], object] = lambda count, psnr: None,
    ) -> None:
        self.scene, self.gaussians = center_on_cameras(trained.scene, trained.gaussians)
        self.train_options, self.options = trained.options, options
        self.light = trained.light
        self.on_view, self.on_step, self.on_try = on_view, on_step, on_try
        self.views: Sequence[SeenView] = ()
        if needs_views(options.method):
            self.views = list_seen_views(self.scene, trained.scene.train_indices)
        self._scores: np.ndarray | None = None  # the same for all tries
        self.compact_seconds = 0.0
        self.finetune_seconds = 0.0
        self.dropped = 0

    def make(self) -> Gaussians:
        """Returns the compacted (and fine-tuned) Gaussians in coordinates of `scene.centred`."""
        o = self.options
        if o.keep is not None:
            return self._try(keep=o.keep)
        return self._search()

    def _try(self, keep: float | None = None, count: int | None = None) -> Gaussians:
        o = self.options
        started = time.perf_counter()
        if self._scores is None:
            self._scores = score_gaussians(self.gaussians, o.method, self.views, self.on_view)
        result: Compaction = compact(
            self.gaussians, keep, count=count, method=o.method, views=self.views, seed=o.seed,
            scores=self._scores, on_view=self.on_view,
        )  # fmt: skip
        self.compact_seconds = time.perf_counter() - started
        self.dropped = result.dropped
        if not o.finetune:
            return result.gaussians
        tuned, self.finetune_seconds = finetune(
            self.scene,
            result.gaussians,
            finetune_options(self.train_options, o.finetune, len(result.gaussians)),
            self.on_step,
            self.light,
        )
        return tuned

    def _search(self) -> Gaussians:
        """Finds the smallest number that keeps the PSNR, by bisection over its logarithm."""
        assert self.options.target_psnr_drop is not None
        whole = self._psnr(self.gaussians)
        wanted = whole - self.options.target_psnr_drop
        high = len(self.gaussians)
        low = max(1, round(_SEARCH_LEAST * high))
        best = self.gaussians
        while high > _SEARCH_RATIO * low:
            count = round(math.sqrt(low * high))
            if count in (low, high):
                break
            tried = self._try(count=count)
            found = self._psnr(tried)
            self.on_try(count, found)
            if found >= wanted:
                high, best = count, tried
            else:
                low = count
        return best

    def _psnr(self, gaussians: Gaussians) -> float:
        indices = self.scene.test_indices or self.scene.train_indices
        return mean_psnr(
            self.scene, gaussians, indices, self.train_options.background, light=self.light
        )


def write_compacted_run(
    out: str | os.PathLike[str],
    source: RunFolder,
    compactor: RunCompactor,
    gaussians: Gaussians,
) -> RunFolder:
    """Evaluates compacted Gaussians and writes them as a run of their own.

    Args:
        out: a folder without a run.
        source: the run that was compacted.
        compactor: which made them.
        gaussians: the result.

    Returns:
        The new run: scene.ply, metrics.json (with `compaction`: method, counts, seconds, and the
        source's PSNR), report.html, options.json, environment.json.

    Raises:
        InputError: `out` holds a run or cannot be written.
    """
    scene, options = compactor.scene, compactor.train_options
    tuned = compactor.options.finetune
    if tuned:
        options = finetune_options(options, tuned, len(gaussians))
    environment = describe_environment(scene.path)
    if read_plan(source) is None:  # the digests of blocks are of the dataset as it is in the files
        environment["digests"] = (source.read_json(RunFile.ENVIRONMENT) or {}).get("digests")
    run = RunFolder.create(out, options, environment=environment, command="compact")
    before = source.read_json(RunFile.METRICS) or {}
    indices, light = scene.test_indices or scene.train_indices, compactor.light
    _, metrics = measure(
        TrainedRun(options, scene, gaussians, light), indices, run,
        steps=int(before.get("steps") or 0) + tuned,
        train_seconds=float(before.get("train_seconds") or 0.0) + compactor.finetune_seconds,
        find_movers=lambda judged: find_run_movers(source, gaussians, judged, indices, light),
    )  # fmt: skip
    metrics["compaction"] = {
        "method": compactor.options.method,
        "source": str(Path(source.path).resolve()),
        "source_num_gaussians": len(compactor.gaussians),
        "source_psnr": before.get("psnr"),
        "source_render_ms": before.get("render_ms"),
        "dropped": compactor.dropped,
        "finetune_steps": tuned,
        "compact_seconds": compactor.compact_seconds,
        "finetune_seconds": compactor.finetune_seconds,
    }
    refined = scene if source.read_json(RunFile.REFINED) is not None else None
    write_results(run, gaussians, metrics, scene.path, refined, compactor.train_options)
    return run
