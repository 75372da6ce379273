"""Compares the tracer's light with Mitsuba 3, on diffuse and glossy surfaces and in the sky.

Mitsuba is no dependency: `pip install mitsuba` into another environment of the same Python, and
put its packages on PYTHONPATH. Then `python -m lab.proving.second_opinion SEED...`.
"""

from __future__ import annotations

import dataclasses
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lab.proving.capture import capture
from lab.proving.world import Material, Mesh, Part, Sky

_WIDTH, _HEIGHT, _FIELD = 96, 72, 75.0  # of a pinhole picture, its field in degrees
_SAMPLES = 32  # rays a pixel of the tracer
_PATHS = 128  # of Mitsuba
_BOUNCES = 6
_SKY = (64, 128)  # rows and columns of the sky that Mitsuba is lit by
_MIRROR = 0.9  # reflectance from which a surface is a conductor
_SMOOTH = 0.02  # roughness below which a surface is a mirror
_FAR = 1e6
_DARKEST = 0.02  # of a picture's brightest hundredth: below it, ratios say nothing
_GREY = np.array([0.2126, 0.7152, 0.0722])
_ELEVATIONS = (5.0, 20.0, 45.0, 80.0)  # degrees, where skies are compared, beside the sun


class Camera(NamedTuple):
    """A pinhole camera."""

    origin: np.ndarray  # (3,)
    rotation: np.ndarray  # (3, 3) world from camera: right, down, forward

    def spread_rays(self, samples: int) -> np.ndarray:
        """Spreads (samples * H * W, 3) unit directions over the pixels."""
        rng = np.random.default_rng(0)
        y, x = np.mgrid[:_HEIGHT, :_WIDTH]
        scale = 2 * math.tan(math.radians(_FIELD) / 2) / _WIDTH
        at = np.stack([x, y], axis=2) + rng.random((samples, _HEIGHT, _WIDTH, 2))
        at = (at - [_WIDTH / 2, _HEIGHT / 2]) * scale
        rays = np.concatenate([at, np.ones((*at.shape[:3], 1))], axis=3) @ self.rotation.T
        return (rays / np.linalg.norm(rays, axis=3, keepdims=True)).reshape(-1, 3)


def trace(mesh: Mesh, sky: Sky, camera: Camera, samples: int = _SAMPLES) -> np.ndarray:
    """Traces a picture (H, W, 3) in linear light."""
    rays = camera.spread_rays(samples).astype(np.float32)
    origins = np.broadcast_to(camera.origin.astype(np.float32), rays.shape)
    spread = math.radians(_FIELD) / _WIDTH
    light = mesh.make_tracer(sky).trace(origins, rays, spread, 0, samples)[0]
    return light.reshape(samples, _HEIGHT, _WIDTH, 3).mean(axis=0)


def strip_mesh(mesh: Mesh, with_gloss: bool) -> Mesh:
    """Leaves out what both renderers describe differently: noise in space, and shining lamps."""
    out, known = Mesh(), {}
    for part in mesh.parts:
        material = part.material
        if material.emission > 0 or (material.glass and not with_gloss):
            continue
        if id(material) not in known:
            gloss = material.gloss if with_gloss else 0.0
            known[id(material)] = dataclasses.replace(material, grain=0.0, gloss=gloss)
        out.parts.append(part._replace(material=known[id(material)]))
    out.lamps = list(mesh.lamps)
    return out


def mark_surfaces(mesh: Mesh, camera: Camera) -> np.ndarray:
    """Marks what each pixel's middle sees (H, W): 0 sky, 1 matt, 2 gloss or glass."""
    marked = Mesh()
    for part in mesh.parts:
        is_glossy = part.material.gloss > 0 or part.material.glass
        own = dataclasses.replace(part.material, glass=False)
        marked.parts.append(part._replace(material=own, body=1 + int(is_glossy)))
    rays = camera.spread_rays(1).astype(np.float32)
    origins = np.broadcast_to(camera.origin.astype(np.float32), rays.shape)
    bodies = marked.make_tracer(Sky()).trace(origins, rays, 1e-3, 0, 1, False)[2]
    return np.maximum(bodies, 0).reshape(_HEIGHT, _WIDTH)


