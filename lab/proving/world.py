"""Builds a world of textured triangles, and traces rays through it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import gsut_proving_tracer
import numpy as np

MOVER = 1  # body of what moves; 0 is the world that stands still


@dataclasses.dataclass(eq=False)
class Material:
    """How a surface looks.

    Args:
        color: linear albedo; multiplies the texture.
        texture: (H, W, 3 or 4) linear, the last channel its alpha; repeats without seams or not.
        size: width and height of the texture on a surface, metres; None: it fits each face once.
        gloss: reflectance at normal incidence: 0 matt, 0.04 varnish, 1 a mirror.
        roughness: tangent of the spread of reflections.
        emission: light that leaves the surface.
        cut_out: transparent where alpha is below one half.
        glass: a thin pane.
        grain: strength of the noise in space that multiplies the albedo.
        grain_size: its largest feature, metres.
    """

    color: Sequence[float] = (1.0, 1.0, 1.0)
    texture: np.ndarray | None = None
    size: tuple[float, float] | None = (1.0, 1.0)
    gloss: float = 0.0
    roughness: float = 0.0
    emission: float = 0.0
    cut_out: bool = False
    glass: bool = False
    grain: float = 0.0
    grain_size: float = 1.0


@dataclasses.dataclass(frozen=True)
class Sky:
    """Light from outside, in linear light.

    Args:
        toward_sun: direction, of any length. sun: its light on a facing surface; 0: no sun.
        zenith, horizon: light of the sky itself.
        ambient: light of open surroundings. sky_share: how far it has the sky's directions.
        clouds: 0 none to 1. reach: metres beyond which surroundings do not darken.
        seed: of the clouds. shine_spread: exponent of the sun's glow.
    """

    toward_sun: Sequence[float] = (0.4, 0.3, 0.85)
    sun: Sequence[float] = (0.0, 0.0, 0.0)
    zenith: Sequence[float] = (0.25, 0.42, 0.8)
    horizon: Sequence[float] = (0.75, 0.82, 0.9)
    ambient: Sequence[float] = (0.5, 0.5, 0.5)
    sky_share: float = 0.0
    clouds: float = 0.0
    reach: float = 2.0
    seed: int = 0
    shine_spread: float = 2000.0

    def pack(self) -> np.ndarray:
        """Returns the row (1, 20) that the tracer reads."""
        sun = np.asarray(self.toward_sun, np.float64)
        rest = (self.sky_share, self.clouds, self.reach, self.seed % 1000, self.shine_spread)
        parts = (sun / np.linalg.norm(sun), self.sun, self.zenith, self.horizon, self.ambient, rest)
        return np.concatenate([np.asarray(part, np.float32) for part in parts])[None]


class Part(NamedTuple):
    """Triangles of one material."""

    corners: np.ndarray  # (T, 3, 3) metres
    normals: np.ndarray  # (T, 3, 3)
    uv: np.ndarray  # (T, 3, 2) in units of the texture
    material: Material
    body: int


class Mesh:
    """Triangles with a material each."""

    def __init__(self) -> None:
        self.parts: list[Part] = []
        self.lamps: list[tuple[float, ...]] = []

    def add(
        self,
        corners: np.ndarray,
        material: Material,
        uv: np.ndarray | None = None,
        normals: np.ndarray | None = None,
        body: int = 0,
    ) -> None:
        """Adds triangles (T, 3, 3) in metres, with uv (T, 3, 2) in units of the texture."""
        corners = np.asarray(corners, np.float64).reshape(-1, 3, 3)
        if normals is None:
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            length = np.linalg.norm(normal, axis=1, keepdims=True)
            normals = np.repeat((normal / np.maximum(length, 1e-30))[:, None], 3, axis=1)
        uv = np.zeros((len(corners), 3, 2)) if uv is None else uv
        self.parts.append(Part(corners, normals, uv, material, body))

    def add_quad(
        self, corner: Sequence[float], edge1: Sequence[float], edge2: Sequence[float],
        material: Material, body: int = 0, shift: tuple[float, float] = (0.0, 0.0),
    ) -> None:  # fmt: skip
        """Adds a parallelogram; the texture's u runs along edge1, v along edge2."""
        a, e, f = (np.asarray(x, np.float64) for x in (corner, edge1, edge2))
        width, height = np.linalg.norm(e), np.linalg.norm(f)
        size = (width, height) if material.size is None else material.size
        low = np.asarray(shift, np.float64)
        high = np.add(low, (width / size[0], height / size[1]))
        points = np.array([[a, a + e, a + e + f], [a, a + e + f, a + f]])
        (u0, v0), (u1, v1) = low, high
        uv = np.array([[[u0, v0], [u1, v0], [u1, v1]], [[u0, v0], [u1, v1], [u0, v1]]])
        self.add(points, material, uv, body=body)

    def add_box(
        self,
        low: Sequence[float],
        high: Sequence[float],
        material: Material,
        turn: float = 0.0,
        top: Material | None = None,
    ) -> None:
        """Adds a box, turned by `turn` radians about its upright axis."""
        lo, hi = np.asarray(low, np.float64), np.asarray(high, np.float64)
        middle, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
        turned = turn_about_z(turn)
        x, y, z = (turned[:, k] * half[k] for k in range(3))
        for axis, side, up in ((x, y, z), (-x, -y, z), (y, -x, z), (-y, x, z)):
            self.add_quad(middle + axis - side - up, 2 * side, 2 * up, material)
        for face, sign in ((top or material, 1.0), (material, -1.0)):
            self.add_quad(middle + sign * z - x - sign * y, 2 * x, 2 * sign * y, face)

    def add_room(
        self, low: Sequence[float], high: Sequence[float], walls: Sequence[Material],
        floor: Material, ceiling: Material | None,
    ) -> None:  # fmt: skip
        """Adds a room seen from inside: walls at -x, +x, -y, +y."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        up = (0, 0, z1 - z0)
        self.add_quad((x0, y0, z0), (0, y1 - y0, 0), up, walls[0])
        self.add_quad((x1, y1, z0), (0, y0 - y1, 0), up, walls[1])
        self.add_quad((x1, y0, z0), (x0 - x1, 0, 0), up, walls[2])
        self.add_quad((x0, y1, z0), (x1 - x0, 0, 0), up, walls[3])
        self.add_quad((x0, y0, z0), (x1 - x0, 0, 0), (0, y1 - y0, 0), floor)
        if ceiling is not None:
            self.add_quad((x0, y0, z1), (x1 - x0, 0, 0), (0, y1 - y0, 0), ceiling)

    def add_cylinder(
        self, foot: Sequence[float], radius: float, height: float, material: Material,
        sides: int = 20, top_radius: float | None = None,
    ) -> None:  # fmt: skip
        """Adds an upright cylinder or cone, open below."""
        self.add_lathe(foot, [(radius, 0.0), (radius if top_radius is None else top_radius, height),
                              (0.0, height)], material, sides)  # fmt: skip

    def add_ball(
        self, middle: Sequence[float], radii: float | Sequence[float], material: Material,
        body: int = 0, rings: int = 12,
    ) -> None:  # fmt: skip
        """Adds an ellipsoid."""
        profile = [(math.sin(a), -math.cos(a)) for a in np.linspace(0, math.pi, rings + 1)]
        self.add_lathe(middle, profile, material, 2 * rings, np.broadcast_to(radii, 3), body)

    def add_lathe(
        self, foot: Sequence[float], profile: Sequence[tuple[float, float]], material: Material,
        sides: int = 24, scale: Sequence[float] = (1.0, 1.0, 1.0), body: int = 0,
    ) -> None:  # fmt: skip
        """Adds a surface of revolution about an upright axis: (radius, height) from below."""
        angle = np.linspace(0, 2 * math.pi, sides + 1)
        radius, height = np.array(profile, np.float64).T
        ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        grid = radius[:, None, None] * ring + height[:, None, None] * [0, 0, 1]
        grid = grid * scale + np.asarray(foot, np.float64)
        slope = np.gradient(np.stack([radius, height], axis=1), axis=0)
        out = slope[:, 1, None, None] * ring - slope[:, 0, None, None] * [0, 0, 1]
        out = out / np.asarray(scale, np.float64)
        out /= np.maximum(np.linalg.norm(out, axis=2, keepdims=True), 1e-9)
        along = np.concatenate([[0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
        around = 2 * math.pi * max(radius.max(), 1e-9)
        size = (around, along[-1]) if material.size is None else material.size
        repeats = max(1.0, round(around * float(np.mean(scale[:2])) / size[0]))
        u = np.broadcast_to(angle / (2 * math.pi) * repeats, grid.shape[:2])
        v = np.broadcast_to((along * float(scale[2]) / size[1])[:, None], grid.shape[:2])
        self.add_grid(grid, material, np.stack([u, v], axis=2), out, body)

    def add_grid(
        self,
        grid: np.ndarray,
        material: Material,
        uv: np.ndarray,
        normals: np.ndarray | None = None,
        body: int = 0,
    ) -> None:
        """Adds the cells of a grid of points (R, C, 3), with uv (R, C, 2)."""

        def split(values: np.ndarray) -> np.ndarray:
            a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]
            faces = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)
            return faces.reshape(-1, 3, values.shape[-1])

        if normals is None:
            across, along = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
            normals = np.cross(across, along)
            normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-30)
        self.add(split(grid), material, split(uv), split(normals), body)

    def add_lamp(self, place: Sequence[float], light: Sequence[float], radius: float) -> None:
        """Adds a lamp: a ball that lights, `light` on a facing surface 1 m away, and shines."""
        self.lamps.append((*place, *light, radius))
        brightest = max(light)
        glow = Material([value / brightest for value in light], emission=4.0)
        self.add_ball(place, radius, glow, rings=6)

    def combine(self, other: Mesh) -> Mesh:
        """Returns this and another one together."""
        out = Mesh()
        out.parts = self.parts + other.parts
        out.lamps = self.lamps + other.lamps
        return out

    def make_tracer(self, sky: Sky) -> gsut_proving_tracer.Tracer:
        """Makes a tracer of all triangles."""
        materials: list[Material] = []
        for part in self.parts:
            if all(part.material is not known for known in materials):
                materials.append(part.material)
        textures: list[np.ndarray] = []
        rows = []
        for material in materials:
            number = -1
            if material.texture is not None:
                same = [i for i, known in enumerate(textures) if known is material.texture]
                number = same[0] if same else len(textures)
                if not same:
                    textures.append(material.texture)
            rows.append([
                *material.color, number, material.gloss, material.roughness, material.emission,
                material.cut_out, material.glass, material.grain, material.grain_size,
            ])  # fmt: skip
        numbers = {id(material): number for number, material in enumerate(materials)}
        corners, normals, uv = (np.concatenate([p[k] for p in self.parts]) for k in range(3))
        counts = [len(part.corners) for part in self.parts]
        return gsut_proving_tracer.Tracer(
            corners, normals, uv,
            np.repeat([numbers[id(part.material)] for part in self.parts], counts),
            np.repeat([part.body for part in self.parts], counts),
            np.array(rows, np.float32), [_add_alpha(texture) for texture in textures],
            sky.pack(), np.array(self.lamps, np.float32).reshape(-1, 7),
        )  # fmt: skip


def _add_alpha(texture: np.ndarray) -> np.ndarray:
    if texture.shape[2] == 4:
        return np.asarray(texture, np.float32)
    return np.dstack([texture, np.ones(texture.shape[:2])]).astype(np.float32)


def turn_about_z(angle: float) -> np.ndarray:
    """Returns the rotation (3, 3) about the upright axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
