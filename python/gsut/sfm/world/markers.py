"""Square markers of a known size: their corners are features that give metres and the ground.

A corner has the same descriptor in every photograph, so that corners are matched, verified and
adjusted as all other features are; a wrong or moved marker is rejected as a wrong match is.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data.images import decode_image
from gsut.sampling import choose_evenly
from gsut.sfm.mapping import Mapping
from gsut.sfm.photographs import DESCRIPTOR_LENGTH, FEWEST_IMAGES, Features
from gsut.sfm.solution import Solution
from gsut.sfm.world.earth import Earth, find_stated_up, move_to_earth

CORNERS = 4
# From those with the most bits, which the fewest patterns of a scene imitate.
_DICTIONARIES = (
    *("DICT_APRILTAG_36h11", "DICT_APRILTAG_25h9", "DICT_ARUCO_MIP_36h12", "DICT_7X7_250"),
    *("DICT_6X6_250", "DICT_5X5_250", "DICT_ARUCO_ORIGINAL", "DICT_4X4_250"),
)
_EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)])  # two of them are diagonals
_LENGTHS = np.array([1.0, 1.0, 1.0, 1.0, np.sqrt(2.0), np.sqrt(2.0)])  # in edges
# Spread of a marker's lengths over their mean above which it is no square.
_NO_SQUARE = 0.05
# Distance of corners from one plane, over their extent, below which markers lie on the ground, and
# the largest angle of its normal to up by the cameras, which is that of `gsut edit --ground`.
_FLAT = 0.01
_MOST_SLOPE = math.radians(30.0)

Seen = tuple[np.ndarray, np.ndarray]  # ids (K,) and corners (K, 4, 2) in pixels


def add_markers(mapping: Mapping) -> Mapping:
    """Finds markers in all photographs and puts their corners before the other features.

    Args:
        mapping: with features; its options say that there are markers, or nothing is done.

    Raises:
        InputError: no marker is seen in two photographs; says what was sought.
    """
    if mapping.options.marker is None:
        return mapping
    readable = [i for i, features in enumerate(mapping.features) if len(features)]
    looked = choose_evenly(readable)
    found = _find_in_all(mapping, looked, _DICTIONARIES)
    if looked != readable and not any(len(_list_shared(seen)) for seen in found):
        found = _find_in_all(mapping, readable, _DICTIONARIES)
    best = int(np.argmax([len(_list_shared(seen)) for seen in found]))
    (seen,) = _find_in_all(mapping, readable, _DICTIONARIES[best : best + 1], is_exact=True)
    shared = _list_shared(seen)
    if not len(shared):
        raise InputError(
            f"--marker: no marker is seen in two of {len(readable)} photographs; sought: "
            f"{', '.join(map(_shorten, _DICTIONARIES))}. A marker needs a white margin and some 30 "
            "pixels an edge; without --marker lengths stay in units of their own"
        )
    features, ids = list(mapping.features), [np.zeros(0, np.int64)] * len(mapping.features)
    for image, (own, corners) in zip(readable, seen, strict=True):
        kept = np.isin(own, shared)
        ids[image] = own[kept]
        features[image] = _prepend(features[image], own[kept], corners[kept])
    views = [int(sum(np.isin(number, own) for own in ids)) for number in shared]
    mapping.log.note(
        f"markers ({_shorten(_DICTIONARIES[best])}): "
        + ", ".join(f"{n} in {v}" for n, v in zip(shared, views, strict=True))
        + " photographs"
    )
    photographs = dataclasses.replace(mapping.photographs, markers=ids)
    return mapping.replace(features=features, photographs=photographs)


def place_by_markers(mapping: Mapping) -> Mapping:
    """Gives a solution the scale of its markers' edges, and makes y = 0 the ground they lie on.

    Args:
        mapping: with a solution, of features that `add_markers` returned.

    Returns:
        The run in metres, with "markers" of the figures: "edge", "applied", "scale", "frame" (the
        marker whose middle is the origin, or None; see `_find_ground`), "sigma_percent" and each
        marker's "id", "views", "edge" as measured, "residual_px" and "corners" in the world.
    """
    edge, ids = mapping.options.marker, mapping.photographs.markers
    if edge is None or ids is None:
        return mapping
    rows = measure_markers(mapping.solved, ids)
    squares = [row for row in rows if row["spread"] < _NO_SQUARE]
    figures: dict[str, Any] = {"edge": edge, "applied": False, "found": rows}
    if not squares:
        mapping.log.note(
            "no marker's four corners are in the solution of two photographs and a square there: "
            "lengths stay in units of their own"
        )
        return mapping.add_findings({"markers": figures})
    edges = np.array([row["edge"] for row in squares])
    spreads = np.array([row["spread"] for row in squares]) / np.sqrt(len(_EDGES) - 1)
    between = np.std(np.log(edges), ddof=1) / np.sqrt(len(edges)) if len(edges) > 1 else 0.0
    scale = edge / float(np.exp(np.average(np.log(edges), weights=1 / np.maximum(spreads, 1e-6))))
    sigma = float(max(between, np.min(spreads)))
    figures |= {"scale": scale, "sigma_percent": 100 * sigma}
    earth = mapping.found.figures.get("earth", {})
    known = "control points" if "control" in mapping.found.figures else "GPS"
    if known != "GPS" or earth.get("gps", {}).get("applied"):
        mapping.log.note(
            f"metres are those of {known}: by the markers lengths are {scale:.4f} times as long "
            f"(+- {100 * sigma:.2g} %)"
        )
        return mapping.add_findings({"markers": figures})
    mapping.log.note(
        f"{len(squares)} marker(s) of {edge:g} m give metres, to about {200 * sigma:.2g} %"
    )
    ground = None if find_stated_up(mapping.found.figures) is None else _find_ground(squares)
    rotation, origin = (np.eye(3), np.zeros(3)) if ground is None else ground
    moved = move_to_earth(
        mapping.solved, Earth(scale, rotation, -scale * rotation @ origin, {}, ())
    )
    figures |= {"applied": True, "frame": None if ground is None else squares[0]["id"]}
    if ground is not None:
        mapping.log.note(
            f"the markers lie on the ground: y = 0 there, and marker {squares[0]['id']} is the "
            "origin, x to its right and z to its top"
        )
    for row in rows:
        row["edge"] *= scale
        row["corners"] = (scale * (np.array(row["corners"]) - origin) @ rotation.T).tolist()
    fit = mapping.found.rig
    return mapping.replace(solution=moved).add_findings(
        {"markers": figures}, rig=None if fit is None else fit.rescale(scale)
    )


def _find_ground(rows: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray] | None:
    """Finds the ground that markers lie on, and the frame of the first of them.

    Args:
        rows: of `measure_markers`, in a world whose y points down.

    Returns:
        World-from-solution rotation (3, 3), y down along the plane's normal, z from the first
        marker's bottom to its top, and its middle (3,). None: the markers lie in several planes, or
        in one that is steep, such as a wall.
    """
    corners = np.array([row["corners"] for row in rows])
    points = corners.reshape(-1, 3)
    _, extents, axes = np.linalg.svd(points - points.mean(axis=0))
    down = axes[2] * np.sign(axes[2, 1])
    if extents[2] > _FLAT * extents[0] or not down[1] > math.cos(_MOST_SLOPE):
        return None
    # Corners run from the top left one, clockwise as seen from above.
    top = corners[0, :2].sum(axis=0) - corners[0, 2:].sum(axis=0)
    ahead = top - (top @ down) * down
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(down, ahead), down, ahead]), corners[0].mean(axis=0)


def measure_markers(solution: Solution, ids: Sequence[np.ndarray]) -> list[dict[str, Any]]:
    """Measures the markers whose four corners are points of a solution.

    Args:
        ids: (K,) of each image's markers, whose corners are its first features.

    Returns:
        A row each: "id", "views", "edge" (mean, in units of the solution), "spread" (standard
        deviation of its four edges and two diagonals, over their mean), "residual_px" (root mean
        square over its corners) and "corners" (4, 3).
    """
    point, image, feature = solution.observations.T
    own = np.array([CORNERS * len(each) for each in ids])
    rows = np.flatnonzero(feature < own[image])
    number = np.array(
        [ids[i][f // CORNERS] for i, f in zip(image[rows], feature[rows], strict=True)]
    )
    found = []
    for one in np.unique(number):
        mine = rows[number == one]
        corner = feature[mine] % CORNERS
        if len(np.unique(corner)) < CORNERS:
            continue
        # A corner may be several points, where matches contradict each other: the one seen most.
        chosen = [np.bincount(point[mine[corner == c]]).argmax() for c in range(CORNERS)]
        at = solution.points[chosen]
        lengths = np.linalg.norm(at[_EDGES[:, 0]] - at[_EDGES[:, 1]], axis=1) / _LENGTHS
        residuals = solution.residuals[mine[np.isin(point[mine], chosen)]]
        found.append(
            {
                "id": int(one),
                "views": len(np.unique(image[mine])),
                "edge": float(lengths.mean()),
                "spread": float(lengths.std() / lengths.mean()),
                "residual_px": float(np.sqrt((residuals**2).sum(axis=1).mean())),
                "corners": at.tolist(),
            }
        )
    return found


def _find_in_all(
    mapping: Mapping, chosen: Sequence[int], dictionaries: Sequence[str], is_exact: bool = False
) -> list[tuple[Seen, ...]]:
    """Finds the markers of each dictionary in some of the photographs; see `find_markers`."""
    paths = [mapping.photographs.paths[i] for i in chosen]
    threads = mapping.options.threads or _core.num_threads()
    with ThreadPoolExecutor(threads) as pool:
        found = pool.map(partial(find_markers, dictionaries=dictionaries, is_exact=is_exact), paths)
        return list(zip(*found, strict=True))


def find_markers(path: Path, dictionaries: Sequence[str], is_exact: bool) -> list[Seen]:
    """Finds the markers of dictionaries of OpenCV in a photograph.

    Args:
        is_exact: fit lines to their edges, as AprilTag does, which takes seven times as long.
            Corners by the corners of the grey alone lie inside: edges of 50 pixels are 0.7 % short.

    Returns:
        Of each dictionary ids (K,) and corners (K, 4, 2) in pixels, (0.5, 0.5) the centre of the
        top-left pixel. A marker that is there twice is left out.
    """
    import cv2

    grey = cv2.cvtColor(decode_image(path)[0], cv2.COLOR_RGB2GRAY)
    return [_find_of_dictionary(grey, each, is_exact) for each in dictionaries]


def _find_of_dictionary(grey: np.ndarray, dictionary: str, is_exact: bool) -> Seen:
    """Finds the markers of one dictionary in an image (H, W)."""
    import cv2

    settings = cv2.aruco.DetectorParameters()
    if is_exact:
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    detector = cv2.aruco.ArucoDetector(codes, settings)
    corners, ids, _ = detector.detectMarkers(grey)
    if ids is None:
        return np.zeros(0, np.int64), np.zeros((0, CORNERS, 2))
    different, first, counts = np.unique(ids.ravel(), return_index=True, return_counts=True)
    once = first[counts == 1]
    at = np.array(corners, np.float64).reshape(-1, CORNERS, 2)[once]
    return different[counts == 1].astype(np.int64), at


def _list_shared(seen: Sequence[Seen]) -> np.ndarray:
    """Lists the markers that several photographs show."""
    different, counts = np.unique(np.concatenate([ids for ids, _ in seen]), return_counts=True)
    return different[counts >= FEWEST_IMAGES]


def _prepend(features: Features, ids: np.ndarray, corners: np.ndarray) -> Features:
    """Puts the corners of markers before the features of an image."""
    number = (CORNERS * ids[:, None] + np.arange(CORNERS)).ravel()
    descriptors = [np.random.default_rng(n).integers(0, 64, DESCRIPTOR_LENGTH) for n in number]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    own = Features(
        corners.reshape(-1, 2),
        np.repeat(edges, CORNERS).astype(np.float32),
        np.array(descriptors, np.uint8).reshape(-1, DESCRIPTOR_LENGTH),
        np.full((len(number), 3), 128, np.uint8),
    )
    return own.join(features)


def _shorten(dictionary: str) -> str:
    return dictionary.removeprefix("DICT_")
