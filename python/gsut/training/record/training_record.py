"""Shows and stores a running training: bar, history, checkpoints."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

from gsut._core import num_threads
from gsut.data import Scene
from gsut.data.scene import digest_scene
from gsut.evaluate import mean_psnr
from gsut.files import reading
from gsut.run import Progress, RunFile, RunFolder, TrainOptions, describe_environment
from gsut.training.loop import TrainingLoop
from gsut.training.record.held_interrupts import HeldInterrupts
from gsut.training.record.results import write_unfinished
from gsut.training.time_left import Pace

# Approximate number of rows of the history: the points that a plot can show.
_MOST_ROWS = 200
# Held-out views that are measured during a training: enough to see its course.
_CURVE_VIEWS = 4
# Fewest steps between measurements of the held-out PSNR: four views take as long as ten steps.
_EVAL_EVERY_LEAST = 100
# Seconds after which a checkpoint is due, whatever the step: the most that an interruption costs.
_CHECKPOINT_SECONDS = 60.0

_OTHER_CHECKPOINT = (
    "it is of another training or version: remove it, and --resume begins at the first step"
)


class TrainingRecord:
    """Records one training: on screen, and in a run's folder if there is one.

    Args:
        out: the folder; None: no files.
        options: of the run.
        scene: the dataset.
        resume: continue the run that the folder holds.
        progress: True shows a bar; a function receives each row of the history, with
            "seconds_left".
        watch: receives the loop and the row after each step and returns whether to continue.

    Attributes:
        run: the folder, or None.
        checkpoint: the state that `follow` continues from, or None.
        history: one dict a row: step, seconds, cpu_seconds, loss, num_gaussians, and psnr if
            measured.
        goes_on: False once `watch` has ended the training.

    Raises:
        InputError: the folder holds a run, or with `resume` one of other options.
    """

    def __init__(
        self,
        out: str | os.PathLike[str] | None,
        options: TrainOptions,
        scene: Scene,
        resume: bool,
        progress: bool | Callable[[dict[str, Any]], None],
        watch: Callable[[TrainingLoop, dict[str, Any]], bool] | None = None,
    ) -> None:
        self._options, self._progress, self._watch = options, progress, watch
        self.goes_on = True
        self._bar = Progress(progress is True)
        self._interrupts = HeldInterrupts()
        self._saved = time.monotonic()
        self._time: Pace | None = None
        self.run: RunFolder | None = None
        self.checkpoint: dict[str, Any] | None = None
        self.history: list[dict[str, Any]] = []
        if out is not None:
            environment = describe_environment(scene.path) | {"digests": digest_scene(scene)}
            self.run = RunFolder.create(out, options, resume=resume, environment=environment)
            found = self.run.load_checkpoint() if resume else None
            self.checkpoint = None if found is None else found[1]
            self.history = self.run.history.read()

    def note(self, text: str) -> None:
        """Prints a line above the bar."""
        self._bar.note(text)

    @contextlib.contextmanager
    def follow(self, loop: TrainingLoop) -> Iterator[None]:
        """Restores the loop from the checkpoint, shows a bar during the block, and saves at its
        end, the scene too."""
        if self.checkpoint is not None:
            path = self.run and self.run.path / RunFile.CHECKPOINT
            with reading(path, _OTHER_CHECKPOINT):
                loop.load_state_dict(self.checkpoint)
        o = loop.options
        self._time = Pace(loop.recipe, o.steps, len(loop.gaussians), o.max_gaussians, loop.step)
        self._announce(loop)
        with self._bar, self._interrupts.hold():
            yield
        self._save(loop)
        if self.run is not None:  # evaluation may be interrupted
            write_unfinished(self.run, loop)

    def _announce(self, loop: TrainingLoop) -> None:
        """Says how much a training has to do."""
        o, threads = self._options, num_threads()
        most = loop.options.max_gaussians
        peak = round(loop.recipe.overgrowth * most)
        before = f" ({peak:,} before they are merged)" if peak > most else ""
        sizes = {(camera.width, camera.height) for camera in loop.scene.cameras}
        size = " x ".join(map(str, max(sizes))) if sizes else "no size"
        self.note(
            f"{o.steps - loop.step:,} steps of {size} pixels with up to "
            f"{most:,} Gaussians{before} on {threads} "
            f"processor{'s' if threads > 1 else ''}"
        )

    def add(self, loop: TrainingLoop, loss: float) -> None:
        """Records a step: bar, history, checkpoint, `watch`.

        Raises:
            KeyboardInterrupt: after Ctrl-C; names the scene.ply and its steps, which are written.
        """
        try:
            row = self._record(loop, loss)
            with self._interrupts.release():
                if self._watch is not None:
                    self.goes_on = self._watch(loop, row)
        except KeyboardInterrupt:
            if self.run is None:
                raise
            self.note(f"interrupted: writing {RunFile.SCENE} and a checkpoint")
            self._save(loop)
            write_unfinished(self.run, loop)
            raise KeyboardInterrupt(
                f"{self.run.path / RunFile.SCENE} holds the scene after {loop.step} of "
                f"{loop.options.steps} steps"
            ) from None

    def _record(self, loop: TrainingLoop, loss: float) -> dict[str, Any]:
        """Does what `add` does but for `watch`; returns the row, {} between rows."""
        row = self._make_row(loop, loss)
        steps, count = self._options.steps, len(loop.gaussians)
        left = None if self._time is None else self._time.estimate_left(loop.step)
        self._bar.show_step(loop.step, steps, loss, count, row.get("psnr"), left)
        if row:
            self.history.append(row)
            if self.run is not None:
                self.run.history.append(row)
            if callable(self._progress):
                self._progress({**row, "seconds_left": left})
        every = self._options.checkpoint_every
        late = time.monotonic() - self._saved > _CHECKPOINT_SECONDS
        last = loop.step == self._options.steps  # which `follow` saves
        if every and not last and (loop.step % every == 0 or late):
            self._save(loop)
        return row

    def _make_row(self, loop: TrainingLoop, loss: float) -> dict[str, Any]:
        """Returns the row of this step, with the held-out PSNR if it is due; empty between rows."""
        o, step = self._options, loop.step
        measure = step == o.steps or step % max(_EVAL_EVERY_LEAST, o.steps // 10) == 0
        if not (measure or step % max(1, o.steps // _MOST_ROWS) == 0):
            return {}
        row = {
            "step": step,
            "seconds": loop.seconds,
            "cpu_seconds": loop.cpu_seconds,
            "loss": loss,
            "num_gaussians": len(loop.gaussians),
        }
        test = loop.scene.test_indices
        if measure and test:
            chosen = test[:: math.ceil(len(test) / _CURVE_VIEWS)]
            light = loop.photographs.find_light()
            row["psnr"] = mean_psnr(
                loop.scene, loop.make_result(), chosen, o.background, loop.drawing.renderer, light
            )
        return row

    def _save(self, loop: TrainingLoop) -> None:
        self._saved = time.monotonic()
        if self.run is not None:
            self.run.save_checkpoint(loop.step, loop.state_dict())
