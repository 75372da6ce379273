"""`gsut bench poses`: seconds of `gsut poses`, and of pycolmap, beside errors against a dataset."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.bench import pycolmap_poses
from gsut.data.lens_colmap import format_colmap
from gsut.data.load import load_dataset
from gsut.structure.align import PoseErrors, compare_poses
from gsut.structure.estimate import estimate_poses
from gsut.structure.inputs import find_photographs
from gsut.structure.options import PosesOptions

LENSES = ("known", "unknown")
SHUTTERS = ("auto", "global", "rolling")
# (heading, key of the row, format)
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
    ("features [s]", "features_seconds", ".1f"),
    ("matching [s]", "matching_seconds", ".1f"),
    ("mapping [s]", "mapping_seconds", ".1f"),
    ("total [s]", "total_seconds", ".1f"),
)


@dataclasses.dataclass(frozen=True)
class PosesBenchOptions:
    """What is measured.

    Args:
        data: datasets with poses, which are the reference (agreement, where they are COLMAP's).
        lenses: "known": the dataset's own lens; "unknown": estimated.
        threads: 0 for all.
        shutters: "auto": as the dataset says; "global": one pose an image, with errors let through
            that are PosesOptions.rolling_error times as large if the dataset has a rolling shutter;
            "rolling".
        pycolmap: a Python interpreter with pycolmap, whose incremental mapping is measured in the
            same run; None: not measured.
    """

    data: Sequence[str]
    lenses: Sequence[str] = ("known",)
    threads: int = 0
    shutters: Sequence[str] = ("auto",)
    pycolmap: str | None = None

    @property
    def num_rows(self) -> int:
        """Number of measurements."""
        own = len(self.shutters) + (self.pycolmap is not None)
        return len(self.data) * len(self.lenses) * own

    def __post_init__(self) -> None:
        for lens in self.lenses:
            if lens not in LENSES:
                raise InputError(f"--lens takes {' and '.join(LENSES)}, found {lens!r}")
        for shutter in self.shutters:
            if shutter not in SHUTTERS:
                raise InputError(f"--shutter takes {', '.join(SHUTTERS)}, found {shutter!r}")


def poses_bench(
    options: PosesBenchOptions, on_progress: Callable[[str], None]
) -> list[dict[str, Any]]:
    """One row a dataset and lens; None for what could not be measured.

    Args:
        options: see PosesBenchOptions.
        on_progress: told what begins.

    Raises:
        InputError: a dataset cannot be read or has no poses.
    """
    rows = []
    for data in options.data:
        for lens in options.lenses:
            for shutter in options.shutters:
                on_progress(f"{data}, lens {lens}")
                rows.append(_measure(Path(data), lens, shutter, options.threads))
            if options.pycolmap is not None:
                on_progress(f"{data}, lens {lens}, pycolmap")
                rows.append(_measure_pycolmap(Path(data), lens, options.pycolmap, options.threads))
    return rows


def _row(data: Path, lens: str, **values: Any) -> dict[str, Any]:
    return {
        **{key: None for _, key, _ in POSES_COLUMNS},
        "data": data.name, "lens": lens, "registered": 0, **values,
    }  # fmt: skip


def _error_values(errors: PoseErrors) -> dict[str, float]:
    return {
        "ate_percent": errors.ate_percent,
        "rotation_median_degrees": float(np.median(errors.rotation_degrees)),
        "rotation_mean_degrees": float(errors.rotation_degrees.mean()),
        "rotation_max_degrees": float(errors.rotation_degrees.max()),
    }


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


def _measure(data: Path, lens: str, shutter: str, threads: int) -> dict[str, Any]:
    row = _row(data, lens, program="gsut", shutter=shutter)
    options = _settings(data, shutter, threads)
    with tempfile.TemporaryDirectory(prefix="gsut-poses-") as folder:
        try:
            result = estimate_poses(data, folder, unknown_lens=lens == "unknown", options=options)
        except SolveError as error:
            return {**row, "failure": str(error)}
        figures = result.figures
        row.update(
            registered=figures["registered"],
            images=figures["images"],
            error_px=figures["reprojection_error_px"]["median"],
            **{
                f"{stage}_seconds": figures["seconds"][stage]
                for stage in ("features", "matching", "mapping", "total")
            },
        )
        if result.solution.num_registered >= 3:
            row.update(_error_values(errors_against(data, folder)))
            row["shutter"] = figures["shutter"]
    return row


def _measure_pycolmap(data: Path, lens: str, python: str, threads: int) -> dict[str, Any]:
    """pycolmap's incremental mapping of the same images, in a process of its own."""
    photographs = find_photographs(data, None)
    row = _row(data, lens, program="pycolmap", shutter="global", images=len(photographs))
    paths = [path.resolve() for path in photographs.paths]
    root = Path(os.path.commonpath([path.parent for path in paths]))
    names = [path.relative_to(root).as_posix() for path in paths]
    request: dict[str, Any] = {
        "images": str(root), "names": names, "threads": threads or -1, "model": None, "params": None
    }  # fmt: skip
    if lens == "known":
        cameras = {camera for camera in photographs.cameras if camera is not None}
        if len(cameras) != 1:
            return {**row, "failure": f"the images have {len(cameras)} known lenses, not one"}
        _, model, _, _, *params = format_colmap(cameras.pop()).splitlines()[-1].split()
        request.update(model=model, params=[float(value) for value in params])
    with tempfile.TemporaryDirectory(prefix="gsut-pycolmap-") as folder:
        question, answer = Path(folder) / "request.json", Path(folder) / "answer.json"
        request["work"] = str(Path(folder) / "work")
        Path(request["work"]).mkdir()
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
    row.update({f"{stage}_seconds": value for stage, value in found["seconds"].items()})
    row.update(total_seconds=sum(found["seconds"].values()), registered=len(found["poses"]))
    if len(found["poses"]) >= 3:
        reference = {
            view.image_path.resolve(): view.camera_from_world
            for view in load_dataset(data, test_every=0).views
        }
        chosen = [name for name in names if name in found["poses"] and root / name in reference]
        poses = np.array([[*found["poses"][name], [0.0, 0.0, 0.0, 1.0]] for name in chosen])
        row.update(
            _error_values(compare_poses(poses, np.array([reference[root / n] for n in chosen])))
        )
    return row


def errors_against(reference: str | os.PathLike[str], found: str | os.PathLike[str]) -> PoseErrors:
    """Errors of a dataset's poses against another's, over the images that both have.

    Raises:
        InputError: a dataset cannot be read, or they share fewer than three images.
    """
    truth = {
        view.image_path.resolve(): view.camera_from_world
        for view in load_dataset(reference, test_every=0).views
    }
    views = [v for v in load_dataset(found, test_every=0).views if v.image_path.resolve() in truth]
    poses = np.array([v.camera_from_world for v in views]).reshape(-1, 4, 4)
    return compare_poses(
        poses, np.array([truth[v.image_path.resolve()] for v in views]).reshape(-1, 4, 4)
    )
