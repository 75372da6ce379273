"""Traces rays through the hall: distance to the first surface, and its light.

Light: the sun through the stained glass (hard shadows), two lamps (each ray of a pixel aims at
another point of a lamp: soft shadows) and the light of the surroundings, one ray of each pixel ray
into the half space (each into another direction: soft corners). All surfaces are matt, so that a
point has the same colour from everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lab.demo_tracer.hall import HALF_X, Hall
from lab.demo_tracer.shapes import Rays, Shape, Triple
from lab.demo_tracer.texture import to_srgb

_SUN = np.array([0.80, 0.16, 0.58]) / np.linalg.norm([0.80, 0.16, 0.58])  # towards it
_SUN_LIGHT = np.array([15.0, 13.6, 11.0], dtype=np.float32)  # linear light on a facing surface
_LAMP_LIGHT = np.array([3.8, 2.9, 1.9], dtype=np.float32)  # the same, 1 m from a lamp
_LAMP_SOFTNESS = 0.35  # m^2, keeps the light finite beside the lamp
_LAMP_SHADOW_RADIUS = 0.22  # m, a little more than the ball: softer shadows
_AMBIENT_REACH = 1.6  # m, beyond which surroundings do not darken
_AMBIENT = np.array([0.27, 0.27, 0.29], dtype=np.float32)  # light from open surroundings
_WINDOW_GLOW = np.array([0.42, 0.46, 0.55], dtype=np.float32)  # the same, from the windows' side
_GLASS_EMISSION = 1.6  # of the stained glass, times its colour
_LIFT = np.float32(2e-3)  # m, start of secondary rays above the surface
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))  # radians; its multiples spread evenly


class Bounds:
    """Bounding boxes and balls of all shapes: which of them a bundle of rays may hit."""

    def __init__(self, shapes: Sequence[Shape]) -> None:
        self._low = np.array([shape.low for shape in shapes])
        self._high = np.array([shape.high for shape in shapes])
        self._middle = 0.5 * (self._low + self._high)
        self._radius = 0.5 * np.linalg.norm(self._high - self._low, axis=1)

    def find_in_cone(
        self, origin: np.ndarray, directions: np.ndarray, around: float = 0.0
    ) -> np.ndarray:
        """Finds shapes that unit directions (N, 3) may hit, from points within `around` of
        `origin`."""
        axis = directions.mean(axis=0)
        axis = axis / np.linalg.norm(axis)
        spread = math.acos(float(np.clip((directions @ axis).min(), -1, 1)))
        offset = self._middle - origin
        away = np.linalg.norm(offset, axis=1)
        angle = np.arccos(np.clip(offset @ axis / np.maximum(away, 1e-9), -1, 1))
        radius = self._radius + around
        covered = np.arcsin(np.minimum(radius / np.maximum(away, 1e-9), 1))
        return np.flatnonzero((away <= radius) | (angle < spread + covered))

    def find_in_box(self, low: list, high: list) -> np.ndarray:
        """Finds shapes that rays within these corners may hit."""
        return np.flatnonzero(np.all((self._low <= high) & (self._high >= low), axis=1))


def _multiply(a: Triple, b: Triple) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _make_rays(*ends: np.ndarray) -> Rays:
    """Makes rays from origins (N or 1, 3) and directions (N, 3), axis by axis."""
    return Rays(*(tuple(np.ascontiguousarray(a.T, np.float32)) for a in ends))


def spread_directions(count: int) -> np.ndarray:
    """Spreads (count, 3) unit vectors evenly over the sphere (Fibonacci's spiral)."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    angle = np.arange(count) * _GOLDEN_ANGLE
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


class Tracer:
    """Traces bundles of rays from one point, several a pixel."""

    def __init__(self, hall: Hall, samples: int) -> None:
        self._hall = hall
        self._bounds = Bounds(hall.shapes)
        self._samples = samples
        # Neighbouring rays of a pixel get directions far apart.
        shuffled = np.argsort(np.arange(samples) * _GOLDEN_ANGLE % 1.0, kind="stable")
        self._spread = spread_directions(samples)[shuffled]

    def trace_colors(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Traces the display colours of pixels.

        Args:
            origin: (3,) of all rays, metres; or (samples, P, 3), one a ray.
            directions: (samples, P, 3) unit directions, `samples` a pixel.

        Returns:
            (P, 3) sRGB in [0, 1].
        """
        samples, pixels, _ = directions.shape
        flat = directions.reshape(-1, 3)
        origins = origin.reshape(-1, 3)
        rays = _make_rays(origins, flat)
        middle = origins.mean(axis=0)
        around = float(np.linalg.norm(origins - middle, axis=1).max()) if len(origins) > 1 else 0.0
        reached = self._bounds.find_in_cone(middle, flat, around)
        distance, number = self._find_first_hit(rays, reached)
        points = rays.locate(distance)
        normal, albedo, emission = self._describe_surfaces(points, number)
        light = self._gather_light(points, normal)
        radiance = np.where(emission[:, None] > 0, emission[:, None] * albedo, albedo * light)
        shown = 1 - np.exp(-radiance)  # film-like: no hard clipping in the windows
        return to_srgb(shown.reshape(samples, pixels, 3).mean(axis=0))

    def trace_depths(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Traces the distance (N,) in metres along unit directions (N, 3) from origins (N, 3)."""
        return self._find_first_hit(
            _make_rays(origins, directions), np.arange(len(self._hall.shapes))
        )[0]

    def trace_labels(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Traces which surface unit directions (N, 3) from origins (N, 3) meet.

        Returns:
            (N,) the room's sides as `Room.sides`, then the shapes.
        """
        rays = _make_rays(origins, directions)
        distance, number = self._find_first_hit(rays, np.arange(len(self._hall.shapes)))
        room = self._hall.room
        side = room.find_side(room.compute_normals(rays.locate(distance)))
        return np.where(number < 0, side, len(room.sides) + number)

    def _find_first_hit(self, rays: Rays, candidates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Finds the distance (N,) to the first surface and its number (N,): -1 the room, else a
        shape."""
        distance = self._hall.room.intersect(rays)
        number = np.full(distance.shape, -1, dtype=np.int16)
        for index in candidates:
            other = self._hall.shapes[index].intersect(rays)
            closer = other < distance
            number[closer] = index
            distance = np.where(closer, other, distance)
        return distance, number

    def _measure_free_share(self, rays: Rays, length: np.ndarray | np.floating) -> np.ndarray:
        """Measures the share (N,) of the length that rays run before a shape stops them."""
        ends = rays.locate(length)
        if not ends[0].size:
            return np.ones(0, np.float32)
        low = [min(o.min(), e.min()) for o, e in zip(rays.origin, ends, strict=True)]
        high = [max(o.max(), e.max()) for o, e in zip(rays.origin, ends, strict=True)]
        nearest = np.asarray(length)
        for index in self._bounds.find_in_box(low, high):
            if self._hall.shapes[index].casts_shadow:
                nearest = np.minimum(nearest, self._hall.shapes[index].intersect(rays))
        return nearest / length

    def _describe_surfaces(self, points: Triple, number: np.ndarray):
        """Returns normal, albedo (N, 3) and emission (N,) of points on surfaces."""
        normal = tuple(np.zeros_like(p) for p in points)
        albedo = np.zeros((len(number), 3), dtype=np.float32)
        emission = np.zeros(len(number), dtype=np.float32)

        def fill(where: np.ndarray, material, u, v) -> None:
            albedo[where] = material.look_up(u, v)
            emission[where] = material.emission

        for index in np.unique(number):
            where = np.flatnonzero(number == index)
            local = tuple(p[where] for p in points)
            shape = self._hall.room if index < 0 else self._hall.shapes[index]
            local_normal = shape.compute_normals(local)
            for axis in range(3):
                normal[axis][where] = local_normal[axis]
            u, v = shape.map_texture(local, local_normal)
            if index >= 0:
                fill(where, shape.material, u, v)
                continue
            side = self._hall.room.find_side(local_normal)
            for wall in np.unique(side):
                on = np.flatnonzero(side == wall)
                fill(where[on], self._hall.room.sides[wall], u[on], v[on])
            on_wall = where[side == 1]
            glass = self._color_glass(points[1][on_wall], points[2][on_wall])
            open_ = glass.any(axis=1)
            albedo[on_wall[open_]] = glass[open_]
            emission[on_wall[open_]] = _GLASS_EMISSION
        return normal, albedo, emission

    def _color_glass(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Returns the colour (N, 3) of the windows at points of their wall; 0 beside them."""
        color = np.zeros((len(y), 3), dtype=np.float32)
        for window in self._hall.windows:
            rows, columns = window.glass.shape[:2]
            u = (y - np.float32(window.y)) / np.float32(window.width) + np.float32(0.5)
            v = (z - np.float32(window.z)) / np.float32(window.height)
            inside = np.flatnonzero((u >= 0) & (u < 1) & (v > 0) & (v <= 1))
            # In float32 a point just inside can round onto the far edge.
            row = np.minimum(((1 - v[inside]) * rows).astype(np.int32), rows - 1)
            column = np.minimum((u[inside] * columns).astype(np.int32), columns - 1)
            color[inside] = window.glass[row, column]
        return color

    def _gather_light(self, points: Triple, normal: Triple) -> np.ndarray:
        """Gathers the light (N, 3) on surface points, whose order is that of `trace_colors`."""
        lifted = tuple(p + _LIFT * n for p, n in zip(points, normal, strict=True))
        light = self._gather_surroundings(lifted, normal)
        self._add_lamp(light, lifted, normal)
        self._add_sun(light, lifted, normal)
        return light

    def _repeat_samples(self, values: np.ndarray, count: int) -> Triple:
        """Repeats values (samples, 3), one a sample, for rays ordered as in `trace_colors`."""
        spread = np.repeat(values.astype(np.float32), count // self._samples, axis=0)
        return spread[:, 0], spread[:, 1], spread[:, 2]

    def _gather_surroundings(self, points: Triple, normal: Triple) -> np.ndarray:
        count = len(points[0])
        spread = self._repeat_samples(self._spread, count)
        # Normal plus a point of the unit sphere: cosine-distributed about the normal.
        toward = tuple(n + s * np.float32(0.98) for n, s in zip(normal, spread, strict=True))
        length = np.sqrt(_multiply(toward, toward))
        direction = tuple(t / length for t in toward)
        rays = Rays(points, direction)
        reach = np.float32(_AMBIENT_REACH)
        free = np.minimum(
            self._measure_free_share(rays, reach), self._hall.room.intersect(rays) / reach
        )
        free = np.clip(free, np.float32(0.0), np.float32(1.0)) ** np.float32(0.7)
        to_windows = np.maximum(direction[0], np.float32(0.0)) ** 2
        near_windows = np.float32(1.0) / (1 + ((np.float32(HALF_X) - points[0]) / 3) ** 2)
        upward = np.float32(1.0) + np.float32(0.25) * direction[2]
        sky = (to_windows * (np.float32(0.4) + near_windows))[:, None] * _WINDOW_GLOW
        return (upward[:, None] * _AMBIENT + sky) * free[:, None]

    def _add_lamp(self, light: np.ndarray, points: Triple, normal: Triple) -> None:
        """Adds the lamps: every second ray of a pixel sees one, the others the other, twice as
        bright."""
        lamps = self._hall.lamps
        centres = np.array([lamp.centre for lamp in lamps])
        offsets = spread_directions(self._samples) * _LAMP_SHADOW_RADIUS
        chosen = centres[np.arange(self._samples) % len(lamps)] + offsets
        target = self._repeat_samples(chosen, len(points[0]))
        toward = tuple(t - p for t, p in zip(target, points, strict=True))
        square = _multiply(toward, toward)
        length = np.sqrt(square)
        direction = tuple(t / length for t in toward)
        cosine = np.maximum(_multiply(direction, normal), np.float32(0.0))
        facing = np.flatnonzero(cosine > 0)
        rays = Rays(tuple(p[facing] for p in points), tuple(d[facing] for d in direction))
        free = self._measure_free_share(rays, length[facing]) >= 1
        strength = cosine / (square + np.float32(_LAMP_SOFTNESS)) * np.float32(len(lamps))
        light[facing] += (strength[facing] * free)[:, None] * _LAMP_LIGHT

    def _add_sun(self, light: np.ndarray, points: Triple, normal: Triple) -> None:
        sun = _SUN.astype(np.float32)
        cosine = normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2]
        length = (np.float32(HALF_X) - points[0]) / sun[0]
        y, z = points[1] + length * sun[1], points[2] + length * sun[2]
        lit = np.flatnonzero((cosine > 0) & (length > 0.01) & (z < 3.3))
        if len(lit) == 0:
            return
        glass = self._color_glass(y[lit], z[lit])
        through = glass.any(axis=1)
        lit, glass = lit[through], glass[through]
        if len(lit) == 0:
            return
        direction = tuple(np.full(len(lit), value, dtype=np.float32) for value in sun)
        rays = Rays(tuple(p[lit] for p in points), direction)
        free = self._measure_free_share(rays, length[lit]) >= 1
        light[lit] += (cosine[lit] * free)[:, None] * _SUN_LIGHT * glass
