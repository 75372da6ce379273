"""Refuses to resume a run with other options, data or kernels than it started with."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.run.options import TrainOptions

# Options that a resumed run may have otherwise than the run that it goes on with: they change
# neither the result's bits nor the steps at which history is written.
_FREE_ON_RESUME = ("threads", "checkpoint_every")


def check_same_options(path: Path, saved: TrainOptions, options: TrainOptions) -> None:
    """Raises InputError where an option that changes the result is not as it was saved."""
    before, wanted = dataclasses.asdict(saved), dataclasses.asdict(options)
    for name, value in wanted.items():
        if name not in _FREE_ON_RESUME and before[name] != value:
            raise InputError(
                f"{path} was started with {name} = {before[name]}, not {value}; a resumed "
                "run keeps its options, so leave this one out or start a new run"
            )


def check_same_start(
    path: Path, saved: dict[str, Any], environment: dict[str, Any], is_finished: bool
) -> None:
    """Raises InputError where data or, unless the run is finished, kernels are not the same.

    Args:
        path: of the run.
        saved, environment: see `RunFolder.create`, at its start and now.
        is_finished: nothing is computed again.
    """
    _check_same_data(path, saved, environment)
    if not is_finished:
        _check_same_kernels(path, saved, environment)


def _check_same_kernels(path: Path, saved: dict[str, Any], environment: dict[str, Any]) -> None:
    """Raises InputError where the instruction set is not the one that the run started with.

    Where this machine lacks that one the run goes on, with a warning: its result then has the bits
    of neither.
    """
    before, now = saved.get("isa"), environment.get("isa")
    if not before or not now or before == now:
        return
    what = f"{path} was started with the instruction set {before}, not {now}"
    if before in _core.available_isas():
        raise InputError(
            f"{what}; a resumed run keeps it for the same bits: set GSUT_ISA={before}, or start a "
            "new run"
        )
    warnings.warn(
        f"{what}, and this machine lacks it: the result will have other bits than an "
        "uninterrupted run, within the error of either",
        RuntimeWarning,
        stacklevel=4,
    )


def _check_same_data(path: Path, saved: dict[str, Any], environment: dict[str, Any]) -> None:
    """Raises InputError where the dataset has other digests than at the start of the run."""
    before, now = saved.get("digests"), environment.get("digests")
    if not before or not now:
        return  # killed before they were written: nothing to disagree with
    changed = [name for name, digest in now.items() if before.get(name) != digest]
    if changed:
        raise InputError(
            f"{path} was started with other {' and '.join(changed)} than "
            f"{environment['dataset']} has now; a resumed run needs the same data: give those, "
            "or start a new run"
        )
