"""Boxes, spheres, upright cylinders and the room around them: exact intersections with many rays.

Rays come as three float32 arrays a quantity (x, y, z), so that a test is a few dozen array
operations. Lengths in metres, z up.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Protocol

import numpy as np

from gsut.demo.texture import Material

# Three arrays that broadcast: x, y, z.
Triple = tuple[np.ndarray, ...]

_TINY = np.float32(1e-9)
# Hits closer than this are the surface the ray starts on, metres.
_SKIP = np.float32(1e-4)
_MISS = np.float32(np.inf)


class Rays:
    """N rays: origins and unit directions, and what several tests share."""

    def __init__(self, origin: Triple, direction: Triple) -> None:
        self.origin = origin
        self.direction = direction
        safe = (np.where(np.abs(d) < _TINY, _TINY, d) for d in direction)
        self.inverse: Triple = tuple(np.float32(1.0) / d for d in safe)

    def at(self, distance: np.ndarray | np.floating) -> Triple:
        """Points at these distances."""
        ox, oy, oz = self.origin
        dx, dy, dz = self.direction
        return ox + distance * dx, oy + distance * dy, oz + distance * dz


class Shape(Protocol):
    """What the tracer asks of a shape."""

    @property
    def low(self) -> tuple[float, float, float]:
        """Lower corner of the bounding box."""

    @property
    def high(self) -> tuple[float, float, float]:
        """Upper corner of the bounding box."""

    @property
    def material(self) -> Material:
        """What it is made of."""

    @property
    def casts_shadow(self) -> bool:
        """Whether it stops light."""

    def distance(self, rays: Rays) -> np.ndarray:
        """(N,) distance to the first hit, infinite where there is none."""

    def normal(self, points: Triple) -> Triple:
        """Outward unit normals of points on the surface."""

    def surface(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """Texture coordinates (N,), (N,) of points on the surface; the unit is the material's."""


def _upright(normal: Triple, x, y, z) -> tuple[np.ndarray, np.ndarray]:
    """Of three values the two along a face with this normal: level first, then upwards."""
    along_x, level = np.abs(normal[0]) > 0.5, np.abs(normal[2]) > 0.5
    return np.where(along_x, y, x), np.where(level, y, z)


