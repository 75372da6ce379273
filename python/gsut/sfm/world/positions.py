"""Reads where photographs were taken, and aligns a scene with it: metric, upright and north."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.poses import find_centers
from gsut.files import read_table, register_reader
from gsut.sfm.solution import similarity_from_points
from gsut.sfm.world.control_file import ON_A_LINE

_GEODETIC = ("latitude", "longitude", "altitude")  # columns in degrees and metres
_METRIC = ("x", "y", "z")  # columns in metres
_COLUMNS = {name: name for name in ("name", *_GEODETIC, *_METRIC)} | {
    "label": "name", "filename": "name", "file": "name", "image": "name", "photo": "name",
    "lat": "latitude", "lon": "longitude", "lng": "longitude", "alt": "altitude",
    "elevation": "altitude", "height": "altitude", "easting": "x", "east": "x", "northing": "y",
    "north": "y", "up": "z",
}  # fmt: skip
_MOST_DEGREES = (90.0, 180.0)  # of latitude and longitude
_EARTH_RADIUS = 6378137.0  # metres, semi-major axis of WGS 84
_ECCENTRICITY_2 = 6.69437999014e-3  # squared, of WGS 84
# From east, north, up to the axes of a scene: x right, y down, z ahead.
SCENE_FROM_EAST_NORTH_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
# Different places, or orientations: a similarity fits three, and nearly four, whatever they are.
FEWEST_PLACES = 5


@dataclasses.dataclass(frozen=True)
class PositionFit:
    """x -> scale rotation x + translation moves a scene to where its photographs were taken.

    Attributes:
        scale: metres over the scene's unit.
        rotation, translation: (3, 3) and (3,); afterwards x is east, -y up, z north.
        rms: remaining distance in metres between cameras and positions.
        count: photographs with a position.
        is_upside_down: the cameras' tops then point down, or they look up: on a flat path, east and
            north in each other's place do that without any remaining distance.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray
    rms: float
    count: int
    is_upside_down: bool


