"""`./run bench refine`: poses and lens disturbed, and how far training brings them back."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data import Scene, load_dataset
from gsut.gaussians import Gaussians
from gsut.refine import evaluate_aligned, measure_lens_distance
from gsut.run import (
    TrainOptions,
    add_option_flags,
    check_options,
    describe_options,
    given_options,
    option,
)
from gsut.sfm import PoseErrors, compare_poses
from gsut.train import train
from tests.bench.plots import plot_basin
from tests.bench.refine_basin import BASIN_COLUMNS, BASIN_DEGREES, colors_row, tracks_row
from tests.bench.refine_disturb import (
    DISTURBANCES,
    Disturbance,
    disturbed,
    jittered_points,
    lens_errors,
)
from tests.bench.report_rows import (
    MEASURED,
    add_files,
    bar,
    check_files,
    row_writer,
    rows_to_keep,
    table_text,
    write_csv,
)

# (heading, key of the row, format)
REFINE_COLUMNS = (
    ("disturbed", "disturbed", ""),
    ("training", "training", ""),
    ("rotation start [deg]", "rotation_start_degrees", ".4f"),
    ("end", "rotation_degrees", ".4f"),
    ("position start [mm]", "position_start_mm", ".2f"),
    ("end [mm]", "position_mm", ".2f"),
    ("focal [%]", "focal_percent", ".4f"),
    ("k1 [%]", "k1_percent", ".2f"),
    ("lens [px]", "lens_px", ".3f"),
    ("PSNR as given", "psnr_before", ".2f"),
    ("re-aligned [dB]", "psnr", ".2f"),
    ("of truth [dB]", "psnr_to_truth", "+.2f"),
    ("training [s]", "train_seconds", ".1f"),
    ("all [s]", "seconds", ".1f"),
    ("CPU [s]", "cpu_seconds", ".1f"),
)
_MILLIMETRES = 1000.0  # in a world unit, which is taken for a metre


@describe_options
@dataclasses.dataclass(frozen=True)
class RefineBenchOptions:
    """What is measured, on a dataset `data` whose poses, and lens, are the truth.

    Raises:
        InputError: a value of the wrong kind or out of range.
    """

    data: str
    cases: tuple[str, ...] = option(
        tuple(each.name for each in DISTURBANCES), MEASURED, "disturbances to measure"
    )
    steps: int = option(1000, MEASURED, "of the training", low=1)
    gaussians: int = option(50_000, MEASURED, "of the training", low=1)
    scale: float = option(1.0, MEASURED, "of the images", low=0, high=1, low_open=True)
    threads: int = option(0, MEASURED, "0: all", low=0)
    seed: int = option(0, MEASURED, "of the training", low=0)
    jitter: float = option(0.02, MEASURED, "of the points, one sigma", unit="world units", low=0)
    tracks: bool = option(True, MEASURED, "begin refinement with tracks of features")
    basin: tuple[float, ...] = option(
        BASIN_DEGREES, MEASURED, "of the basin's disturbances; '': none", unit="degrees", low=0
    )
    basin_seeds: int = option(3, MEASURED, "how often each test view is disturbed", low=1)

    def __post_init__(self) -> None:
        check_options(self)
        known = [each.name for each in DISTURBANCES]
        for name in self.cases:
            if name not in known:
                raise InputError(f"--cases takes {', '.join(known)}; found {name!r}")

    def settings(self) -> dict[str, Any]:
        """What a row depends on besides its disturbance."""
        values = dataclasses.asdict(self)
        for name in ("cases", "threads", "basin"):
            del values[name]
        return {**values, "data": str(Path(self.data).resolve())}


def num_parts(options: RefineBenchOptions) -> int:
    """How often `refine_bench` tells its progress, at most."""
    again = bool(options.basin)  # the truth is trained once more where its row was finished before
    return 1 + 2 * len(options.cases) + (1 + options.tracks) * len(options.basin) + again


def refine_bench(
    options: RefineBenchOptions,
    on_progress: Callable[[str], None],
    on_row: Callable[[list[dict[str, Any]]], None] = lambda rows: None,
    finished: Sequence[dict[str, Any]] = (),
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows of training with the truth, and with each disturbance without and with refinement.

    Args:
        options: see RefineBenchOptions.
        on_progress: told what begins.
        on_row: given all rows so far, after each, and those of `finished` that are yet to come.
        finished: rows of a broken run; those made with the same settings are not measured again.

    Returns:
        Rows of REFINE_COLUMNS, and rows of BASIN_COLUMNS (see refine_basin.py).
    """
    bench = _Bench(options, on_progress, on_row, finished)
    rows = bench.training_rows()
    return rows, bench.basin_rows()


