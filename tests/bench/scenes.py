"""Makes the scenes that speed is measured on, from a seed."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError, Shutter, exp_pose
from gsut.gaussians import SH_C0, Gaussians
from gsut.lens import Camera

KNOWN_SCENES = (
    "synthetic_100k_640x480",
    "synthetic_1m_1920x1080",
    "peer_10k_480x480",
    "peer_100k_480x480",
    "rolling_shutter_100k_640x480",
)
_SYNTHETIC = re.compile(r"synthetic_(\d+(?:\.\d+)?[km]?)_(\d+)x(\d+)")
_ROLLING = re.compile(r"rolling_shutter_(\d+(?:\.\d+)?[km]?)_(\d+)x(\d+)")
# Left twist of the end pose against the middle one, the start as far on the other side: 8 cm and
# 4 degrees in one frame, in a room of 5 to 10 m.
_ROLLING_TWIST = (0.02, 0.01, -0.03, 0.03, 0.02, -0.01)
_PEER = re.compile(r"peer_(\d+(?:\.\d+)?[km]?)_(\d+)x(\d+)")
_BLOCK = 1 << 17  # Gaussians made at a time: bounds the memory of a scene of millions

# The room: half sizes in x and y, distance of the wall ahead and behind. Units are arbitrary.
_ROOM_X, _ROOM_Y, _ROOM_AHEAD, _ROOM_BEHIND = 4.0, 2.5, 6.0, 4.0
_COS_SPAN = 1.38  # directions with cos(angle from the axis) from 1 down to -0.38: 112 degrees
_ON_WALL, _FAR, _NEEDLES = 0.6, 0.01, 0.02  # shares
_FAR_FACTOR = 50.0
_NEEDLE_SHAPE = (8.0, 0.1, 0.5)  # 80 : 1 before the axes' own spread
# Standard deviation of a Gaussian in pixels that gives about 50 blended Gaussians a pixel at 100 k
# Gaussians on 640 x 480 (measured).
_SIGMA_PIXELS = 1.9


@dataclasses.dataclass
class BenchScene:
    """Gaussians and the camera they are measured through.

    Attributes:
        name: as in the rows.
        gaussians: float32.
        camera: lens and image size.
        camera_from_world: (4, 4), or a CameraMotion.
        origin: one sentence on where the scene comes from.
    """

    name: str
    gaussians: Gaussians
    camera: Camera
    camera_from_world: Any
    origin: str


def scene_from_arrays(name: str, *, ply: str | None = None, data: str | None = None) -> BenchScene:
    """A scene by name.

    Args:
        name: synthetic_N_WxH (room through a fisheye of about 180 degrees), rolling_shutter_N_WxH
            (the same, read out line by line as the camera moves), peer_N_WxH (the scene that other
            projects were measured on), with N such as 10k or 1m.

    Raises:
        InputError: an unknown name; lists the known ones.
    """
    match = _SYNTHETIC.fullmatch(name)
    if match:
        return synthetic_scene(parsed_count(match[1]), int(match[2]), int(match[3]), name=name)
    match = _ROLLING.fullmatch(name)
    if match:
        scene = synthetic_scene(parsed_count(match[1]), int(match[2]), int(match[3]), name=name)
        twist = np.array(_ROLLING_TWIST)
        start, end = (exp_pose(sign * twist) @ scene.camera_from_world for sign in (-1.0, 1.0))
        motion = CameraMotion(start, end, Shutter("top_to_bottom"))
        return dataclasses.replace(scene, camera_from_world=motion)
    match = _PEER.fullmatch(name)
    if match:
        return peer_scene(parsed_count(match[1]), int(match[2]), int(match[3]), name=name)
    raise InputError(
        f'scene "{name}" is unknown; known: {", ".join(KNOWN_SCENES)}; other numbers of Gaussians '
        "and sizes are named alike"
    )


def parsed_count(text: str) -> int:
    """A number of Gaussians like 500, 10k or 2.5m.

    Raises:
        InputError: not such a number, or 0.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([km]?)", text.lower())
    count = round(float(match[1]) * {"": 1, "k": 1000, "m": 1_000_000}[match[2]]) if match else 0
    if count < 1:
        raise InputError(f'a number of Gaussians is like 500, 10k or 2.5m, found "{text}"')
    return count


