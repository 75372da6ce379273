"""`lab/run bench channels`: what values beside the colour cost, forward and backward."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

import gsut
from tests.bench.harness import Benchmark, Column, Option, Row, Settings

_FOCAL = 0.4  # of the image's width: a wide fisheye
_SH_COEFFICIENTS = 16  # of degree 3


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the numbers of channels, without any first: the others are compared with it."""
    for count in dict.fromkeys((0, *settings.channels)):
        yield {"channels": str(count), "_count": count}


def make_scene(words: str) -> tuple[gsut.LinearGaussians, gsut.Camera]:
    """Makes random Gaussians before a fisheye; words: "N_WxH"."""
    number, size = words.split("_")
    count, (width, height) = int(number), map(int, size.split("x"))
    rng = np.random.default_rng(0)
    gaussians = gsut.LinearGaussians(
        (rng.uniform(-3, 3, (count, 3)) + np.array([0, 0, 4])).astype(np.float32),
        rng.normal(size=(count, 4)).astype(np.float32),
        rng.uniform(0.01, 0.06, (count, 3)).astype(np.float32),
        rng.uniform(0.1, 0.9, count).astype(np.float32),
        (rng.normal(size=(count, _SH_COEFFICIENTS, 3)) * 0.2).astype(np.float32),
    )
    focal = _FOCAL * width
    params = [focal, focal, width / 2, height / 2, 0, 0, 0, 0]
    return gaussians, gsut.Camera("kannala_brandt", params, width, height)


def _take_least(call: Callable[[], object], times: int) -> float:
    """Returns the least milliseconds of processor time of several calls."""
    found = []
    for _ in range(times):
        begin = time.process_time()
        call()
        found.append(1e3 * (time.process_time() - begin))
    return min(found)


class _Passes:
    """Forward and backward pass of one number of channels, in buffers that are kept."""

    def __init__(self, words: str, count: int) -> None:
        self.gaussians, self.camera = make_scene(words)
        rng = np.random.default_rng(1)
        size = (self.camera.height, self.camera.width)
        self.features: np.ndarray | None = None
        self.options: Row = {}
        if count:
            self.features = rng.normal(size=(len(self.gaussians), count)).astype(np.float32)
            self.options["dfeatures"] = rng.normal(size=(*size, count)).astype(np.float32)
        self.slopes = rng.normal(size=(*size, 3)).astype(np.float32)

    def draw(self) -> gsut.Render:
        """Renders the view."""
        return gsut.render(self.gaussians, self.camera, np.eye(4), features=self.features)

    def differentiate(self, result: gsut.Render) -> gsut.Gradients:
        """Runs the backward pass of a render."""
        return gsut.render_backward(result, self.slopes, **self.options)


_alone: dict[tuple[str, int], tuple[float, float]] = {}  # the times without channels, by size


def measure(case: Row, settings: Settings) -> Row:
    """Measures one number of channels."""
    gsut.set_num_threads(settings.threads)
    passes = _Passes(settings.size, case["_count"])
    result = passes.draw()
    forward = _take_least(passes.draw, settings.calls)
    backward = _take_least(lambda: passes.differentiate(result), settings.calls)
    key = (settings.size, settings.threads)
    if case["_count"] == 0:
        _alone[key] = (forward, backward)
    alone = _alone[key]
    return {
        "forward": forward, "backward": backward, "forward_ratio": forward / alone[0],
        "ratio": (forward + backward) / sum(alone),
    }  # fmt: skip


BENCHMARK = Benchmark(
    help="channels beside the colour: the price of a render and of its gradients",
    columns=(
        Column("channels"),
        Column("forward", unit="CPU-ms", form=".1f"),
        Column("backward", unit="CPU-ms", form=".1f"),
        Column("forward_ratio", "forward, colour alone = 1", form=".2f"),
        Column("ratio", "together, colour alone = 1", form=".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("channels", (1, 3, 8, 32, 256), "numbers of channels"),
        Option("size", "60000_640x480", "Gaussians_WIDTHxHEIGHT"),
        Option("calls", 7, "calls, of which the fastest counts"),
    ),
)
