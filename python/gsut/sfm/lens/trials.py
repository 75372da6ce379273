"""Runs trials of the solver beside each other: one that adjusts few images leaves cores idle."""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from gsut import _core
from gsut.sfm.solution import OnStep

_Result = TypeVar("_Result")


def run_trials(
    trials: Sequence[Callable[[OnStep], _Result]], on_step: OnStep | None = None
) -> list[_Result]:
    """Runs trials beside each other and returns their results in order.

    Args:
        trials: each is called with the function that its solver has to call after each step.
        on_step: called with the steps of the first one.

    Raises:
        Exception: of the first trial that raises one, or an interrupt; the others then end at their
            next step.
    """
    is_over = threading.Event()

    def follow(number: int) -> OnStep:
        def show(*state: Any) -> None:
            if is_over.is_set():
                raise concurrent.futures.CancelledError
            if number == 0 and on_step is not None:
                on_step(*state)

        return show

    threads = min(len(trials), _core.num_threads())
    if threads == 1:
        return [trial(follow(number)) for number, trial in enumerate(trials)]
    with concurrent.futures.ThreadPoolExecutor(threads, "gsut-trials") as pool:
        tasks = [pool.submit(trial, follow(number)) for number, trial in enumerate(trials)]
        try:
            return [task.result() for task in tasks]
        except BaseException:
            is_over.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
