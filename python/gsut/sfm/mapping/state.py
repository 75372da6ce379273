"""The state of one run that turns photographs into poses, and what its stages find."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut._core import Shutter
from gsut.data.rigs import Rig
from gsut.sfm.mapping.log import PosesLog
from gsut.sfm.matches import PairMatches, RawMatches
from gsut.sfm.photographs import Features, Images, Photographs, PosesOptions
from gsut.sfm.solution import LookAlikes, Solution


@dataclasses.dataclass(frozen=True)
class RigFit:
    """A rig after its images were placed on it.

    Args:
        rig: with its final poses.
        figures: of poses.json, under "rig".
        notes: what a user should know, one sentence each.
    """

    rig: Rig
    figures: dict[str, Any]
    notes: list[str]

    def rescale(self, scale: float) -> RigFit:
        """Rescales the rig and its figures to another unit."""
        poses = self.rig.camera_from_reference.copy()
        poses[:, :3, 3] *= scale
        self.figures["baseline"] *= scale
        for row, pose in zip(self.figures["cameras"], poses, strict=True):
            row["camera_from_reference"] = pose.tolist()
        return dataclasses.replace(
            self, rig=dataclasses.replace(self.rig, camera_from_reference=poses)
        )


@dataclasses.dataclass(frozen=True)
class Zoom:
    """Images of one focal length, in pixels."""

    focal: float
    names: list[str]


@dataclasses.dataclass
class Findings:
    """What a run has found so far, for its notes, verdict and poses.json.

    Args:
        rig: of a rig's images, else None.
        zooms: that the images were taken at, where they are several.
        models: of images that do not connect with the others.
        look_alikes: what still speaks for places taken for one, or None.
        agreement: share of the verified matches that observe one point, or None.
        focal_sigma: standard deviation of an estimated focal length over it; infinite: not
            determined; None: the lens was known.
        motion: why the motion or the scene leaves the lens open, as a sentence, or None.
        figures: of poses.json.
    """

    rig: RigFit | None = None
    zooms: list[Zoom] = dataclasses.field(default_factory=list)
    models: list[Any] = dataclasses.field(default_factory=list)
    agreement: float | None = None
    look_alikes: LookAlikes | None = None
    focal_sigma: float | None = None
    motion: str | None = None
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass
class Mapping:
    """What a run knows so far; each stage adds to it.

    Args:
        photographs: with their lenses; a first guess where the lens is unknown.
        options: of the run.
        log: receives progress and notes.
        rig: that the photographs were taken with, or None.
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
    rig: Rig | None = None
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
