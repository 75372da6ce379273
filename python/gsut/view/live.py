"""Shows a training while it runs: draws between its steps, pauses and stops it from the page."""

from __future__ import annotations

import concurrent.futures
import queue
import threading
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from gsut._core import InputError
from gsut.data import Scene
from gsut.run import TrainOptions
from gsut.training.first import prepare_scene
from gsut.view.server import Reply, declare_values
from gsut.view.session import AtOnce, Session
from gsut.view.stage import Stage

# Seconds of a paused training between looks at what the page requests.
_WAIT_SECONDS = 0.2
_Result = TypeVar("_Result")


class _Job(NamedTuple):
    """Work to do between two steps, and where its answer is waited for."""

    work: Callable[[], Any]
    answer: concurrent.futures.Future[Any]

    def do(self, at_once: AtOnce) -> None:
        """Does the work, and passes on its result or what it raises."""
        try:
            self.answer.set_result(at_once(self.work))
        except Exception as error:  # raised where it was requested
            self.answer.set_exception(error)


class LiveTraining:
    """Connects one training with the page's session.

    The training's own thread draws, between two steps: no copy is made of the Gaussians, they are
    never seen half changed, and nothing is computed but what is drawn. The result's bits are those
    of a training without the page.

    Args:
        scene: to be trained on.
        options: of the training.

    Attributes:
        session: for a `ViewServer`.
    """

    def __init__(self, scene: Scene, options: TrainOptions) -> None:
        scene = prepare_scene(scene, options)
        name = "/".join(scene.path.resolve().parts[-2:])
        self._stage = Stage(name, "training", None, scene, options.background)
        self._steps, self._step, self._refines = options.steps, 0, options.refine_poses
        self._history: list[dict[str, Any]] = []
        self._jobs: queue.Queue[_Job] = queue.Queue()
        self._at_once = AtOnce()
        self._lock = threading.Lock()
        self._state = "preparing"
        self._go_on = threading.Event()
        self._go_on.set()
        self._stopped = False
        self.session = Session(self._stage, self._draw, self._handle_action)

    def watch(self, loop: Any, row: dict[str, Any]) -> bool:
        """Draws what the page requests and waits while paused; for `gsut.train(watch=...)`.

        Returns:
            False once somebody has stopped the training.
        """
        with self._lock:
            self._state = "training"
        self._step = loop.step
        self._stage.background = loop.options.background
        if row:
            self._history.append(row)
        self._serve(loop, None)
        while not self._go_on.is_set():
            with self._lock:
                self._state = "paused"
            self._serve(loop, _WAIT_SECONDS)
        with self._lock:
            self._state = "training"
        return not self._stopped

    def finish(self, gaussians: Any = None) -> None:
        """Marks the training as finished or failed; its Gaussians can still be looked at."""
        with self._lock:
            self._state = "finished"
        self._stage.gaussians = gaussians
        self._finish_jobs(0.0)

    def _serve(self, loop: Any, wait: float | None) -> None:
        if wait is None and self._jobs.empty():
            return
        self._stage.gaussians = loop.get_drawn().translate(loop.scene.world_offset)
        if self._refines:
            self._stage.scene = loop.scene.move_origin((0.0, 0.0, 0.0))
            self.session.lenses.replace(loop.scene.cameras)
        try:
            self._finish_jobs(wait or 0.0)
        finally:
            self._stage.gaussians = None  # the next step changes them

    def _finish_jobs(self, wait: float) -> None:
        """Draws what is requested now, or within `wait` seconds.

        Requests that arrive during this wait for the next step: pages that repeat theirs at once
        would keep the training forever.
        """
        for number in range(max(1, self._jobs.qsize())):
            job = self._take_job(0.0 if number else wait)
            if job is None:
                break
            job.do(self._at_once)  # others draw once it is finished

    def _take_job(self, seconds: float) -> _Job | None:
        try:
            return self._jobs.get(seconds > 0, seconds)
        except queue.Empty:
            return None

    def _draw(self, work: Callable[[], _Result], large: bool = False) -> _Result:
        """Has the work done between two steps, or at once if no step is being made."""
        answer: concurrent.futures.Future[_Result] = concurrent.futures.Future()
        with self._lock:
            between = self._state in ("training", "paused")
            if between:
                self._jobs.put(_Job(work, answer))
        return answer.result() if between else self._at_once(work, large)

    @declare_values({"action?": str})
    def _handle_action(self, values: dict[str, Any]) -> Reply:
        """Pauses, resumes or stops the training, and returns its progress."""
        action = values.get("action")
        if action == "pause":
            self._go_on.clear()
        elif action == "resume":
            self._go_on.set()
        elif action == "stop":
            self._stopped = True
            self._go_on.set()
        elif action is not None:
            raise InputError(f"a training can pause, resume and stop, not {action!r}")
        last = self._history[-1] if self._history else {}
        state = "stopping" if self._stopped and self._state != "finished" else self._state
        return Reply({
            "state": state, "step": self._step, "steps": self._steps,
            "history": list(self._history), "num_gaussians": last.get("num_gaussians", 0),
        })  # fmt: skip
