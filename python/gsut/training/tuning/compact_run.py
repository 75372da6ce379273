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
    drop_harmonics,
    list_seen_views,
    needs_views,
    score_gaussians,
)
from gsut.evaluate import mean_psnr
from gsut.gaussians import Gaussians, MixedGaussians, pack_harmonics
from gsut.run import RunFile, RunFolder, describe_environment, read_plan
from gsut.run.options import AUTO
from gsut.training.first import center_on_cameras
from gsut.training.loop import TrainingLoop
from gsut.training.record import TrainedRun, find_run_movers, measure, write_results
from gsut.training.tuning.finetuning import finetune, finetune_options
from gsut.training.tuning.from_start import FROM_START, FromStart

# Ratio of its bounds at which the search for the smallest number stops: 5 % of a file's size.
_SEARCH_RATIO = 1.05
# Smallest share of the Gaussians that is searched: no scene is recognizable below.
_SEARCH_LEAST = 0.005
# Bytes of a float in a PLY file.
_FLOAT_BYTES = 4
# Floats of a row of a 3DGS PLY without harmonics: position, normal, opacity, scales, rotation.
_ROW_FLOATS = 14
# Bytes of the header, more than any that save_ply writes.
_HEADER_BYTES = 2048
# Method of --method auto: the best one at most numbers kept.
_AUTO_MERGES = "ghap"


@dataclasses.dataclass(frozen=True)
class CompactOptions:
    """What to make of a run. Exactly one of keep, target_psnr_drop and target_bytes is set.

    Attributes:
        method: see `gsut.compact`; auto: ghap, or training from the start if
            `FromStart.is_better`.
        keep: fraction of the Gaussians, above 0 and at most 1.
        target_psnr_drop: dB of held-out PSNR (training views if none is held out) that may be lost,
            fine-tuning included; the smallest number that satisfies it is found by bisection.
        target_bytes: largest size of scene.ply.
        finetune: steps on the photographs afterwards, at a fixed number of Gaussians.
        harmonics_drop: dB of the same PSNR that may be lost by lowering each Gaussian's degree of
            harmonics afterwards; None leaves the harmonics alone.
        seed: of the methods that draw.

    Raises:
        InputError: a value is out of range, or not exactly one target is set.
    """

    method: str = AUTO
    keep: float | None = None
    target_psnr_drop: float | None = None
    target_bytes: int | None = None
    finetune: int = 0
    harmonics_drop: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        targets = (self.keep, self.target_psnr_drop, self.target_bytes)
        if sum(target is not None for target in targets) != 1:
            raise InputError("give one of --keep, --target-psnr-drop and --target-size")
        if self.keep is not None:
            check_keep(self.keep)
        drop = self.target_psnr_drop
        if drop is not None and not (math.isfinite(drop) and drop > 0):
            raise InputError(f"--target-psnr-drop must be above 0 (in dB), found {drop}")
        drop = self.harmonics_drop
        if drop is not None and not (math.isfinite(drop) and drop >= 0):
            raise InputError(f"--harmonics-drop must be 0 or more (in dB), found {drop}")
        if self.finetune < 0:
            raise InputError(f"--finetune must be 0 or more steps, found {self.finetune}")
        check_method(self.merging, True)

    @property
    def merging(self) -> str:
        """The method that compacts, with auto resolved."""
        return _AUTO_MERGES if self.method == AUTO else self.method


def count_for_bytes(gaussians: Gaussians, size: int) -> int:
    """Returns how many Gaussians of this degree of harmonics fit into a PLY file of `size` bytes.

    Raises:
        InputError: not even one fits.
    """
    row = _FLOAT_BYTES * (_ROW_FLOATS + 3 * gaussians.sh.shape[1])
    count = (size - _HEADER_BYTES) // row
    if count < 1:
        raise InputError(
            f"--target-size of {size} bytes is too small: a PLY file with one Gaussian of degree "
            f"{gaussians.sh_degree} needs {_HEADER_BYTES + row}"
        )
    return min(len(gaussians), count)


