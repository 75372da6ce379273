"""The state of one run that turns photographs into poses."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut._core import InputError, Shutter
from gsut.data.rigs import Rig
from gsut.sfm.core.features import Features
from gsut.sfm.core.findings import Findings
from gsut.sfm.core.log import PosesLog
from gsut.sfm.core.matching import PairMatches, RawMatches
from gsut.sfm.core.options import PosesOptions
from gsut.sfm.core.photographs import Photographs
from gsut.sfm.core.solution import Images, Solution


@dataclasses.dataclass
class Mapping:
    """What a run knows so far; each stage adds to it.

    Args:
        photographs: with their lenses; a first guess where the lens is unknown.
        options: of the run.
        log: receives progress and notes.
        fov_degrees: rough horizontal field of view of an unknown lens, or None.
        rig: that the photographs were taken with, or None.
        refine_rig: adjust the cameras' poses on the rig.
        shutter: rolling, or None.
        features: of each photograph.
        raw: matches of pairs of photographs.
        pairs: verified matches.
        solution: poses and points.
        lens_free: (K,) flags of an estimated lens' parameters, see `Adjustment`; None: known.
        found: beside poses and points.
    """

    photographs: Photographs
    options: PosesOptions
    log: PosesLog
    fov_degrees: float | None = None
    rig: Rig | None = None
    refine_rig: bool = False
    shutter: Shutter | None = None
    features: list[Features] = dataclasses.field(default_factory=list)
    raw: RawMatches = dataclasses.field(
        default_factory=lambda: RawMatches(np.zeros((0, 2), np.int64), [])
    )
    pairs: list[PairMatches] = dataclasses.field(default_factory=list)
    solution: Solution | None = None
    lens_free: np.ndarray | None = None
    found: Findings = dataclasses.field(default_factory=Findings)

    @property
    def images(self) -> Images:
        """The photographs as the solver takes them; all lenses must be known or guessed."""
        photographs = self.photographs
        return Images(photographs.names, photographs.lenses, self.features, self.shutter)

    @property
    def solved(self) -> Solution:
        """Poses and points, after they were found."""
        assert self.solution is not None
        return self.solution


def choose_shutter(photographs: Photographs, options: PosesOptions) -> Shutter | None:
    """Returns the rolling shutter of the dataset or the options; None: global or not known."""
    if options.shutter == "global":
        return None
    shutter = photographs.shutter
    if shutter is None and (options.shutter == "rolling" or options.readout_time is not None):
        shutter = Shutter(options.readout_direction)
    return shutter


def require_global_shutter(shutter: Shutter | None) -> None:
    """Raises InputError for a rolling shutter, which `--photometric` cannot map."""
    if shutter is not None:
        raise InputError(
            "--photometric takes every image for one pose, and these have a rolling shutter: "
            "leave it out, or give --shutter global"
        )