class _Bench:
    """A run of the benchmark: its rows so far."""

    def __init__(
        self,
        options: RefineBenchOptions,
        on_progress: Callable[[str], None],
        on_row: Callable[[list[dict[str, Any]]], None],
        finished: Sequence[dict[str, Any]],
    ) -> None:
        self._options, self._on_progress, self._on_row = options, on_progress, on_row
        self._kept = [row for row in finished if row.get("settings") == options.settings()]
        truth = load_dataset(options.data)
        if not truth.test_indices:
            raise InputError(f"{truth.path} has no held-out views to judge by")
        self._truth = jittered_points(truth, options.jitter, options.seed)
        self._trained: tuple[Gaussians, Scene] | None = None  # on the true poses
        self._rows: list[dict[str, Any]] = []

    def training_rows(self) -> list[dict[str, Any]]:
        """The truth, and each disturbance without and with refinement."""
        first = self._row(
            {"disturbed": "nothing", "training": "plain"}, "true poses", self._train_on_truth
        )
        for by in [each for each in DISTURBANCES if each.name in self._options.cases]:
            for refined in (False, True):
                training = "refined" if refined else "plain"
                self._row(
                    {"disturbed": _text(by), "training": training},
                    f"{by.name}, {training}",
                    functools.partial(self._train_disturbed, by, refined, first["psnr"]),
                )
        return list(self._rows)

    def basin_rows(self) -> list[dict[str, Any]]:
        """How far poses may be off: by the tracks of all, and by the colours of one photograph."""
        options, count = self._options, len(self._rows)
        for degrees in options.basin if options.tracks else ():
            self._row(
                {"basin": "tracks", "degrees": degrees},
                f"basin of tracks, {degrees:g} degrees",
                functools.partial(
                    tracks_row, self._truth, degrees, options.seed, options.threads
                ),
            )  # fmt: skip
        for degrees in options.basin:
            self._row(
                {"basin": "colours", "degrees": degrees},
                f"basin of colours, {degrees:g} degrees",
                functools.partial(self._colors_row, degrees),
            )
        return self._rows[count:]

    def _row(
        self, names: dict[str, Any], text: str, measure: Callable[[], dict[str, Any]]
    ) -> dict[str, Any]:
        """The finished row of these names, or a new one."""
        self._on_progress(text)
        kept = [row for row in self._kept if names.items() <= row.items()]
        row = kept[0] if kept else {**names, **measure(), "settings": self._options.settings()}
        self._rows.append(row)
        self._kept = [each for each in self._kept if each is not row]
        self._on_row([*self._rows, *self._kept])
        return row

    def _train_on_truth(self) -> dict[str, Any]:
        row, gaussians, scene = _measure(self._truth, self._truth, _settings(self._options))
        self._trained = gaussians, scene
        return row

    def _train_disturbed(self, by: Disturbance, refined: bool, best: float) -> dict[str, Any]:
        chosen = dataclasses.replace(
            _settings(self._options), refine_poses=refined, refine_lens=refined and by.of_lens,
            refine_tracks=self._options.tracks,
        )  # fmt: skip
        start = disturbed(self._truth, by, self._options.seed)
        row, _, _ = _measure(start, self._truth, chosen)
        return {**row, "psnr_to_truth": row["psnr"] - best}

    def _colors_row(self, degrees: float) -> dict[str, Any]:
        if self._trained is None:
            self._on_progress("true poses once more")
            self._train_on_truth()
        assert self._trained is not None
        options = self._options
        return colors_row(*self._trained, degrees, options.seed, options.basin_seeds)


