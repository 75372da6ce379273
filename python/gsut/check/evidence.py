"""What the photographs have to say: matches of neighbours, beside the given poses and lenses."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from gsut import _core
from gsut.check.epipolar import (
    TOLERANCE,
    Matches,
    PoseTable,
    cost,
    gather,
    pose_table,
    rays_of,
)
from gsut.check.matches import ImagePair, neighbouring_matches
from gsut.data import Scene
from gsut.lens import Camera
from gsut.sfm.core import measure_angular_errors, measure_pixels_per_radian

_FEWEST_PAIRS, _FEWEST_MATCHES = 2, 60
_SAMPLE = 800  # matches by which readings and lenses are tried at first


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What the photographs have to say: matches, and the given poses and lenses."""

    scene: Scene
    pairs: list[ImagePair]
    matches: Matches
    table: PoseTable
    rays: np.ndarray

    @functools.cached_property
    def focal(self) -> float:
        return measure_pixels_per_radian(self.scene.cameras[0])

    @functools.cached_property
    def sample(self) -> Evidence:
        """Some of the matches of each pair: enough to tell what is far off."""
        step = -(-len(self.matches) // _SAMPLE)
        if step < 2:
            return self
        m, t = self.matches, self.table
        rows = slice(None, None, step)
        matches = dataclasses.replace(
            m, pair=m.pair[rows], pixels=m.pixels[:, rows], lens=m.lens[:, rows]
        )
        table = dataclasses.replace(t, rows=t.rows[:, rows])
        return dataclasses.replace(self, matches=matches, table=table, rays=self.rays[:, rows])

    @functools.cached_property
    def free_turns(self) -> list[tuple[int, np.ndarray, float]]:
        """See `free_turns`."""
        return free_turns(self)

    def cost_of_poses(self, poses: np.ndarray) -> float:
        errors = measure_angular_errors(self.rays, self.table.of_matches(poses))
        return cost(errors, self.matches, self.focal)

    def cost_of_lenses(self, cameras: list[Camera]) -> float:
        errors = measure_angular_errors(rays_of(cameras, self.matches), self.table.of_matches())
        return cost(errors, self.matches, measure_pixels_per_radian(cameras[0]))

    def words(self) -> str:
        return f"{len(self.matches):,} matches in {len(self.pairs)} pairs of neighbouring images"


def gather_evidence(scene: Scene, pairs: list[ImagePair] | None = None) -> Evidence | None:
    """Matches of some neighbouring photographs; None where they share too few features.

    Args:
        scene: in the dataset's coordinates; some of its images are decoded.
        pairs: from `neighbouring_matches`, where they are known already.
    """
    pairs = neighbouring_matches(scene) if pairs is None else pairs
    if len(pairs) < _FEWEST_PAIRS or sum(p.pixels.shape[1] for p in pairs) < _FEWEST_MATCHES:
        return None
    matches = gather(scene, pairs)
    rays = rays_of(scene.cameras, matches)
    return Evidence(scene, pairs, matches, pose_table(scene, matches), rays)


def free_turns(evidence: Evidence) -> list[tuple[int, np.ndarray, float]]:
    """Of each pair that one relative pose explains: its number, the rotation second_from_first
    and the share of the matches; through the given lenses, without the given poses."""
    scene, result = evidence.scene, []
    for number, pair in enumerate(evidence.pairs):
        cameras = [
            scene.cameras[scene.views[index].camera_index] for index in (pair.first, pair.second)
        ]
        if not all(camera.is_central for camera in cameras):
            continue
        images = [
            _core.ImageBearings(camera, np.ascontiguousarray(pixels))
            for camera, pixels in zip(cameras, pair.pixels, strict=True)
        ]
        count = pair.pixels.shape[1]
        rows = np.repeat(np.arange(count, dtype=np.int32)[:, None], 2, axis=1)
        rows = rows[images[0].valid & images[1].valid]
        max_error = TOLERANCE * evidence.matches.diagonal / 1000
        ((kept, found, *_),) = _core.verify_pairs(images, np.array([[0, 1]]), [rows], max_error, 0)
        result.append((number, found[:3, :3], np.count_nonzero(kept) / count))
    return result
