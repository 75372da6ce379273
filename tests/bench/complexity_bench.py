"""`./run bench complexity`: held-out PSNR over the number of Gaussians, and what gsut chooses."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut._core import InputError, set_num_threads
from gsut.evaluate import mean_psnr
from gsut.run import TrainOptions
from gsut.training import TrainingLoop, choose_complexity, choose_degree
from tests.bench.plots import plot_complexity
from tests.bench.report_rows import (
    add_files,
    bar,
    check_files,
    numbers,
    print_and_write,
    row_writer,
    rows_to_keep,
)

_STEPS_DOWN = 4  # numbers of a sweep that is not given, each a third of the one before
COLUMNS = (
    ("capture", "capture", ""),
    ("training views", "views", "d"),
    ("most Gaussians", "max_gaussians", ",d"),
    ("sh degree", "sh_degree", "d"),
    ("seed", "seed", "d"),
    ("held-out PSNR [dB]", "psnr", ".2f"),
    ("training views' [dB]", "psnr_train", ".2f"),
    ("CPU-s", "cpu_seconds", ".0f"),
    ("chosen", "chosen", ""),
    ("below the best [dB]", "below", ".2f"),
)


@dataclasses.dataclass(frozen=True)
class ComplexityBenchOptions:
    """What is trained.

    Args:
        data: dataset with held-out views.
        views: training views to keep, spread evenly; 0: all. Each is a capture of its own.
        counts: of the sweep, most Gaussians; empty: the preset's, and thirds of it.
        degrees: of harmonics, beside the one that is chosen.
        seeds: a training each; what counts is their mean.
        steps, scale: of each training.
    """

    data: Path
    views: Sequence[int] = (0,)
    counts: Sequence[int] = ()
    degrees: Sequence[int] = (1,)
    seeds: Sequence[int] = (0,)
    steps: int = 1000
    scale: float = 1.0

    def sweep(self) -> list[int]:
        """The numbers of Gaussians, falling."""
        most = TrainOptions(steps=self.steps).most_gaussians
        return sorted(self.counts or [round(most / 3**k) for k in range(_STEPS_DOWN)], reverse=True)


def complexity_bench(
    options: ComplexityBenchOptions,
    say: Callable[[str], None],
    write: Callable[[list[dict[str, Any]]], None] = lambda rows: None,
    done: Sequence[dict[str, Any]] = (),
) -> list[dict[str, Any]]:
    """One row a training of the sweep; the test views are those of the dataset.

    Args:
        options: what to train.
        say: told what begins.
        write: gets all rows after each.
        done: rows of an earlier call, which are not made again; rows of other captures stay, too.
    """
    rows = list(done)
    for kept in options.views:
        scene = _scene(options, kept)
        name = f"{options.data.resolve().name} x {options.scale:g}, {options.steps} steps"
        capture = {"capture": name, "views": len(scene.train_indices)}
        asked = choose_degree(scene, TrainOptions(steps=options.steps))
        chosen = choose_complexity(scene, asked)
        degrees = sorted({*options.degrees, chosen.sh_degree})
        for count in sorted({*options.sweep(), chosen.max_gaussians}, reverse=True):
            for degree, seed in itertools.product(degrees, options.seeds):
                key = capture | {"max_gaussians": count, "sh_degree": degree, "seed": seed}
                if _found(rows, key) is None:
                    say(f"{name}, {len(scene.train_indices)} views: {count:,} degree {degree}")
                    o = TrainOptions(
                        steps=options.steps, max_gaussians=count, sh_degree=degree, seed=seed
                    )
                    rows.append(key | _train(scene, o.resolved()))
                    write(rows)
        choice = {"max_gaussians": chosen.max_gaussians, "sh_degree": chosen.sh_degree}
        for row in rows:
            if _same(row, capture | choice):
                row |= {"chosen": "*", "choice": dataclasses.asdict(chosen)}
        _tell_below(rows, capture)
        write(rows)
    return rows


def _scene(options: ComplexityBenchOptions, kept: int) -> Any:
    scene = gsut.load_dataset(options.data, scale=options.scale).centred
    train = scene.train_indices
    if not scene.test_indices:
        raise InputError(f"{options.data} has no held-out views to measure PSNR on")
    if kept > len(train):
        raise InputError(f"--views {kept}: {options.data} has {len(train)} training views")
    if kept:
        places = np.unique(np.linspace(0, len(train) - 1, kept).round().astype(int))
        scene = scene.replace(train_indices=[train[place] for place in places])
    return scene


def _train(scene: Any, o: TrainOptions) -> dict[str, float]:
    started = time.process_time()
    loop = TrainingLoop(scene, o)
    while loop.step < o.steps:
        loop.advance()
    seconds = time.process_time() - started
    light = loop.photographs.find_light()
    psnr, psnr_train = (
        mean_psnr(scene, loop.make_result(), views, o.background, loop.renderer, light)
        for views in (scene.test_indices, scene.train_indices[:: max(1, len(scene.views) // 8)])
    )
    return {"psnr": psnr, "psnr_train": psnr_train, "cpu_seconds": seconds}


def _tell_below(rows: Sequence[dict[str, Any]], capture: dict[str, Any]) -> None:
    """How far each row of a capture, the mean of its seeds, lies below the best such mean."""
    own: dict[tuple[int, int], list[dict[str, Any]]] = {}
    for row in rows:
        if _same(row, capture):
            own.setdefault((row["max_gaussians"], row["sh_degree"]), []).append(row)
    means = {key: np.mean([row["psnr"] for row in alike]) for key, alike in own.items()}
    best = max(means.values())
    for key, alike in own.items():
        for row in alike:
            row["below"] = float(best - means[key])


def _same(row: dict[str, Any], key: dict[str, Any]) -> bool:
    return all(row.get(name) == value for name, value in key.items())


def _found(rows: Sequence[dict[str, Any]], key: dict[str, Any]) -> dict[str, Any] | None:
    return next((row for row in rows if _same(row, key)), None)


# --- the command ----------------------------------------------------------------------------------

HELP = "held-out PSNR over the number of Gaussians, and what gsut train chooses"


def add_flags(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="dataset with held-out views")
    add("--views", metavar="N,M", help="training views to keep, spread evenly; 0: all [0]")
    add("--counts", metavar="N,M", help="most Gaussians [200000 and its third, ninth, ...]")
    add("--sh-degrees", metavar="A,B", help="of the harmonics, beside the one that is chosen [1]")
    add("--seeds", metavar="A,B", help="a training each, judged by their mean [0]")
    add("--steps", type=int, default=1000, metavar="N", help="of each training [1000]")
    add("--scale", type=float, default=1.0, metavar="X", help="of the images [1]")
    add("--threads", type=int, default=0, metavar="N", help="0 = all [0]")
    add_files(parser, "PSNR against the number of Gaussians, a line a capture", resume=True)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    set_num_threads(arguments.threads)
    options = ComplexityBenchOptions(
        data=arguments.data,
        views=numbers(arguments.views, int, "--views") or (0,),
        counts=numbers(arguments.counts, int, "--counts"),
        degrees=numbers(arguments.sh_degrees, int, "--sh-degrees") or (1,),
        seeds=numbers(arguments.seeds, int, "--seeds") or (0,),
        steps=arguments.steps,
        scale=arguments.scale,
    )
    done = rows_to_keep(arguments)
    each = len(options.degrees) * len(options.seeds)
    total = len(options.views) * (1 + len(options.sweep())) * each
    with bar(total) as advance:
        rows = complexity_bench(options, advance, row_writer(arguments), done)
    print_and_write(rows, COLUMNS, arguments)
    if arguments.plot:
        plot_complexity(arguments.plot, rows)
    return 0
