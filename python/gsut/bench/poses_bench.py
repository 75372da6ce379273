"""`gsut bench poses`: seconds of `gsut poses` beside its errors against a dataset's own poses."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, SolveError
from gsut.data.load import load_dataset
from gsut.structure.align import PoseErrors, compare_poses
from gsut.structure.estimate import estimate_poses
from gsut.structure.options import PosesOptions

LENSES = ("known", "unknown")
# (heading, key of the row, format)
POSES_COLUMNS = (
    ("data", "data", ""),
    ("lens", "lens", ""),
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
    """

    data: Sequence[str]
    lenses: Sequence[str] = ("known",)
    threads: int = 0

    def __post_init__(self) -> None:
        for lens in self.lenses:
            if lens not in LENSES:
                raise InputError(f"--lens takes {' and '.join(LENSES)}, found {lens!r}")


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
            on_progress(f"{data}, lens {lens}")
            rows.append(_measure(Path(data), lens, options.threads))
    return rows


def _measure(data: Path, lens: str, threads: int) -> dict[str, Any]:
    row: dict[str, Any] = {key: None for _, key, _ in POSES_COLUMNS}
    row.update(data=data.name, lens=lens, registered=0)
    with tempfile.TemporaryDirectory(prefix="gsut-poses-") as folder:
        try:
            result = estimate_poses(
                data, folder, unknown_lens=lens == "unknown", options=PosesOptions(threads=threads)
            )
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
            errors = errors_against(data, folder)
            row.update(
                ate_percent=errors.ate_percent,
                rotation_median_degrees=float(np.median(errors.rotation_degrees)),
                rotation_mean_degrees=float(errors.rotation_degrees.mean()),
                rotation_max_degrees=float(errors.rotation_degrees.max()),
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
