"""Triangulates points of a dataset whose poses and lenses are known and stay unchanged.

Features of neighbouring photographs are matched; matches that lie on each other's epipolar lines
through the given poses are joined into tracks, and these are triangulated. For a dense cloud every
few pixels are followed into the neighbours by optical flow and triangulated in the same way.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene, View
from gsut.lens import Camera
from gsut.sfm.matches import match_images
from gsut.sfm.photographs import (
    OnProgress,
    Photographs,
    PosesOptions,
    collect_features,
    require_central,
)
from gsut.sfm.points.epipolar import (
    compute_readout_poses,
    find_readout_moments,
    measure_angular_errors,
    measure_pixels_per_radian,
)
from gsut.sfm.points.flow import follow_pixels
from gsut.sfm.solution import average_colors, list_extension_settings, measure_diagonal

_FEWEST_POINTS = 30  # fewer mean that poses and photographs do not belong together
_FEWEST_MATCHES = 8  # of a pair that is used
_LEAST_PARALLAX = 4.0  # pixels on the axis that a point's rays must differ by
_DENSE_VIEWS = 3  # that must agree on a pixel's point: flow can err alike in two


@dataclasses.dataclass(frozen=True)
class TriangulatedPoints:
    """Points in the coordinates of the scene that they were made from.

    Attributes:
        positions: (P, 3) float64.
        colors: (P, 3) uint8, mean over the photographs that see a point.
        errors: (P,) pixels, mean distance of a point's projections from its features.
        views: (P,) number of photographs that see a point.
    """

    positions: np.ndarray
    colors: np.ndarray
    errors: np.ndarray
    views: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)


def triangulate(
    scene: Scene,
    options: PosesOptions | None = None,
    *,
    dense: int = 0,
    on_progress: OnProgress | None = None,
) -> TriangulatedPoints:
    """Triangulates points with the scene's own poses, lenses, frame and unit.

    Args:
        scene: from `load_dataset`; rolling shutters keep their motion.
        options: of features, pairs, matches, errors and angles.
        dense: approximate number of pixels of all photographs to follow into their neighbours by
            optical flow, in addition to the features; 0: none.
        on_progress: called with (stage, done, total, text).

    Returns:
        Points in the scene's coordinates.

    Raises:
        InputError: rays of a lens do not meet in one point, or too few matches fit the poses.
    """
    chosen = options or PosesOptions()
    show = on_progress or (lambda stage, done, total, text: None)
    require_central(scene.cameras)
    near = scene.centred
    views = list(near.views)
    photographs = Photographs(
        scene.path, [v.name for v in views], [v.image_path for v in views],
        [v.mask_path for v in views], [near.file_cameras[v.camera_index] for v in views],
    )  # fmt: skip
    features = collect_features(photographs, chosen, show, lambda text: None)
    raw = match_images(photographs.names, features, chosen, show)
    posed = _Posed(views, photographs.lenses, [f.pixels for f in features], chosen)
    pairs = [posed.keep_fitting(a, b, m) for (a, b), m in zip(raw.pairs, raw.matches, strict=True)]
    found = posed.triangulate(pairs, chosen, [f.descriptors for f in features])
    if len(found["points"]) < _FEWEST_POINTS:
        matched = sum(len(m) for m in raw.matches)
        raise InputError(
            f"{scene.path}: only {sum(len(p[2]) for p in pairs):,} of {matched:,} matches fit the "
            f"given poses and lens, which gives {len(found['points'])} points: `gsut doctor` shows "
            "what contradicts what"
        )
    points = _make_points(found, [f.colors for f in features])
    if dense:
        flow = follow_pixels(
            near, found["points"], found["observations"], [f.pixels for f in features], dense, show
        )
        posed = _Posed(views, photographs.lenses, flow.pixels, chosen)
        found = posed.triangulate(
            [posed.keep_fitting(*match) for match in flow.matches], chosen, None
        )
        points = _join_points(points, _make_points(found, flow.colors))
    shift = near.world_offset - scene.world_offset
    return dataclasses.replace(points, positions=points.positions + shift)


class _Posed:
    """Pixels of posed images."""

    def __init__(
        self, views: list[View], lenses: list[Camera], pixels: list[np.ndarray],
        options: PosesOptions,
    ) -> None:  # fmt: skip
        self._views, self._lenses, self._pixels = views, lenses, pixels
        self._diagonal = measure_diagonal(lenses)
        self._rays, self._poses = [], []
        for view, lens, places in zip(views, lenses, pixels, strict=True):
            rays, valid = lens.unproject(places)
            self._rays.append(np.where(np.asarray(valid)[:, None], rays, np.nan))
            self._poses.append(
                compute_readout_poses(view)[find_readout_moments(view, lens, places)]
            )
        error = options.max_two_view_error * self._diagonal / 1000
        self._tolerance = error / measure_pixels_per_radian(lenses[0])
        self._least_angle = _LEAST_PARALLAX / measure_pixels_per_radian(lenses[0])

    def keep_fitting(self, a: int, b: int, matches: np.ndarray) -> tuple[int, int, np.ndarray]:
        """Keeps the matches (M, 2) of two images that fit the given poses."""
        sides = ((a, matches[:, 0]), (b, matches[:, 1]))
        errors = measure_angular_errors(
            np.stack([self._rays[i][rows] for i, rows in sides]),
            np.stack([self._poses[i][rows] for i, rows in sides]),
        )
        return int(a), int(b), matches[errors < self._tolerance]

    def triangulate(
        self,
        pairs: list[tuple[int, int, np.ndarray]],
        options: PosesOptions,
        descriptors: list[np.ndarray] | None,
    ) -> dict[str, Any]:
        """Triangulates pairs' matches; tracks are extended where there are descriptors."""
        lenses = list(dict.fromkeys(self._lenses))
        settings: dict[str, Any] = {
            "max_error": options.max_error * self._diagonal / 1000,
            "min_angle": max(math.radians(options.min_angle), self._least_angle),
        }
        if descriptors is not None:
            settings |= list_extension_settings(options, descriptors, self._lenses)
        directions = [view.shutter.direction if view.shutter else "global" for view in self._views]
        ends = []
        if set(directions) != {"global"}:
            settings["shutter"] = next(each for each in directions if each != "global")
            settings["image_shutters"] = directions
            for view in self._views:
                own = view.camera_from_world
                start, end = view.camera_from_world_start, view.camera_from_world_end
                ends.append((own if start is None else start, own if end is None else end))
        verified = [
            (a, b, matches, np.eye(4), 0, 0.0)
            for a, b, matches in pairs
            if len(matches) >= _FEWEST_MATCHES
        ]
        return _core.triangulate_structure(
            lenses, [lenses.index(c) for c in self._lenses], self._pixels, verified,
            [view.camera_from_world for view in self._views], ends, settings, None,
        )  # fmt: skip


def _make_points(found: dict[str, Any], colors: list[np.ndarray]) -> TriangulatedPoints:
    observations, count = found["observations"], len(found["points"])
    return TriangulatedPoints(
        found["points"], average_colors(observations, count, colors), found["point_errors"],
        np.bincount(observations[:, 0], minlength=count),
    )  # fmt: skip


def _join_points(sparse: TriangulatedPoints, dense: TriangulatedPoints) -> TriangulatedPoints:
    """Joins the features' points and those of pixels that enough photographs see."""
    kept = dense.views >= _DENSE_VIEWS
    names = [field.name for field in dataclasses.fields(TriangulatedPoints)]
    return TriangulatedPoints(
        *(np.concatenate([getattr(sparse, n), getattr(dense, n)[kept]]) for n in names)
    )
