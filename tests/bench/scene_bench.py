"""`./run bench scene`: films and photographs without lens and poses, to a scene."""

from __future__ import annotations

import json
from collections.abc import Iterator

from tests.bench.commands import run_gsut
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

# Dataset -> its photographs or film within it.
_SETS = {HALL: "images", "karma": "karma.mp4", "gopro_max_walk": "", "fox": "images"}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists captures."""
    for name in settings.sets or _SETS:
        yield {"data": name, "_within": _SETS.get(name, "")}


def measure(case: Row, settings: Settings) -> Row:
    """Runs `gsut scene`."""
    pictures = settings.path(case["data"]) / case["_within"]
    count = sum(path.is_dir() for path in settings.folder.glob("scene-*"))
    out = settings.folder / f"scene-{count}"
    took = run_gsut(["scene", str(pictures), "--preset", settings.preset], out)
    state = json.loads((out / "scene.json").read_text())
    poses = json.loads((out / "poses" / "poses.json").read_text())
    return took | {
        "pictures": state["pictures"],
        "registered": state["registered"],
        "residual_px": poses["reprojection_error_px"]["median"],
        "psnr": state["psnr"],
        "verdict": state["verdict"]["level"],
    }


BENCHMARK = Benchmark(
    help="gsut scene of films and photographs without lens and poses: held-out PSNR beside seconds",
    columns=(
        Column("data"),
        Column("registered", form="d"),
        Column("pictures", form="d"),
        Column("residual_px", "residual", "px", ".2f"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("verdict", form="s"),
        Column("seconds", "time", "s", ".0f"),
        Column("cpu_seconds", "time", "CPU-s", ".0f"),
        Column("peak_mb", "peak memory", "MB", ",.0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(Option("preset", "fast", "of gsut scene"),),
)