def _settings(options: RefineBenchOptions) -> TrainOptions:
    return TrainOptions(
        steps=options.steps,
        max_gaussians=options.gaussians,
        sh_degree=1,
        scale=options.scale,
        threads=options.threads,
        seed=options.seed,
        eval_every=0,
        checkpoint_every=0,
    )


def _text(by: Disturbance) -> str:
    if by.of_lens:
        return f"focal {100 * by.focal:g} %, k1 {100 * by.first_coefficient:g} %"
    return f"{by.degrees:g} deg, {100 * by.distance:g} cm"


def _measure(
    start: Scene, truth: Scene, settings: TrainOptions
) -> tuple[dict[str, Any], Gaussians, Scene]:
    """One training; its row, Gaussians and scene with the poses that it ended with."""
    began, cpu = time.perf_counter(), time.process_time()
    result = train(start, settings, progress=False)
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    evaluation = result.metrics
    if "alignment" not in evaluation:
        _, evaluation = evaluate_aligned(result.gaussians, result.scene, truth.test_indices)
    before, after = _errors(start, truth), _errors(result.scene, truth)
    focal, first = lens_errors(result.scene, truth)
    row = {
        "rotation_start_degrees": float(np.median(before.rotation_degrees)),
        "rotation_degrees": float(np.median(after.rotation_degrees)),
        "rotation_max_degrees": float(after.rotation_degrees.max()),
        "position_start_mm": _MILLIMETRES * float(np.median(before.center_distances)),
        "position_mm": _MILLIMETRES * float(np.median(after.center_distances)),
        "focal_percent": 100 * focal,
        "k1_percent": None if np.isnan(first) else 100 * first,
        "lens_px": measure_lens_distance(result.scene.file_cameras[0], truth.file_cameras[0]),
        "psnr_before": evaluation["alignment"]["psnr_before"],
        "psnr": evaluation["alignment"]["psnr_after"],
        "psnr_to_truth": 0.0,
        "train_seconds": result.metrics["train_seconds"],
        "seconds": seconds,
        "cpu_seconds": cpu,
        "refinement": result.metrics.get("refinement"),
    }
    return row, result.gaussians, result.scene


def _errors(scene: Scene, truth: Scene) -> PoseErrors:
    """Of the training views, after the best similarity."""
    poses = [each.poses(truth.train_indices) for each in (scene, truth)]
    return compare_poses(*poses)


# --- the command ----------------------------------------------------------------------------------

HELP = (
    "poses of a dataset perturbed by 0.5 degrees and 2 cm (small) and by 2 degrees and 8 cm "
    "(large), its lens by 2 percent of the focal length and 20 percent of the first coefficient "
    "(lens): what is left against the truth after training, with and without refinement"
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="dataset whose poses and lens are the truth")
    add_option_flags(parser, RefineBenchOptions)
    add_files(parser, "the share of poses that come back against the disturbance", resume=True)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    options = RefineBenchOptions(arguments.data, **given_options(RefineBenchOptions, arguments))
    with bar(num_parts(options)) as advance:
        rows, basin_rows = refine_bench(
            options, advance, row_writer(arguments), rows_to_keep(arguments)
        )
    print(table_text(rows, REFINE_COLUMNS))
    print(f"points moved by {options.jitter:g} (one sigma): a data set's own may be exact")
    if basin_rows:
        print("\nshare of poses that come back to 0.1 degrees and 0.01 units")
        print(table_text(basin_rows, BASIN_COLUMNS))
        if arguments.plot:
            plot_basin(arguments.plot, basin_rows)
    if arguments.csv:
        write_csv(arguments.csv, [*rows, *basin_rows])
    return 0
