"""Trains a draft on the poses found so far: a first look, of which the scene keeps nothing."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from gsut.data import Scene
from gsut.data.scene import View
from gsut.run import TrainOptions
from gsut.sfm.solution import Solution
from gsut.training import TrainingLoop
from gsut.training.first import prepare_scene
from gsut.view.live import LiveTraining

# Fewest images with a pose, and points, that make a draft worth looking at.
_FEWEST_VIEWS = 12
_FEWEST_POINTS = 500
# Most views of a draft, spread over all: they are decoded before the first step.
_MOST_VIEWS = 40
# Steps of a draft, after which its processor time goes to the poses again.
_STEPS = 300
# Longer side of its pictures in pixels, and most Gaussians: a step then takes a few milliseconds.
_MOST_SIDE = 320
_MOST_GAUSSIANS = 15_000
# Steps between rows of its history.
_ROW_EVERY = 20


def can_draft(solution: Solution) -> bool:
    """Returns whether there is enough to see for a draft."""
    return solution.num_registered >= _FEWEST_VIEWS and len(solution.points) >= _FEWEST_POINTS


class Draft:
    """One draft, trained by a thread of its own.

    Args:
        solution: poses and points so far.
        pictures: files by name.
        masks: files of the masks by the picture's name, where there are any.
        on_shown: called with the training that can be looked at, and True, after its first steps.
    """

    def __init__(
        self,
        solution: Solution,
        pictures: Mapping[str, Path],
        masks: Mapping[str, Path],
        on_shown: Callable[[LiveTraining, bool], None],
    ) -> None:
        self._on_shown = on_shown
        self._make_scene = functools.partial(make_scene, solution, pictures, masks)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gsut-draft", daemon=True)
        self._thread.start()

    def is_training(self) -> bool:
        """Returns whether it is not finished."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Ends the training and waits for it; what it has found can still be looked at."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        with contextlib.suppress(ValueError, RuntimeError, OSError):  # the scene itself reports it
            self._train()

    def _train(self) -> None:
        scene = self._make_scene()
        if len(scene) < _FEWEST_VIEWS:
            return
        options = TrainOptions(
            preset="fast", steps=_STEPS, max_side=_MOST_SIDE, max_gaussians=_MOST_GAUSSIANS,
            sh_degree=0, exposure="off", test_every=0,
        )  # fmt: skip
        live = LiveTraining(scene, options)
        loop = TrainingLoop(prepare_scene(scene.centred, options), options)
        while loop.step < _STEPS and not self._stopped.is_set():
            loss = loop.advance()
            is_row = loop.step % _ROW_EVERY == 0
            row = {"step": loop.step, "loss": loss, "num_gaussians": len(loop.gaussians)}
            if not live.watch(loop, row if is_row else {}):
                break
            if loop.step == _ROW_EVERY:
                self._on_shown(live, True)
        live.finish(loop.make_result().copy().translate(loop.scene.world_offset))


def make_scene(
    solution: Solution, pictures: Mapping[str, Path], masks: Mapping[str, Path]
) -> Scene:
    """Makes a dataset of the images that have a pose, with their masks and rolling shutters."""
    chosen = [i for i in np.flatnonzero(solution.registered) if solution.names[i] in pictures]
    chosen = chosen[:: max(1, -(-len(chosen) // _MOST_VIEWS))]
    cameras = list(dict.fromkeys(solution.cameras[i] for i in chosen))
    moves = solution.velocities is not None
    starts, ends = solution.interpolate_poses(0.0), solution.interpolate_poses(1.0)
    views = [
        View(
            name, pictures[name], cameras.index(solution.cameras[i]), solution.camera_from_world[i],
            starts[i] if moves else None, ends[i] if moves else None, masks.get(name),
            shutter=solution.shutters[i] if moves else None,
        )
        for i, name in ((i, solution.names[i]) for i in chosen)
    ]  # fmt: skip
    return Scene(
        Path("draft"), tuple(cameras), tuple(views), solution.points, solution.colors,
        tuple(range(len(views))), (), np.zeros(3),
    )  # fmt: skip
