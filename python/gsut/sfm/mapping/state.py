"""The state of one run that turns photographs into poses, and what its stages find."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import Shutter
from gsut.data.rigs import Rig
from gsut.sfm.mapping.log import PosesLog
from gsut.sfm.matches import PairMatches, RawMatches, keep_most_distinct
from gsut.sfm.photographs import (
    Features,
    ImageLines,
    Images,
    LensGroup,
    Photographs,
    PosesOptions,
)
from gsut.sfm.solution import (
    Adjustment,
    LensFlags,
    LookAlikes,
    Solution,
    StatedTurns,
    adjust_registered,
    solve_poses,
)


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
        cameras = [
            {**row, "camera_from_reference": pose.tolist()}
            for row, pose in zip(self.figures["cameras"], poses, strict=True)
        ]
        baseline = scale * self.figures["baseline"]
        return RigFit(
            dataclasses.replace(self.rig, camera_from_reference=poses),
            {**self.figures, "baseline": baseline, "cameras": cameras},
            self.notes,
        )


@dataclasses.dataclass(frozen=True)
class Findings:
    """What a run has found so far, for its notes, verdict and poses.json.

    Args:
        rig: of a rig's images, else None.
        models: of images that do not connect with the others.
        look_alikes: what still speaks for places taken for one, or None.
        agreement: share of the verified matches that observe one point, or None.
        contradicted, contradicted_images: see `measure_contradiction`; those of images by name,
            the largest first.
        focal_sigma: standard deviation of an estimated focal length over it; infinite: not
            determined; None: the lens was known.
        pose_errors_px: probable errors of relative poses, by leaving out images or points: pixels
            that nine and six in ten pairs of images stay below; None: not measured.
        lens_sigma_px: standard deviation of an estimated lens over a picture, by leaving out
            images; None: not measured.
        lens_gap_px, focal_gap: difference of the lens that the photographs determine from a given
            one, over a picture and relative of the focal length, where it contradicts the given
            lens beyond doubt; 0: none.
        figures: of poses.json.
    """

    rig: RigFit | None = None
    models: list[Any] = dataclasses.field(default_factory=list)
    agreement: float | None = None
    contradicted: float = 0.0
    contradicted_images: dict[str, float] = dataclasses.field(default_factory=dict)
    look_alikes: LookAlikes | None = None
    focal_sigma: float | None = None
    pose_errors_px: tuple[float, float] | None = None
    lens_sigma_px: float | None = None
    lens_gap_px: float = 0.0
    focal_gap: float = 0.0
    figures: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Mapping:
    """What a run knows so far; each stage returns what it knows then.

    Args:
        photographs: with their lenses; a first guess where the lens is unknown.
        options: of the run.
        log: receives progress and notes.
        rig: that the photographs were taken with, or None.
        shutter: rolling, or None.
        lines: how each image is read, where they differ.
        features: of each photograph.
        raw: matches of pairs of photographs.
        pairs: verified matches.
        solution: poses and points.
        lens_free: flags of estimated lenses' parameters, see `Adjustment`; None: known.
        turns: what a gyroscope states, or None.
        found: beside poses and points.
    """

    photographs: Photographs
    options: PosesOptions
    log: PosesLog
    rig: Rig | None = None
    shutter: Shutter | None = None
    lines: ImageLines | None = None
    features: list[Features] = dataclasses.field(default_factory=list)
    raw: RawMatches = dataclasses.field(
        default_factory=lambda: RawMatches(np.zeros((0, 2), np.int64), [])
    )
    pairs: list[PairMatches] = dataclasses.field(default_factory=list)
    solution: Solution | None = None
    lens_free: LensFlags = None
    turns: StatedTurns | None = None
    found: Findings = dataclasses.field(default_factory=Findings)

    def replace(self, **changes: Any) -> Mapping:
        """Returns the run with other fields."""
        return dataclasses.replace(self, **changes)

    def add_findings(self, figures: dict[str, Any] | None = None, **findings: Any) -> Mapping:
        """Returns the run with further findings.

        Args:
            figures: of poses.json, beside those known.
            findings: fields of `Findings`.
        """
        figures = {**self.found.figures, **(figures or {})}
        return self.replace(found=dataclasses.replace(self.found, figures=figures, **findings))

    def solve(
        self,
        images: Images,
        pairs: Sequence[PairMatches],
        lens_free: LensFlags = None,
        lens_settled: bool = False,
    ) -> Solution:
        """Estimates poses and points from nothing but matches, which are to be adjusted then.

        By the most distinct matches of each pair, of which fewer are wrong. A rolling shutter takes
        all, which its velocities need.

        Args:
            images, pairs: see `solve_poses`.
            lens_free, lens_settled: see `Adjustment`.

        Raises:
            SolveError: nothing could be reconstructed.
        """
        is_rolling = images.shutter is not None
        return solve_poses(
            images, pairs if is_rolling else keep_most_distinct(pairs), self.options,
            self.log.follow_steps("mapping"),
            Adjustment(lens_free, lens_settled=lens_settled, covariances=is_rolling),
        )  # fmt: skip

    def adjust(
        self,
        adjustment: Adjustment,
        start: Solution | None = None,
        pairs: Sequence[PairMatches] | None = None,
        stage: str | None = None,
    ) -> Solution:
        """Adjusts the images that have a pose; see `adjust_registered`.

        Args:
            adjustment: what is adjusted.
            start: None: the run's solution.
            pairs: None: all of the run's.
            stage: whose progress the steps are; None: that of a trial is not shown.

        Raises:
            SolveError: too few points agree with the poses.
        """
        shown = {"on_step": self.log.follow_steps(stage)} if stage else {}
        return adjust_registered(
            start or self.solved, self.features, self.pairs if pairs is None else pairs,
            self.options, adjustment=adjustment, **shown,
        )  # fmt: skip

    def select(self, group: LensGroup) -> Mapping:
        """Returns a run of the photographs of one lens, with the matches among them."""
        place = np.full(len(self.photographs), -1)
        place[group.images] = np.arange(len(group.images))
        inside = np.flatnonzero((place[self.raw.pairs] >= 0).all(axis=1))
        return dataclasses.replace(
            self,
            photographs=self.photographs.select(group),
            features=[self.features[i] for i in group.images],
            lines=None if self.lines is None else self.lines.select(group.images),
            raw=RawMatches(place[self.raw.pairs[inside]], [self.raw.matches[i] for i in inside]),
            pairs=[],
            solution=None,
            found=Findings(),
        )

    @property
    def one_lens_free(self) -> np.ndarray | None:
        """Flags of the one lens of all photographs; None if it is known or there are several."""
        return self.lens_free if isinstance(self.lens_free, np.ndarray) else None

    @property
    def images(self) -> Images:
        """The photographs as the solver takes them; all lenses must be known or guessed."""
        photographs = self.photographs
        return Images(
            photographs.names, photographs.lenses, self.features, self.shutter, self.lines
        )

    @property
    def solved(self) -> Solution:
        """Poses and points, after they were found."""
        assert self.solution is not None
        return self.solution
