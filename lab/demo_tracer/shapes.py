"""Intersects many rays with boxes, spheres, upright cylinders and the room around them.

Rays come as three float32 arrays a quantity (x, y, z), so that a test is a few dozen array
operations. Lengths in metres, z up.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Protocol

import numpy as np

from lab.demo_tracer.texture import Material

# Three arrays that broadcast: x, y, z.
Triple = tuple[np.ndarray, ...]

_TINY = np.float32(1e-9)  # replaces smaller divisors
_SKIP = np.float32(1e-4)  # metres; closer hits are the surface that the ray starts on
_MISS = np.float32(np.inf)  # distance of a ray that hits nothing


class Rays:
    """N rays: origins and unit directions, and what several tests share."""

    def __init__(self, origin: Triple, direction: Triple) -> None:
        self.origin = origin
        self.direction = direction
        safe = (np.where(np.abs(d) < _TINY, _TINY, d) for d in direction)
        self.inverse: Triple = tuple(np.float32(1.0) / d for d in safe)

    def locate(self, distance: np.ndarray | np.floating) -> Triple:
        """Returns the points at these distances."""
        ox, oy, oz = self.origin
        dx, dy, dz = self.direction
        return ox + distance * dx, oy + distance * dy, oz + distance * dz


class Shape(Protocol):
    """The interface of a shape for the tracer."""

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

    def intersect(self, rays: Rays) -> np.ndarray:
        """Returns the distance (N,) to the first hit, infinite without one."""

    def compute_normals(self, points: Triple) -> Triple:
        """Computes outward unit normals of points on the surface."""

    def map_texture(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """Maps points on the surface to texture coordinates (N,), (N,), in the material's unit."""


def _choose_axes(normal: Triple, x, y, z) -> tuple[np.ndarray, np.ndarray]:
    """Chooses the two of three values along a face with this normal: level first, then up."""
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

    def _intersect_slabs(self, rays: Rays) -> tuple[np.ndarray, np.ndarray]:
        enter, leave = [], []
        for axis in range(3):
            origin, inverse = rays.origin[axis], rays.inverse[axis]
            one = (np.float32(self.low[axis]) - origin) * inverse
            two = (np.float32(self.high[axis]) - origin) * inverse
            enter.append(np.minimum(one, two))
            leave.append(np.maximum(one, two))
        near = np.maximum(np.maximum(enter[0], enter[1]), enter[2])
        return near, np.minimum(np.minimum(leave[0], leave[1]), leave[2])

    def intersect(self, rays: Rays) -> np.ndarray:
        """Returns the distance to the first hit; a ray that starts inside hits nothing."""
        near, far = self._intersect_slabs(rays)
        return np.where((near <= far) & (near > _SKIP), near, _MISS)

    def compute_normals(self, points: Triple) -> Triple:
        relative = []
        for axis in range(3):
            middle = 0.5 * (self.low[axis] + self.high[axis])
            half = 0.5 * (self.high[axis] - self.low[axis])
            relative.append((points[axis] - np.float32(middle)) / np.float32(half))
        face = np.argmax(np.abs(relative), axis=0)
        return tuple(
            np.where(face == axis, np.sign(relative[axis]), np.float32(0.0)) for axis in range(3)
        )

    def map_texture(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        size = [high - low for low, high in zip(self.low, self.high, strict=True)]
        x, y, z = (points[axis] - np.float32(self.low[axis]) for axis in range(3))
        if self.fitted:
            x, y, z = x / np.float32(size[0]), y / np.float32(size[1]), z / np.float32(size[2])
        u, v = _choose_axes(normal, x, y, z)
        if self.fitted:
            return u, v
        along, up = _choose_axes(normal, *(np.float32(length) for length in size))
        return np.where(up > along, v, u), np.where(up > along, u, v)


@dataclasses.dataclass(frozen=True)
class Room(Box):
    """The inside of a box: every ray from within hits it. One material a wall."""

    # By side: -x, +x, -y, +y, floor, ceiling; `material` is not used.
    sides: tuple[Material, ...] = ()

    def intersect(self, rays: Rays) -> np.ndarray:
        return self._intersect_slabs(rays)[1]

    def compute_normals(self, points: Triple) -> Triple:
        """Computes unit normals that point inwards."""
        x, y, z = Box.compute_normals(self, points)
        return -x, -y, -z

    def map_texture(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        """Maps to metres along the wall and up it; on floor and ceiling along x and y."""
        return _choose_axes(
            normal, *(p - np.float32(c) for p, c in zip(points, self.low, strict=True))
        )

    def find_side(self, normal: Triple) -> np.ndarray:
        """Finds the index (N,) into `sides`."""
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

    def intersect(self, rays: Rays) -> np.ndarray:
        offset = [np.float32(c) - o for c, o in zip(self.centre, rays.origin, strict=True)]
        along = sum(o * d for o, d in zip(offset, rays.direction, strict=True))
        root = along * along - sum(o * o for o in offset) + np.float32(self.radius**2)
        near = along - np.sqrt(np.maximum(root, np.float32(0.0)))
        return np.where((root > 0) & (near > _SKIP), near, _MISS)

    def compute_normals(self, points: Triple) -> Triple:
        return tuple(
            (p - np.float32(c)) / np.float32(self.radius)
            for p, c in zip(points, self.centre, strict=True)
        )

    def map_texture(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
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

    def intersect(self, rays: Rays) -> np.ndarray:
        """Returns the later of the entries into the infinite cylinder and into the slab."""
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

    def compute_normals(self, points: Triple) -> Triple:
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

    def map_texture(self, points: Triple, normal: Triple) -> tuple[np.ndarray, np.ndarray]:
        x = points[0] - np.float32(self.centre[0])
        y = points[1] - np.float32(self.centre[1])
        angle = np.arctan2(y, x) / np.float32(2 * math.pi) + np.float32(0.5)
        return angle, points[2] - np.float32(self.bottom)