class Mitsuba:
    """Renders the same worlds with Mitsuba."""

    def __init__(self, work: Path) -> None:
        import mitsuba

        mitsuba.set_variant("scalar_rgb")
        self._mi, self._work = mitsuba, work

    def render(self, mesh: Mesh, sky: Sky, camera: Camera, with_sky: bool) -> np.ndarray:
        """Renders a picture (H, W, 3): all light, or that of sun and lamps without bounces."""
        depth = _BOUNCES if with_sky else 2
        scene: dict[str, Any] = {
            "type": "scene", "integrator": {"type": "path", "max_depth": depth},
            "sensor": self._describe_sensor(camera),
        }  # fmt: skip
        for number, part in enumerate(mesh.parts):
            file = self._work / f"{number}.ply"
            _write_ply(file, part)
            bsdf = self._describe_surface(part.material)
            scene[f"part{number}"] = {"type": "ply", "filename": str(file), "bsdf": bsdf}
        if sky.sun[0] > 0:
            toward = find_sun(sky)
            scene["sun"] = {"type": "directional", "direction": list(-toward),
                            "irradiance": self._color(math.pi * np.asarray(sky.sun))}  # fmt: skip
        for number, lamp in enumerate(mesh.lamps):
            scene[f"lamp{number}"] = {
                "type": "point", "position": list(lamp[:3]),
                "intensity": self._color(math.pi * np.asarray(lamp[3:6])),
            }  # fmt: skip
        if with_sky:
            turn = self._mi.ScalarTransform4f().rotate([1, 0, 0], 90)
            bitmap = self._mi.Bitmap(spread_sky(sky).astype(np.float32))
            scene["sky"] = {"type": "envmap", "bitmap": bitmap, "to_world": turn}
        return np.array(self._mi.render(self._mi.load_dict(scene)))[..., :3]

    def look_at_sky(self, sky: Sky) -> np.ndarray:
        """Returns what the sky of sun and air sends from beside the sun at each elevation."""
        toward = find_sun(sky)
        air = self._mi.load_dict({
            "type": "scene",
            "sky": {"type": "sunsky", "sun_direction": list(toward), "sun_scale": 0.0},
        })  # fmt: skip
        found = []
        for way in find_ways(toward):
            # The sky's own axes have z upwards.
            ray = self._mi.Ray3f([0.0, 0.0, 0.0], list(way))
            interaction = air.ray_intersect(ray)
            found.append(np.array(air.environment().eval(interaction)))
        return np.array(found)

    def _describe_sensor(self, camera: Camera) -> dict[str, Any]:
        _, down, forward = camera.rotation.T
        pose = self._mi.ScalarTransform4f().look_at(
            origin=list(camera.origin), target=list(camera.origin + forward), up=list(-down)
        )
        return {
            "type": "perspective", "fov": _FIELD, "fov_axis": "x", "to_world": pose,
            "near_clip": 1e-3, "sampler": {"type": "independent", "sample_count": _PATHS},
            "film": {"type": "hdrfilm", "width": _WIDTH, "height": _HEIGHT,
                     "rfilter": {"type": "box"}},
        }  # fmt: skip

    def _color(self, color: np.ndarray) -> dict[str, Any]:
        return {"type": "rgb", "value": [float(value) for value in color]}

    def _describe_surface(self, material: Material) -> dict[str, Any]:
        color: dict[str, Any] = self._color(np.asarray(material.color))
        opacity = None
        if material.texture is not None:
            color = self._describe_texture(material.texture[..., :3] * material.color)
            if material.cut_out:
                opacity = self._describe_texture(np.round(material.texture[..., 3:]))
        if material.glass:
            return {"type": "thindielectric", "int_ior": 1.5}
        if material.gloss >= _MIRROR:
            bsdf: dict[str, Any] = {"type": "conductor", "material": "none"}
        elif material.gloss > 0:
            root = math.sqrt(material.gloss)
            bsdf = {"type": "plastic", "diffuse_reflectance": color,
                    "int_ior": (1 + root) / (1 - root)}  # fmt: skip
            if material.roughness > _SMOOTH:
                # A spread of reflections is twice that of the normals.
                bsdf |= {"type": "roughplastic", "alpha": 0.5 * material.roughness}
        else:
            bsdf = {"type": "diffuse", "reflectance": color}
        bsdf = {"type": "twosided", "bsdf": bsdf}
        return bsdf if opacity is None else {"type": "mask", "opacity": opacity, "bsdf": bsdf}

    def _describe_texture(self, pixels: np.ndarray) -> dict[str, Any]:
        bitmap = self._mi.Bitmap(np.ascontiguousarray(pixels, np.float32))
        return {"type": "bitmap", "bitmap": bitmap, "raw": True}