def synthetic_scene(
    count: int,
    width: int,
    height: int,
    *,
    sigma_pixels: float = _SIGMA_PIXELS,
    sh_degree: int = 3,
    seed: int = 1,
    name: str = "synthetic",
) -> BenchScene:
    """A room of Gaussians around a camera with a Kannala-Brandt fisheye of about 180 degrees.

    60 % lie flat on the walls, the rest inside; sizes are log-normal; 2 % are needles of about
    100 : 1, 1 % stand at 50 times the distance.

    Args:
        count: Gaussians.
        width, height: of the image, pixels.
        sigma_pixels: median standard deviation of a Gaussian in the image's middle, pixels.
        sh_degree: of the harmonics, 0 to 3.
        seed: the same seed gives the same Gaussians, the first ones whatever `count`.
    """
    focal = width / math.pi / 0.98
    params = [focal, focal, width / 2, height / 2, -0.012, 0.003, -0.0008, 0.0]
    coefficients = (sh_degree + 1) ** 2
    g = _empty(count, coefficients)
    for rows, rng in _blocks(count, seed):
        _fill_room(g[rows], rng, sigma_pixels / focal)
    return BenchScene(
        name, g, Camera("kannala_brandt", params, width, height), np.eye(4),
        f"room made from seed {seed}, median sigma {sigma_pixels:.3g} px",
    )  # fmt: skip


def peer_scene(count: int, width: int, height: int, *, name: str = "peer") -> BenchScene:
    """The scene that other renderers were timed on: a box of Gaussians before a pinhole."""
    rng = np.random.default_rng(0)
    means = rng.uniform([-2.0, -1.5, 2.5], [2.0, 1.5, 5.5], (count, 3))
    scales = 0.6 / count ** (1 / 3) * np.exp(rng.normal(0.0, 0.4, (count, 3)))
    quats = rng.normal(size=(count, 4))
    opacity = rng.uniform(0.1, 0.9, count)
    rgb = rng.uniform(0.0, 1.0, (count, 3))
    g = Gaussians(
        means.astype(np.float32), quats, np.log(scales), np.log(opacity / (1 - opacity)),
        ((rgb - 0.5) / SH_C0)[:, None],
    )  # fmt: skip
    focal = 0.9 * width
    camera = Camera("pinhole", [focal, focal, width / 2, height / 2], width, height)
    return BenchScene(name, g, camera, np.eye(4), "numpy default_rng(0)")


def _blocks(count: int, seed: int) -> Iterator[tuple[slice, np.random.Generator]]:
    for block, begin in enumerate(range(0, count, _BLOCK)):
        rows = slice(begin, min(begin + _BLOCK, count))
        yield rows, np.random.default_rng([seed, block])


def _empty(count: int, coefficients: int) -> Gaussians:
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, coefficients, 3))
    return Gaussians(*(np.empty(shape, np.float32) for shape in shapes))


def _fill_room(g: Gaussians, rng: np.random.Generator, radians: float) -> None:
    """Writes the rows of `g`, views into the scene. radians: median size, seen from the camera."""
    # Full blocks are drawn, whatever is kept: the first Gaussians do not depend on the count.
    n, drawn = len(g), _BLOCK

    def uniform(*shape: int) -> np.ndarray:
        return rng.uniform(size=(drawn, *shape))[:n]

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=(drawn, *shape))[:n]

    cosine, turn = 1.0 - _COS_SPAN * uniform(), 2 * math.pi * uniform()
    sine = np.sqrt(1.0 - cosine**2)
    direction = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)
    wall_z = np.where(cosine > 0, _ROOM_AHEAD, _ROOM_BEHIND)
    walls = np.stack([np.full(n, _ROOM_X), np.full(n, _ROOM_Y), wall_z], axis=1)
    to_wall = walls / np.maximum(np.abs(direction), 1e-9)
    axis, distance = to_wall.argmin(axis=1), to_wall.min(axis=1)
    on_wall = uniform() < _ON_WALL
    distance *= np.where(on_wall, 1.0 + 0.01 * normal(), 0.25 + 0.75 * uniform())
    distance = np.where(uniform() < _FAR, _FAR_FACTOR * distance, distance)

    size = radians * np.abs(distance) * np.exp(0.7 * normal())
    spread = np.exp(np.array([0.5, 0.5, 0.3]) * normal(3)) * (1.0, 1.0, 0.15)
    needle = uniform() < _NEEDLES
    scales = size[:, None] * spread * np.where(needle[:, None], _NEEDLE_SHAPE, 1.0)

    # Flat on the wall: the third axis along the wall's normal, turned about it at random.
    half, root = math.pi * uniform(), math.sqrt(0.5)
    c, s = np.cos(half), np.sin(half)
    zero = np.zeros(n)
    along = np.stack([
        root * np.stack([c, s, c, s], axis=1),  # normal x
        root * np.stack([c, -c, s, s], axis=1),  # normal y
        np.stack([c, zero, zero, s], axis=1),  # normal z
    ])  # fmt: skip
    flat = along[axis, np.arange(n)] + 0.03 * normal(4)
    g.means[:] = direction * distance[:, None]
    g.quats[:] = np.where(on_wall[:, None], flat, normal(4))
    g.log_scales[:] = np.log(scales)
    g.opacity_logits[:] = 1.6 * normal() - 1.6
    g.sh[:, 0] = (uniform(3) - 0.5) / SH_C0
    for k in range(1, g.sh.shape[1]):  # one after the other: less memory
        g.sh[:, k] = 0.05 * normal(3)
