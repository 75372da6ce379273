"""Gathers what the photographs show: matches of neighbours, beside the given poses and lenses."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut.check.epipolar import (
    TOLERANCE,
    Matches,
    PoseTable,
    find_rays,
    gather_matches,
    make_pose_table,
    rate_pairs,
)
from gsut.check.findings import Finding
from gsut.check.matches import ImagePair, match_neighbours
from gsut.data import Scene
from gsut.lens import Camera
from gsut.sfm.points import measure_angular_errors, measure_pixels_per_radian

_FEWEST_PAIRS = 2  # pairs of photographs: one alone may be an exception
_FEWEST_MATCHES = 60  # of all pairs: fewer say nothing about poses and lens
_SEED = 0  # of the shuffles
_SAMPLE = 800  # matches by which readings and lenses are first tried: enough to see gross errors


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Matches of neighbouring photographs, and the given poses and lenses.

    Args:
        scene: in the dataset's coordinates.
        pairs: the photographs that were matched.
        matches: of all pairs.
        table: the given poses.
        rays: (2, M, 3) of the matches through the given lenses.
    """

    scene: Scene
    pairs: list[ImagePair]
    matches: Matches
    table: PoseTable
    rays: np.ndarray

    @functools.cached_property
    def focal(self) -> float:
        """Pixels a radian of the first lens."""
        return measure_pixels_per_radian(self.scene.cameras[0])

    @functools.cached_property
    def sample(self) -> Evidence:
        """A sample of each pair's matches, by which gross errors are found faster."""
        step = -(-len(self.matches) // _SAMPLE)
        return self if step < 2 else self.select(slice(None, None, step))

    def select(self, rows: np.ndarray | slice) -> Evidence:
        """Returns the evidence of some of the matches, of the same pairs."""
        table = dataclasses.replace(self.table, rows=self.table.rows[:, rows])
        return dataclasses.replace(
            self, matches=self.matches.select(rows), table=table, rays=self.rays[:, rows]
        )

    def replace_poses(self, poses: np.ndarray) -> Evidence:
        """Returns the evidence beside other poses (V, B, 4, 4)."""
        return dataclasses.replace(self, table=dataclasses.replace(self.table, poses=poses))

    @functools.cached_property
    def shuffled(self) -> Evidence:
        """The second image's pixels permuted within each pair: what fits of these, fits by chance.

        As evidence for poses or a lens that squeeze all rays together, or move them all along one
        line: these fit anything.
        """
        m, t = self.matches, self.table
        order = np.arange(len(m))
        for number in range(len(self.pairs)):
            rows = np.flatnonzero(m.pair == number)
            order[rows] = np.random.default_rng([_SEED, number]).permutation(rows)

        def shuffle(values: np.ndarray) -> np.ndarray:
            return np.stack([values[0], values[1, order]])

        return dataclasses.replace(
            self,
            matches=dataclasses.replace(m, pixels=shuffle(m.pixels)),
            table=dataclasses.replace(t, rows=shuffle(t.rows)),
            rays=shuffle(self.rays),
        )

    @functools.cached_property
    def free_turns(self) -> list[tuple[int, np.ndarray, float]]:
        """The relative poses of the pairs through the given lenses, without the given poses.

        Of each pair that has one: its number, the rotation second_from_first, and the share of its
        matches that the relative pose explains.
        """
        fits = [(number, fit_relative_poses(self, number)) for number in range(len(self.pairs))]
        return [
            (number, fit[0][0], fit[0][1] / self.pairs[number].pixels.shape[1])
            for number, fit in fits
            if fit
        ]

    def rate_pairs(
        self, poses: np.ndarray | None = None, cameras: list[Camera] | None = None
    ) -> np.ndarray:
        """Returns the cost of each pair (P,), from 0 to 1, with other poses or lenses.

        Args:
            poses: (V, B, 4, 4); None: the given ones.
            cameras: None: the given ones.
        """
        rays = self.rays if cameras is None else find_rays(cameras, self.matches)
        focal = self.focal if cameras is None else measure_pixels_per_radian(cameras[0])
        errors = measure_angular_errors(rays, self.table.select_poses(poses))
        return rate_pairs(errors, self.matches, focal)

    def rate_poses(self, poses: np.ndarray) -> float:
        """Returns the cost of the matches with these poses (V, B, 4, 4), from 0 to 1."""
        return float(np.mean(self.rate_pairs(poses)))

    def rate_lenses(self, cameras: list[Camera]) -> float:
        """Returns the cost of the matches through these lenses, from 0 to 1."""
        return float(np.mean(self.rate_pairs(cameras=cameras)))

    def make_finding(self, severity: str, what: str, advice: str = "") -> Finding:
        """Makes a finding about the dataset whose photographs these are."""
        return Finding(severity, str(self.scene.path), what, advice)

    def describe(self) -> str:
        """Counts matches and pairs, in words."""
        return f"{len(self.matches):,} matches in {len(self.pairs)} pairs of neighbouring images"


def gather_evidence(scene: Scene, pairs: list[ImagePair] | None = None) -> Evidence | None:
    """Matches some neighbouring photographs; returns None if they share too few features.

    Args:
        scene: in the dataset's coordinates; some of its images are decoded.
        pairs: from `match_neighbours`, if already computed.
    """
    pairs = match_neighbours(scene) if pairs is None else pairs
    if len(pairs) < _FEWEST_PAIRS or sum(p.pixels.shape[1] for p in pairs) < _FEWEST_MATCHES:
        return None
    matches = gather_matches(scene, pairs)
    rays = find_rays(scene.cameras, matches)
    return Evidence(scene, pairs, matches, make_pose_table(scene, matches), rays)


def fit_relative_poses(
    evidence: Evidence, number: int, orders: Sequence[np.ndarray] = ()
) -> list[tuple[np.ndarray, int]]:
    """Fits relative poses to the matches of a pair and to shuffles of them, without given poses.

    Args:
        evidence: of the photographs.
        number: of the pair.
        orders: permutations (n,) of the second image's pixels.

    Returns:
        The rotation (3, 3) second_from_first and the number of matches that the pose explains: as
        matched, and for each permutation. Empty for lenses without one centre.
    """
    scene, pair = evidence.scene, evidence.pairs[number]
    cameras = [scene.cameras[scene.views[i].camera_index] for i in (pair.first, pair.second)]
    if not all(camera.is_central for camera in cameras):
        return []
    images = [
        _core.ImageBearings(camera, np.ascontiguousarray(pixels))
        for camera, pixels in zip(cameras, pair.pixels, strict=True)
    ]
    first = np.arange(pair.pixels.shape[1], dtype=np.int32)
    seen = [np.array(image.valid, bool) for image in images]
    rows = [
        np.stack([first, second], axis=1)[seen[0] & seen[1][second]]
        for second in (first, *(order.astype(np.int32) for order in orders))
    ]
    max_error = TOLERANCE * evidence.matches.diagonal / 1000
    found = _core.verify_pairs(images, np.tile([[0, 1]], (len(rows), 1)), rows, max_error, 0)
    return [(pose[:3, :3], int(np.count_nonzero(kept))) for kept, pose, *_ in found]