@dataclasses.dataclass(frozen=True)
class Box:
    """An axis-aligned box.

    Texture: metres, u along the longer side of the face (the grain of wood); `fitted` stretches
    the texture over the face, v upwards.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    material: Material
    fitted: bool = False
    casts_shadow: bool = True

    def _slabs(self, rays: Rays) -> tuple[np.ndarray, np.ndarray]:
        enter, leave = [], []
        for axis in range(3):
            origin, inverse = rays.origin[axis], rays.inverse[axis]
            one = (np.float32(self.low[axis]) - origin) * inverse
            two = (np.float32(self.high[axis]) - origin) * inverse
            enter.append(np.minimum(one, two))
            leave.append(np.maximum(one, two))
        near = np.maximum(np.maximum(enter[0], enter[1]), enter[2])
        return near, np.minimum(np.minimum(leave[0], leave[1]), leave[2])

    def distance(self, rays: Rays) -> np.ndarray:
        """See Shape. A ray that starts inside hits nothing."""
        near, far = self._slabs(rays)
        return np.where((near <= far) & (near > _SKIP), near, _MISS)

    def normal(self, points: Triple) -> Triple:
        """See Shape."""
        relative = []
        for axis in range(3):
            middle = 0.5 * (self.low[axis] + self.high[axis])
            half = 0.5 * (self.high[axis] - self.low[axis])
            relative.append((points[axis] - np.float32(middle)) / np.float32(half))
        face = np.argmax(np.abs(relative), axis=0)
        return tuple(
            np.where(face == axis, np.sign(relative[axis]), np.float32(0.0)) for axis in range(3)
        )

    def surface(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """See Shape."""
        size = [high - low for low, high in zip(self.low, self.high, strict=True)]
        x, y, z = (points[axis] - np.float32(self.low[axis]) for axis in range(3))
        if self.fitted:
            x, y, z = x / np.float32(size[0]), y / np.float32(size[1]), z / np.float32(size[2])
        u, v = _upright(normal, x, y, z)
        if self.fitted:
            return u, v
        along, up = _upright(normal, *(np.float32(length) for length in size))
        return np.where(up > along, v, u), np.where(up > along, u, v)


@dataclasses.dataclass(frozen=True)
class Room(Box):
    """The inside of a box: every ray from within hits it. One material a wall."""

    # By side: -x, +x, -y, +y, floor, ceiling; `material` is not used.
    sides: tuple[Material, ...] = ()

    def distance(self, rays: Rays) -> np.ndarray:
        """See Shape."""
        return self._slabs(rays)[1]

    def normal(self, points: Triple) -> Triple:
        """See Shape. Points inwards."""
        x, y, z = Box.normal(self, points)
        return -x, -y, -z

    def surface(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """See Shape. Metres along the wall and up it; on floor and ceiling along x and y."""
        return _upright(normal, *(p - np.float32(c) for p, c in zip(points, self.low, strict=True)))

    def side(self, normal: Triple) -> np.ndarray:
        """(N,) index into `sides`."""
        axis = np.argmax(np.abs(normal), axis=0)
        negative = normal[0] + normal[1] + normal[2] < 0  # inward normal of a "+" side
        return 2 * axis + negative


@dataclasses.dataclass(frozen=True)
class Sphere:
    """A ball. Texture: longitude and latitude, both in 0..1."""

    centre: tuple[float, float, float]
    radius: float
    material: Material
    casts_shadow: bool = True

    @property
    def low(self) -> tuple[float, float, float]:
        """Lower corner of the bounding box."""
        return tuple(c - self.radius for c in self.centre)  # type: ignore[return-value]

    @property
    def high(self) -> tuple[float, float, float]:
        """Upper corner of the bounding box."""
        return tuple(c + self.radius for c in self.centre)  # type: ignore[return-value]

    def distance(self, rays: Rays) -> np.ndarray:
        """See Shape."""
        offset = [np.float32(c) - o for c, o in zip(self.centre, rays.origin, strict=True)]
        along = sum(o * d for o, d in zip(offset, rays.direction, strict=True))
        root = along * along - sum(o * o for o in offset) + np.float32(self.radius**2)
        near = along - np.sqrt(np.maximum(root, np.float32(0.0)))
        return np.where((root > 0) & (near > _SKIP), near, _MISS)

    def normal(self, points: Triple) -> Triple:
        """See Shape."""
        return tuple(
            (p - np.float32(c)) / np.float32(self.radius)
            for p, c in zip(points, self.centre, strict=True)
        )

    def surface(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """See Shape."""
        x, y, z = normal
        longitude = np.arctan2(y, x) / np.float32(2 * math.pi) + np.float32(0.5)
        return longitude, np.arcsin(np.clip(z, -1, 1)) / np.float32(math.pi) + np.float32(0.5)


@dataclasses.dataclass(frozen=True)
class Cylinder:
    """An upright cylinder with lids. Texture: angle in 0..1 and height in metres."""

    centre: tuple[float, float]
    radius: float
    bottom: float
    top: float
    material: Material
    casts_shadow: bool = True

    @property
    def low(self) -> tuple[float, float, float]:
        """Lower corner of the bounding box."""
        return self.centre[0] - self.radius, self.centre[1] - self.radius, self.bottom

    @property
    def high(self) -> tuple[float, float, float]:
        """Upper corner of the bounding box."""
        return self.centre[0] + self.radius, self.centre[1] + self.radius, self.top

    def distance(self, rays: Rays) -> np.ndarray:
        """See Shape. The entry into the infinite cylinder and the slab, whichever is later."""
        x = np.float32(self.centre[0]) - rays.origin[0]
        y = np.float32(self.centre[1]) - rays.origin[1]
        dx, dy = rays.direction[0], rays.direction[1]
        level = np.maximum(dx * dx + dy * dy, _TINY)
        along = x * dx + y * dy
        root = along * along - level * (x * x + y * y - np.float32(self.radius**2))
        half = np.sqrt(np.maximum(root, np.float32(0.0)))
        one = (np.float32(self.bottom) - rays.origin[2]) * rays.inverse[2]
        two = (np.float32(self.top) - rays.origin[2]) * rays.inverse[2]
        near = np.maximum((along - half) / level, np.minimum(one, two))
        far = np.minimum((along + half) / level, np.maximum(one, two))
        return np.where((root > 0) & (near <= far) & (near > _SKIP), near, _MISS)

    def normal(self, points: Triple) -> Triple:
        """See Shape."""
        x = (points[0] - np.float32(self.centre[0])) / np.float32(self.radius)
        y = (points[1] - np.float32(self.centre[1])) / np.float32(self.radius)
        middle = np.float32(0.5 * (self.bottom + self.top))
        height = (points[2] - middle) / np.float32(0.5 * (self.top - self.bottom))
        square = x * x + y * y
        # On a lid the height is at its limit and the radius is not.
        lid = np.abs(height) > np.sqrt(square)
        length = np.sqrt(np.maximum(square, _TINY))
        zero = np.float32(0.0)
        return (
            np.where(lid, zero, x / length),
            np.where(lid, zero, y / length),
            np.where(lid, np.sign(height), zero),
        )

    def surface(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """See Shape."""
        x = points[0] - np.float32(self.centre[0])
        y = points[1] - np.float32(self.centre[1])
        angle = np.arctan2(y, x) / np.float32(2 * math.pi) + np.float32(0.5)
        return angle, points[2] - np.float32(self.bottom)
