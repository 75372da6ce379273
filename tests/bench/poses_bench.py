"""`./run bench poses`: what `gsut poses`, and pycolmap, take and how far off a dataset they end."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.lens import camera_models, colmap_record, convert_camera
from gsut.run import add_option_flags, check_options, describe_options, given_options, option
from gsut.sfm import PoseErrors, PosesOptions, compare_datasets, compare_poses, find_poses
from gsut.sfm.core import find_photographs
from gsut.sfm.world import read_poses_by_path
from tests.bench import pycolmap_poses
from tests.bench.report_rows import (
    MEASURED,
    add_files,
    bar,
    check_files,
    print_and_write,
    row_writer,
    rows_to_keep,
)
from tests.bench.rig_poses import RIG_COLUMNS, WAYS, RigBenchOptions, rig_bench
from tests.bench.train_bench import TrainBenchOptions, train_bench

LENSES = ("known", "unknown")
SHUTTERS = ("auto", "global", "rolling")
PROGRAMS = ("gsut", "pycolmap")
_STAGES = ("features", "matching", "mapping")
_FEWEST = 3  # images with a pose, that errors and a training need
# (heading, key of the row, format); CPU-s: processor seconds of all threads.
POSES_COLUMNS = (
    ("data", "data", ""),
    ("program", "program", ""),
    ("lens", "lens", ""),
    ("shutter", "shutter", ""),
    ("registered", "registered", "d"),
    ("images", "images", "d"),
    ("ATE [% of extent]", "ate_percent", ".4f"),
    ("rotation median [deg]", "rotation_median_degrees", ".4f"),
    ("mean", "rotation_mean_degrees", ".4f"),
    ("max", "rotation_max_degrees", ".4f"),
    ("residual median [px]", "error_px", ".3f"),
    ("held-out PSNR [dB]", "psnr", ".2f"),
    *((f"{stage} [CPU-s]", f"{stage}_cpu_seconds", ".1f") for stage in _STAGES),
    ("total [CPU-s]", "total_cpu_seconds", ".1f"),
    ("total [s]", "total_seconds", ".1f"),
)


@describe_options
@dataclasses.dataclass(frozen=True)
class PosesBenchOptions:
    """What is measured on `data`: datasets with poses, which are the reference (agreement, where
    they are COLMAP's), or folders of images without.

    Raises:
        InputError: an unknown word, a value of the wrong kind or out of range.
    """

    data: Sequence[str]
    lens: tuple[str, ...] = option(
        ("known",), MEASURED, "known: the dataset's own; unknown: estimated; a camera model: its "
        "fit to the dataset's own",
    )  # fmt: skip
    shutter: tuple[str, ...] = option(
        ("auto",), MEASURED, "auto: as the dataset says; global: one pose an image, beside a "
        "rolling data set with errors let through as large as the motion makes them; rolling",
    )  # fmt: skip
    programs: tuple[str, ...] = option(
        PROGRAMS, MEASURED, "gsut; pycolmap, if --pycolmap is given, does incremental mapping"
    )
    pycolmap: str | None = option(None, MEASURED, "a Python that has pycolmap", none="none")
    train: int = option(
        0, MEASURED, "steps of a training on the poses found, whose PSNR on every eighth image "
        "needs no reference; 0: none", low=0,
    )  # fmt: skip
    train_scale: float = option(
        0.5, MEASURED, "of the images trained on", low=0, high=1, low_open=True
    )
    threads: int = option(0, MEASURED, "0 = all", low=0)

    @property
    def num_rows(self) -> int:
        """Number of measurements."""
        return len(list(self.requests()))

    def requests(self) -> Iterator[dict[str, Any]]:
        """What each row measures: dict data (path), program, lens, shutter, train."""
        for data in self.data:
            for lens in self.lens:
                asked: dict[str, Any] = {"data": str(Path(data).resolve()), "lens": lens}
                asked |= {"train": [self.train, self.train_scale]}
                if "gsut" in self.programs:
                    for shutter in self.shutter:
                        yield asked | {"program": "gsut", "shutter": shutter}
                if "pycolmap" in self.programs and self.pycolmap is not None:
                    yield asked | {"program": "pycolmap", "shutter": "global"}

    def __post_init__(self) -> None:
        check_options(self)
        for flag, found, known in (
            ("--lens", self.lens, (*LENSES, *camera_models())),
            ("--shutter", self.shutter, SHUTTERS),
            ("--programs", self.programs, PROGRAMS),
        ):
            for word in found:
                if word not in known:
                    raise InputError(f"{flag} takes {', '.join(known)}, found {word!r}")


def poses_bench(
    options: PosesBenchOptions,
    on_progress: Callable[[str], None] = lambda text: None,
    on_row: Callable[[list[dict[str, Any]]], object] = lambda rows: None,
    done: Sequence[dict[str, Any]] = (),
) -> list[dict[str, Any]]:
    """One row a dataset, lens, shutter and program; None for what could not be measured.

    Args:
        options: see PosesBenchOptions.
        on_progress: told what begins.
        on_row: called with all rows so far after each of them.
        done: rows of an earlier call; those that this one asks for are not measured again, others
            are kept.

    Raises:
        InputError: a dataset cannot be read.
    """
    rows = list(done)
    for asked in options.requests():
        on_progress(f"{Path(asked['data']).name}, lens {asked['lens']}, {asked['program']}")
        if any(row.get("asked") == asked for row in rows):
            continue
        path = Path(asked["data"])
        if asked["program"] == "pycolmap":
            assert options.pycolmap is not None
            row = measure_pycolmap(path, asked["lens"], options.pycolmap, options)
        else:
            row = _measure(path, asked["lens"], asked["shutter"], options)
        rows.append({**row, "asked": asked})
        on_row(rows)
    return rows


def _row(data: Path, lens: str, **values: Any) -> dict[str, Any]:
    return {
        **{key: None for _, key, _ in POSES_COLUMNS},
        "data": data.name, "lens": lens, "registered": 0, **values,
    }  # fmt: skip


def _times(seconds: dict[str, float], cpu_seconds: dict[str, float]) -> dict[str, float]:
    """The columns of both by stage, and in all."""
    found: dict[str, float] = {}
    for ending, times in (("seconds", seconds), ("cpu_seconds", cpu_seconds)):
        found |= {f"{stage}_{ending}": times[stage] for stage in _STAGES}
        found[f"total_{ending}"] = times.get("total", sum(times.values()))
    return found


def _error_values(errors: PoseErrors) -> dict[str, float]:
    return {
        "ate_percent": errors.ate_percent,
        "rotation_median_degrees": float(np.median(errors.rotation_degrees)),
        "rotation_mean_degrees": float(errors.rotation_degrees.mean()),
        "rotation_max_degrees": float(errors.rotation_degrees.max()),
    }


def _has_poses(data: Path) -> bool:
    """Whether there is a reference: a folder of images alone is no dataset."""
    return (data / "transforms.json").is_file() or (data / "sparse").is_dir()


def _psnr(folder: str, options: PosesBenchOptions) -> dict[str, float]:
    """Of every eighth image, after a training on the others with the poses in a folder."""
    if not options.train:
        return {}
    (row,) = train_bench(
        TrainBenchOptions(
            folder, ("fast",), measurements=2, scale=options.train_scale, threads=options.threads,
            steps=options.train,
        )
    )  # fmt: skip
    return {"psnr": row["psnr"]}


def _settings(data: Path, shutter: str, threads: int) -> PosesOptions:
    """Of `gsut poses`; looser for a rolling shutter that is taken for a global one."""
    options = PosesOptions(threads=threads, shutter=shutter)
    if shutter != "global" or find_photographs(data, None).shutter is None:
        return options
    return dataclasses.replace(
        options,
        max_error=options.rolling_error * options.max_error,
        max_two_view_error=options.rolling_error * options.max_two_view_error,
    )


def _measure(data: Path, lens: str, shutter: str, bench: PosesBenchOptions) -> dict[str, Any]:
    row = _row(data, lens, program="gsut", shutter=shutter)
    options = _settings(data, shutter, bench.threads)
    with tempfile.TemporaryDirectory(prefix="gsut-poses-") as folder:
        try:
            result = find_poses(
                data, folder, unknown_lens=lens == "unknown", options=options,
                camera=None if lens in LENSES else _fitted_lens(data, lens, Path(folder)),
            )  # fmt: skip
        except SolveError as error:
            return {**row, "failure": str(error)}
        figures = result.figures
        row.update(
            registered=figures["registered"],
            images=figures["images"],
            error_px=figures["reprojection_error_px"]["median"],
            shutter=figures["shutter"],
            **_times(figures["seconds"], figures["cpu_seconds"]),
        )
        if result.solution.num_registered >= _FEWEST:
            if _has_poses(data):
                row.update(_error_values(compare_datasets(data, folder)))
            row.update(_psnr(folder, bench))
    return row


def _fitted_lens(data: Path, model: str, folder: Path) -> Path:
    """The file of the lens of a model that is nearest to the dataset's."""
    (camera,) = set(find_photographs(data, None).lenses)
    convert_camera(camera, model).camera.save(folder / "fitted.lens.json")
    return folder / "fitted.lens.json"


def measure_pycolmap(
    data: Path, lens: str, python: str, bench: PosesBenchOptions, *, sequential: bool = False
) -> dict[str, Any]:
    """pycolmap's incremental mapping of the same images, in a process of its own.

    Args:
        sequential: each image is matched with those after it only, as those of a video.
    """
    photographs = find_photographs(data, None)
    row = _row(data, lens, program="pycolmap", shutter="global", images=len(photographs))
    paths = [path.resolve() for path in photographs.paths]
    root = Path(os.path.commonpath([path.parent for path in paths]))
    names = [path.relative_to(root).as_posix() for path in paths]
    request: dict[str, Any] = {
        "images": str(root), "names": names, "threads": bench.threads or -1,
        "model": None, "params": None, "sequential": sequential,
    }  # fmt: skip
    if lens == "known":
        cameras = {camera for camera in photographs.cameras if camera is not None}
        if len(cameras) != 1:
            return {**row, "failure": f"the images have {len(cameras)} known lenses, not one"}
        model, _, params = colmap_record(cameras.pop())
        request.update(model=model, params=[float(value) for value in params])
    with tempfile.TemporaryDirectory(prefix="gsut-pycolmap-") as folder:
        question, answer = Path(folder) / "request.json", Path(folder) / "answer.json"
        for name in ("work", "found/sparse/0"):
            (Path(folder) / name).mkdir(parents=True)
        request["work"] = str(Path(folder) / "work")
        request["text"] = str(Path(folder) / "found/sparse/0")
        question.write_text(json.dumps(request))
        try:
            done = subprocess.run(
                [python, str(Path(pycolmap_poses.__file__)), str(question), str(answer)],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"--pycolmap {python} cannot be run: {error.strerror}") from error
        if done.returncode == pycolmap_poses.MISSING:
            return {**row, "failure": f"{python} has no pycolmap: pip install pycolmap there"}
        if done.returncode != 0:
            words = (done.stderr.strip() or f"exit status {done.returncode}").splitlines()[-1]
            return {**row, "failure": f"pycolmap failed: {words}"}
        found = json.loads(answer.read_text())
        row.update(registered=len(found["poses"]))
        row.update(_times(found["seconds"], found["cpu_seconds"]))
        if len(found["poses"]) >= _FEWEST and _has_poses(data):
            row.update(_error_values(_errors_of_names(found["poses"], root, data)))
        if len(found["poses"]) >= _FEWEST and bench.train:
            (Path(folder) / "found/images").symlink_to(root)
            row.update(_psnr(str(Path(folder) / "found"), bench))
    return row


def _errors_of_names(found: dict[str, Any], root: Path, data: Path) -> PoseErrors:
    """Of poses (3, 4) by the images' names below `root` against a dataset's."""
    reference = read_poses_by_path(data)
    chosen = [name for name in found if root / name in reference]
    poses = np.array([[*found[name], [0.0, 0.0, 0.0, 1.0]] for name in chosen])
    return compare_poses(poses, np.array([reference[root / name] for name in chosen]))


# --- the command ----------------------------------------------------------------------------------

HELP = (
    "seconds of gsut poses beside its errors against a dataset's own poses, after the best "
    "similarity (where those are COLMAP's, that is agreement, not truth)"
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("data", metavar="DATA", nargs="+", help="datasets with poses, or folders of images")
    add(
        "--rig", metavar="RIG",
        help="the true rig of DATA, whose poses are in its unit: scale and poses with it, without "
        "it, and with it disturbed by 0.5 degrees and 1 %% of its baseline",
    )  # fmt: skip
    add_option_flags(parser, PosesBenchOptions)
    add_files(parser, resume=True)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    wanted = PosesBenchOptions(arguments.data, **given_options(PosesBenchOptions, arguments))
    if arguments.rig:
        if len(arguments.data) != 1:
            raise InputError(f"--rig goes with one dataset, found {len(arguments.data)}")
        with bar(len(WAYS)) as advance:
            options = RigBenchOptions(arguments.data[0], arguments.rig, wanted.threads)
            rows = rig_bench(options, advance)
        print_and_write(rows, RIG_COLUMNS, arguments)
    else:
        with bar(wanted.num_rows) as advance:
            rows = poses_bench(wanted, advance, row_writer(arguments), rows_to_keep(arguments))
        print_and_write(rows, POSES_COLUMNS, arguments)
    for row in rows:
        if "failure" in row:
            way = row.get("way") or f"{row['program']}, lens {row['lens']}"
            print(f"{row['data']}, {way}: {row['failure']}")
    return 0