def spread_sky(sky: Sky) -> np.ndarray:
    """Spreads the tracer's sky over latitude and longitude (H, W, 3), without its sun."""
    rows, columns = _SKY
    down, around = (np.mgrid[:rows, :columns] + 0.5) / np.array(_SKY)[:, None, None]
    ring = np.sin(math.pi * down)
    ways = np.stack([ring * np.sin(2 * math.pi * around), ring * np.cos(2 * math.pi * around),
                     np.cos(math.pi * down)], axis=2)  # fmt: skip
    return _look_up(sky, ways.reshape(-1, 3)).reshape(rows, columns, 3)


def _look_up(sky: Sky, ways: np.ndarray) -> np.ndarray:
    nothing = Mesh()
    nothing.add(np.full((1, 3, 3), _FAR), Material())
    still = dataclasses.replace(sky, sun=(0.0, 0.0, 0.0))
    ways = ways.astype(np.float32)
    return nothing.make_tracer(still).trace(np.zeros_like(ways), ways, 1e-3)[0]


def find_sun(sky: Sky) -> np.ndarray:
    """Finds the direction (3,) toward the sun."""
    toward = np.asarray(sky.toward_sun, np.float64)
    return toward / np.linalg.norm(toward)


def find_ways(toward_sun: np.ndarray) -> np.ndarray:
    """Finds directions (N, 3) at each elevation, a quarter turn from the sun."""
    beside = np.array([-toward_sun[1], toward_sun[0], 0.0])
    beside /= max(float(np.linalg.norm(beside)), 1e-9)
    angles = np.radians(_ELEVATIONS)[:, None]
    return np.cos(angles) * beside + np.sin(angles) * [0.0, 0.0, 1.0]


def _write_ply(file: Path, part: Part) -> None:
    count = len(part.corners)
    u, v = part.uv[..., 0], 1 - part.uv[..., 1]  # rows of a picture run downwards
    vertices = np.concatenate([part.corners, part.normals, np.stack([u, v], axis=2)], axis=2)
    vertices = vertices.reshape(-1, 8)
    faces = np.empty(count, dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, np.arange(3 * count).reshape(-1, 3)
    names = "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v")
    )
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {3 * count}\n{names}"
        f"element face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    file.write_bytes(head.encode() + vertices.astype("<f4").tobytes() + faces.tobytes())


def compare(ours: np.ndarray, theirs: np.ndarray, where: np.ndarray) -> tuple[float, float] | None:
    """Compares brightness where both have light: median ratio, and spread of ratios in stops."""
    a, b = (picture @ _GREY for picture in (ours, theirs))
    least = _DARKEST * max(np.quantile(a, 0.99), np.quantile(b, 0.99))
    seen = where & (a > least) & (b > least)
    if seen.sum() < _HEIGHT:
        return None
    stops = np.log2(a[seen] / b[seen])
    low, high = np.quantile(stops, [0.16, 0.84])
    return float(2 ** np.median(stops)), float(high - low) / 2


def judge(seed: int) -> tuple[object, ...]:
    """Compares both renderers on the first picture's place of a capture: a row of the table."""
    made = capture(seed)
    pose = made.path(made.times[[0]])[0]
    camera, sky = Camera(pose[:3, 3], pose[:3, :3]), made.stage.sky
    with tempfile.TemporaryDirectory(prefix="gsut-prove-") as name:
        other = Mitsuba(Path(name))
        matt, whole = (strip_mesh(made.stage.mesh, gloss) for gloss in (False, True))
        surfaces = mark_surfaces(whole, camera)
        dark = dataclasses.replace(sky, ambient=(0.0, 0.0, 0.0))
        direct = compare(
            trace(matt, dark, camera), other.render(matt, sky, camera, False), surfaces > 0
        )
        ours, theirs = trace(whole, sky, camera), other.render(whole, sky, camera, True)
        parts = [compare(ours, theirs, surfaces == kind) for kind in (1, 2, 0)]
        air = _look_up(sky, find_ways(find_sun(sky))) @ _GREY / (other.look_at_sky(sky) @ _GREY)
    stops = np.log2(air / np.exp(np.log(air).mean()))
    shown = [f"{part[0]:.3f} +- {part[1]:.2f}" if part else "-" for part in (direct, *parts)]
    return (seed, made.family, *shown, " ".join(f"{value:+.1f}" for value in stops))


def main(arguments: Sequence[str]) -> int:
    """Prints the table of the given seeds."""
    heading = (
        "seed", "family", "direct light, ratio +- stops", "matt", "gloss", "sky",
        f"sky at {', '.join(f'{e:.0f}' for e in _ELEVATIONS)} degrees beside air, stops",
    )  # fmt: skip
    print(" | ".join(heading))
    for seed in arguments:
        print(" | ".join(str(value) for value in judge(int(seed))), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
