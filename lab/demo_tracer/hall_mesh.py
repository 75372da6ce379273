"""Converts the hall's exact geometry to triangles."""

from __future__ import annotations

import math

import numpy as np

from gsut.surface import Mesh
from lab.demo_tracer.hall import Hall
from lab.demo_tracer.shapes import Box, Cylinder, Room, Shape, Sphere

_ROUND = 64  # sides of a circle: within half a millimetre


def build_hall_mesh(hall: Hall) -> Mesh:
    """Builds the mesh of all surfaces, also where shapes overlap; faces look to the open side.

    Flat ones are exact, round ones within half a millimetre. Metres, the demo's coordinates.
    """
    vertices, faces, count = [], [], 0
    for shape in (hall.room, *hall.shapes):
        places, corners = _triangulate(shape)
        vertices.append(places)
        faces.append(corners + count)
        count += len(places)
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.uint32))


def _triangulate(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(shape, Box):
        places, corners = _triangulate_box(np.array(shape.low), np.array(shape.high))
        return (places, corners[:, ::-1]) if isinstance(shape, Room) else (places, corners)
    turn = 2 * math.pi * np.arange(_ROUND) / _ROUND
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    if isinstance(shape, Cylinder):
        rings = [(shape.radius, shape.bottom), (shape.radius, shape.top)]
        ends = (shape.bottom, shape.top)
        center = shape.centre
    elif isinstance(shape, Sphere):
        tilt = math.pi * np.arange(1, _ROUND // 2) / (_ROUND // 2)
        x, y, z = shape.centre
        radius = shape.radius
        rings = [(radius * math.sin(a), z - radius * math.cos(a)) for a in tilt]
        ends = (z - radius, z + radius)
        center = (x, y)
    else:
        raise TypeError(type(shape))
    return _triangulate_rings(circle, rings, ends, center)


def _triangulate_box(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    quads = np.array(
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    )
    return np.where(bits, high, low), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _triangulate_rings(
    circle: np.ndarray,
    rings: list[tuple[float, float]],
    ends: tuple[float, float],
    center: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Joins rings (radius, height), from below to above, and closes them by a point at each end."""
    places = [
        np.concatenate([radius * circle + center, np.full((_ROUND, 1), height)], axis=1)
        for radius, height in rings
    ]
    below, above = len(rings) * _ROUND, len(rings) * _ROUND + 1
    here = np.arange(_ROUND)
    after = (here + 1) % _ROUND
    faces = [np.stack([np.full(_ROUND, below), after, here], axis=1)]
    for ring in range(len(rings) - 1):
        a, b = ring * _ROUND, (ring + 1) * _ROUND
        faces += [
            np.stack([here + a, after + a, after + b], axis=1),
            np.stack([here + a, after + b, here + b], axis=1),
        ]
    last = (len(rings) - 1) * _ROUND
    faces.append(np.stack([here + last, after + last, np.full(_ROUND, above)], axis=1))
    axis = np.array([[*center, ends[0]], [*center, ends[1]]])
    return np.concatenate([*places, axis]), np.concatenate(faces)
