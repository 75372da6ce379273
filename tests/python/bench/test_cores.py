"""`./run bench cores`: loops and pools of a traced command, and the forecast made of them."""

import numpy as np
import pytest

import gsut
from gsut import _core
from tests.bench import cores_bench, trace_command


@pytest.fixture
def traced():
    _core.trace_loops(True)
    _core.take_traced_loops()
    yield
    _core.trace_loops(False)


def test_traced_loop_runs_alone_with_the_same_bits(traced, rng):
    values = rng.uniform(size=(2, 200, 300, 3)).astype(np.float32)
    _core.trace_loops(False)
    plain = gsut.metrics.ssim(*values)
    _core.trace_loops(True)
    assert gsut.metrics.ssim(*values) == plain
    loops = _core.take_traced_loops()
    assert len(loops) >= 1
    begin, end, longest, chunks = loops[:, :4].T
    on = loops[:, 4:]
    assert (chunks >= 2).all() and (end > begin).all()
    assert (np.diff(on, axis=1) <= 0).all()  # more cores are never slower
    assert (on >= longest[:, None]).all() and (on[:, 0] <= end - begin).all()
    assert len(_core.take_traced_loops()) == 0


@pytest.mark.parametrize(
    ("seconds", "cores", "expected"),
    [([1.0] * 8, 4, 2.0), ([3.0, 1.0, 1.0, 1.0], 2, 3.0), ([1.0, 1.0, 4.0], 2, 5.0), ([], 2, 0.0)],
)
def test_tasks_go_to_the_core_that_is_free_first(seconds, cores, expected):
    assert trace_command.schedule(seconds, cores) == expected


def test_forecast_leaves_serial_time_and_no_more_than_an_even_share():
    trace = trace_command.Trace(10.0, 2.0, 1.0, {2: 4.0, 4: 2.0, 8: 1.0, 16: 0.5}, 0, 0, [], [])
    assert [trace.forecast(cores) for cores in (1, 2, 8, 16)] == [10.0, 6.0, 3.0, 2.5]
    even = trace_command.Trace(10.0, 0.0, 5.0, {2: 2.5}, 0, 0, [], [])
    assert even.forecast(2) == 5.0  # what runs beside the main thread needs a core, too


def test_time_outside_loops_is_given_to_its_place():
    looks = [(1.0, "a"), (2.0, "b"), (4.0, "loop"), (6.0, "a")]
    places, find_place = trace_command._place_samples(looks, [(2.5, 5.0)])
    assert places == {"a": 2.0, "b": 1.0, "loop": 0.5}  # up to the loop's beginning
    assert find_place(3.0) == "loop"


def test_command_is_traced_and_described():
    words = ["camera", "find", "GoPro"]
    figures = {"words": words, "runs": [], "trace": cores_bench.read_trace(words)}
    text = "\n".join(cores_bench.describe(figures))
    assert "| imports |" in text and "| 8 | - | - |" in text
