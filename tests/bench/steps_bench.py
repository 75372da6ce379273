"""`./run bench steps`: where the time of a training step goes, stage by stage."""

from __future__ import annotations

from collections.abc import Iterator

from gsut import _core
from tests.bench.harness import Benchmark, Column, Option, Row, Settings
from tests.bench.measure import measure_step
from tests.bench.scenes import scene_from_arrays

_STAGES = {
    "loss": "loss", "statistics": "statistics", "adam": "Adam", "project": "projection",
    "records": "records", "bin": "lists", "forward": "blend", "backward": "backward of tiles",
    "gradients": "gradients", "step": "whole step",
}  # fmt: skip


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists scenes and instruction sets."""
    for scene in settings.scenes:
        for isa in settings.isa:
            yield {"scene": scene, "isa": isa or _core.active_isa()}


def measure(case: Row, settings: Settings) -> Row:
    """Measures the stages of a step; `./run bench render` has the errors."""
    _core.set_isa(case["isa"])
    times = measure_step(scene_from_arrays(case["scene"]), settings.steps)
    return {"threads": _core.num_threads()} | {
        stage: times.cpu_ms(stage) for stage in _STAGES if stage in times.stages
    }


BENCHMARK = Benchmark(
    help="processor time of each stage of a training step, over the number of threads",
    columns=(
        Column("scene"),
        Column("isa", "instructions"),
        Column("threads", form="d"),
        *(Column(stage, name, "CPU-ms", ".1f") for stage, name in _STAGES.items()),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("scenes", ("synthetic_100k_640x480",), "as of ./run bench render"),
        Option("isa", ("",), "instruction sets; empty: the best one"),
        Option("steps", 30, "steps, of which the fastest counts"),
    ),
)