class RunCompactor:
    """Compacts one run's Gaussians, several times if a search requires it.

    Args:
        trained: the run, whose scene has the resolution of its training.
        options: what to make.
        keep_degrees: fine-tuning keeps each Gaussian's degree of harmonics, which was chosen.
        on_view: called after each view that is rendered for scores.
        on_step: called after each step of fine-tuning with the loop and the loss.
        on_try: called with (number of Gaussians, PSNR) after each try of the search.

    Attributes:
        method: of the compaction; "from_start" if Gaussians are trained anew instead.
        because: the reason for training anew, in a sentence; "" for a compaction.
        anew: that training, finished; None for a compaction.
    """

    def __init__(
        self,
        trained: TrainedRun,
        options: CompactOptions,
        *,
        keep_degrees: bool = False,
        on_view: Callable[[], object] = lambda: None,
        on_step: Callable[[Any, float], object] = lambda loop, loss: None,
        on_try: Callable[[int, float], object] = lambda count, psnr: None,
    ) -> None:
        self.scene, self.gaussians = center_on_cameras(trained.scene, trained.gaussians)
        self.train_options, self.options = trained.options, options
        self.keep_degrees, self.light = keep_degrees, trained.light
        self.on_view, self.on_step, self.on_try = on_view, on_step, on_try
        self.method, self.because = options.merging, self._explain_from_start()
        self.anew: TrainingLoop | None = None
        self.views: Sequence[SeenView] = ()
        if self.because:
            self.method = FROM_START
        elif needs_views(self.method):
            self.views = list_seen_views(self.scene, trained.scene.train_indices)
        self._scores: np.ndarray | None = None  # the same for all tries
        self.compact_seconds = 0.0
        self.finetune_seconds = 0.0
        self.dropped = 0
        self.degrees: list[int] | None = None  # how many Gaussians have harmonics of degree 0, 1 ..

    def make(self) -> Gaussians:
        """Returns the compacted (and fine-tuned) Gaussians in coordinates of `scene.centred`."""
        small, drop = self._reduce(), self.options.harmonics_drop
        if drop is None:
            return small
        views = self.views or list_seen_views(self.scene, self.scene.train_indices)
        lowered = drop_harmonics(small, views, self._psnr, drop, self.on_view)
        self.degrees = np.bincount(lowered.degrees, minlength=small.sh_degree + 1).tolist()
        return lowered.gaussians

    def _explain_from_start(self) -> str:
        """Returns the reason for training from the start in a sentence; "" if it is not done."""
        o, own, count = self.options, len(self.gaussians), self._count()
        if o.method != AUTO or count is None:
            return ""
        if not self._plan_from_start(count).is_better():
            return ""
        return (
            f"The photographs differ in light and {count / own:.0%} of {own:,} Gaussians are kept, "
            f"where training beats compacting: {count:,} are trained from the start, for the work "
            f"of the run, a compaction and {o.finetune} steps of fine-tuning (--method "
            f"{o.merging} compacts)."
        )

    def _count(self) -> int | None:
        """Returns the number of Gaussians to keep; None if that is searched."""
        o = self.options
        if o.keep is not None:
            return max(1, round(o.keep * len(self.gaussians)))
        return None if o.target_bytes is None else count_for_bytes(self.gaussians, o.target_bytes)

    def _reduce(self) -> Gaussians:
        o = self.options
        if self.method == FROM_START:
            return self._train_from_start()
        if o.keep is not None:
            return self._try(keep=o.keep)
        if o.target_bytes is not None:
            return self._try(count=self._count())
        return self._search()

    def _try(self, keep: float | None = None, count: int | None = None) -> Gaussians:
        o = self.options
        started = time.perf_counter()
        if self._scores is None:
            self._scores = score_gaussians(self.gaussians, self.method, self.views, self.on_view)
        result: Compaction = compact(
            self.gaussians, keep, count=count, method=self.method, views=self.views, seed=o.seed,
            scores=self._scores, on_view=self.on_view,
        )  # fmt: skip
        self.compact_seconds = time.perf_counter() - started
        self.dropped = result.dropped
        if not o.finetune:
            return result.gaussians
        tuned, self.finetune_seconds = finetune(
            self.scene,
            pack_harmonics(result.gaussians) if self.keep_degrees else result.gaussians,
            finetune_options(self.train_options, o.finetune, len(result.gaussians)),
            self.on_step,
            self.light,
        )
        return tuned.to_gaussians() if isinstance(tuned, MixedGaussians) else tuned

    def _plan_from_start(self, count: int) -> FromStart:
        own, tuned = len(self.gaussians), self.options.finetune
        return FromStart(self.train_options, own, count, tuned, self.light)

    def _train_from_start(self) -> Gaussians:
        count = self._count()
        assert count is not None
        self.anew = self._plan_from_start(count).train(self.scene, self.on_step)
        self.light = self.anew.photographs.find_light()
        return self.anew.make_result().copy()

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
    scene, anew, options = compactor.scene, compactor.anew, compactor.train_options
    tuned = compactor.options.finetune if anew is None else 0
    if anew is not None:
        options = anew.options
    elif tuned:
        options = finetune_options(options, tuned, len(gaussians))
    environment = describe_environment(scene.path)
    if read_plan(source) is None:  # the digests of blocks are of the dataset as it is in the files
        environment["digests"] = (source.read_json(RunFile.ENVIRONMENT) or {}).get("digests")
    run = RunFolder.create(out, options.resolve(), environment=environment, command="compact")
    before = source.read_json(RunFile.METRICS) or {}
    indices, light = scene.test_indices or scene.train_indices, compactor.light
    _, metrics = measure(
        TrainedRun(options, scene, gaussians, light), indices, run,
        steps=anew.step if anew else int(before.get("steps") or 0) + tuned,
        train_seconds=anew.seconds if anew else float(before.get("train_seconds") or 0.0)
        + compactor.finetune_seconds,
        find_movers=lambda judged: find_run_movers(source, gaussians, judged, indices, light),
    )  # fmt: skip
    metrics["notes"] += filter(None, [compactor.because])
    metrics["compaction"] = {
        "method": compactor.method,
        "source": str(Path(source.path).resolve()),
        "source_num_gaussians": len(compactor.gaussians),
        "source_psnr": before.get("psnr"),
        "source_render_ms": before.get("render_ms"),
        "dropped": compactor.dropped,
        "harmonics_degrees": compactor.degrees,
        "finetune_steps": tuned,
        "compact_seconds": compactor.compact_seconds,
        "finetune_seconds": compactor.finetune_seconds,
    }
    refined = scene if source.read_json(RunFile.REFINED) is not None else None
    write_results(run, gaussians, metrics, scene.path, refined, compactor.train_options)
    return run