@register_reader("positions of photographs", ".csv", ".txt")
def read_positions(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Reads the positions of photographs from a CSV file with a heading.

    Args:
        path: columns name,x,y,z (metres; x east, y north, z up) or
            name,latitude,longitude,altitude (degrees and metres, WGS 84), in any order, also by
            other usual names; see `read_table`.

    Returns:
        name -> (3,) east, north, up in metres; geodetic positions are relative to the first.

    Raises:
        InputError: cannot be read, lacks a column, or a line is wrong; file and line are named.
    """
    heading, table = read_table(path, _COLUMNS, "name")
    if "x" in heading and "z" not in heading and "altitude" in heading:
        heading = ["z" if name == "altitude" else name for name in heading]
        table = [(line, {**row, "z": row["altitude"]}) for line, row in table]
    wanted = next((w for w in (_GEODETIC, _METRIC) if {"name", *w} <= set(heading)), None)
    if wanted is None:
        raise InputError(
            f"{path}: the first line must name the columns name,{','.join(_GEODETIC)} or "
            f"name,{','.join(_METRIC)}; found {','.join(heading) or 'nothing'}"
        )
    rows: dict[str, np.ndarray] = {}
    for line, row in table:
        try:
            values = np.array([float(row[key]) for key in wanted])
        except (TypeError, ValueError):
            values = np.full(3, np.nan)
        if not np.isfinite(values).all() or not row["name"]:
            raise InputError(f"{path}:{line}: a name and three numbers are needed")
        if wanted == _GEODETIC and (np.abs(values[:2]) > _MOST_DEGREES).any():
            raise InputError(
                f"{path}:{line}: latitude {values[0]:g} and longitude {values[1]:g} are no degrees "
                "on the earth; are they exchanged?"
            )
        if not np.array_equal(rows.setdefault(row["name"], values), values):
            raise InputError(f"{path}:{line}: {row['name']} is there twice, with other numbers")
    if wanted == _GEODETIC and rows:
        geodetic = np.stack(list(rows.values()))
        return dict(zip(rows, convert_to_east_north_up(geodetic, geodetic[0]), strict=True))
    return rows


def fit_positions(
    poses: Mapping[str, np.ndarray], positions: Mapping[str, np.ndarray], source: object
) -> PositionFit:
    """Fits the similarity that moves cameras to their positions with the least squared distance.

    Args:
        poses: name of a photograph -> (4, 4) camera_from_world.
        positions: of `read_positions`; names may lack folders.
        source: of the positions, for errors.

    Raises:
        InputError: fewer than three photographs have one, a name without its folder stands for
            several, they lie on a line, or the positions do not follow the cameras.
    """
    by_file: dict[str, list[str]] = {}
    for name in poses:
        by_file.setdefault(Path(name).name, []).append(name)
    pairs = []
    for name, place in positions.items():
        named = [name] if name in poses else by_file.get(Path(name).name, [])
        if len(named) > 1:
            raise InputError(
                f"{source}: {name} may be {named[0]} or {named[1]}; give the name with its folder"
            )
        pairs += [(poses[each], place) for each in named]
    if len(pairs) < 3:
        raise InputError(
            f"{source}: {len(pairs)} of its {len(positions)} names are photographs of the run; 3 "
            f"at least are needed. The run's are like {next(iter(poses), '?')}"
        )
    cameras = np.stack([pose for pose, _ in pairs])
    centers = find_centers(cameras)
    places = np.stack([place for _, place in pairs]) @ SCENE_FROM_EAST_NORTH_UP.T
    for points in (centers, places):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if not spread[1] > ON_A_LINE * spread[0]:
            raise InputError(f"{source}: the photographs lie on a line, which leaves up open")
    scale, rotation, translation = similarity_from_points(centers, places)
    rms = _find_rms(scale * centers @ rotation.T + translation - places)
    _require_agreement(centers, places, rms, source)
    # Cameras are held upright or look down: then neither y nor z of theirs points up.
    downwards = rotation[1] @ cameras[:, 1:3, :3].sum(axis=(0, 1))
    return PositionFit(scale, rotation, translation, rms, len(pairs), bool(downwards < 0))


def _find_rms(offsets: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(offsets**2, axis=1))))


def _require_agreement(centers: np.ndarray, places: np.ndarray, rms: float, source: object) -> None:
    """Refuses positions (N, 3) that say nothing of cameras (N, 3), as those of other photographs.

    Each is predicted by the fit of the others; positions in another order are predicted no better
    than by their mean.
    """
    if len(centers) < FEWEST_PLACES:
        return
    predicted, by_mean = [], []
    for left_out in range(len(centers)):
        others = np.arange(len(centers)) != left_out
        scale, rotation, translation = similarity_from_points(centers[others], places[others])
        predicted.append(scale * rotation @ centers[left_out] + translation - places[left_out])
        by_mean.append(places[others].mean(axis=0) - places[left_out])
    if _find_rms(np.stack(predicted)) >= _find_rms(np.stack(by_mean)):
        raise InputError(
            f"{source}: its positions do not follow the cameras: after the best fit they are "
            f"{rms:.3g} m (rms) apart, and each is predicted by the others no better than by their "
            "mean; look whether names, columns and their order are those of these photographs"
        )


def convert_to_east_north_up(geodetic: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Converts (N, 3) latitudes, longitudes, altitudes to metres relative to an origin (3,)."""
    geodetic = np.concatenate([origin[None], geodetic])
    latitude, longitude = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1])
    sin, cos = np.sin(latitude), np.cos(latitude)
    normal = _EARTH_RADIUS / np.sqrt(1 - _ECCENTRICITY_2 * sin**2)
    across = (normal + geodetic[:, 2]) * cos
    places = np.stack(
        [across * np.cos(longitude), across * np.sin(longitude),
         (normal * (1 - _ECCENTRICITY_2) + geodetic[:, 2]) * sin], axis=1,
    )  # fmt: skip
    s, c, t, u = sin[0], cos[0], np.sin(longitude[0]), np.cos(longitude[0])
    axes = np.array([[-t, u, 0.0], [-s * u, -s * t, c], [c * u, c * t, s]])
    return (places[1:] - places[0]) @ axes.T
