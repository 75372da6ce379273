"""Trials of the solver that run beside each other."""

import threading

import pytest

from gsut import _core
from gsut.sfm.lens.trials import run_trials


@pytest.fixture(params=[1, 2])
def threads(request):
    before = _core.num_threads()
    _core.set_num_threads(request.param)
    yield request.param
    _core.set_num_threads(before)


def test_results_are_in_order_and_steps_those_of_the_first(threads):
    shown = []

    def make(number):
        def run(on_step):
            on_step(number)
            return number

        return run

    assert run_trials([make(n) for n in range(5)], shown.append) == [0, 1, 2, 3, 4]
    assert shown == [0]


def test_trials_beside_one_that_fails_end_at_their_next_step():
    began, ended = threading.Event(), threading.Event()

    def fail(_):
        began.wait(10)
        raise KeyboardInterrupt

    def go_on(on_step):
        began.set()
        try:
            while True:
                on_step()
        finally:
            ended.set()

    _core.set_num_threads(2)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_trials([fail, go_on, pytest.fail])
    finally:
        _core.set_num_threads(0)
    assert ended.is_set()
