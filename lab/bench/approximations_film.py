"""Films one path in several orders side by side, above what swaps in each frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import gsut_scalar_baseline
import numpy as np
from PIL import Image, ImageDraw

import gsut
from gsut import _core
from gsut.gaussians import Gaussians
from gsut.render import to_uint8, write_video

# A frame of a film: a turn and a walk at 30 frames a second, at the pace of a hand-held camera.
_TURN_DEGREES = 1.0
_STEP_UNITS = 0.01
_FRAMES_PER_SECOND = 10.0  # a third of the pace, so that an eye can follow
_CELL = 8  # pixels from one pixel whose swap is shown to the next
_GAIN = 10.0  # swaps are shown so many times larger, about grey
_PANEL = 400  # least pixels across a panel
_CAPTION = 20  # pixels above the panels


def move_camera(pose: np.ndarray) -> dict[str, np.ndarray]:
    """Moves a camera by a frame: a turn about its own vertical, a step to its right."""
    angle = np.radians(_TURN_DEGREES)
    turn, step = np.eye(4), np.eye(4)
    turn[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    step[0, 3] = -_STEP_UNITS
    return {"turn": turn @ pose, "step": step @ pose}


def find_lines(camera: gsut.Camera, pose: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Finds the lines (P, K, 6) of pixels (P, K, 2) in the world: origins and directions."""
    lines = np.zeros((*pixels.shape[:2], 6))
    lines[..., :3] = -pose[:3, :3].T @ pose[:3, 3]
    lines[..., 3:] = camera.rays()[0][pixels[..., 0], pixels[..., 1]] @ pose[:3, :3]
    return lines


def draw_lines(
    g: Gaussians, lines: np.ndarray, ordered_from: np.ndarray, order: str
) -> tuple[np.ndarray, ...]:
    """Draws image, alpha and depth of lines (P, K, 6) in double, in the order from a pose."""
    rule = _core.BlendRule()
    rule.order = order
    return gsut_scalar_baseline.render_lines_reference(g, lines, ordered_from, rule)[:3]


def film_orders(
    file: Path,
    model: Gaussians,
    plain: Gaussians,
    camera: gsut.Camera,
    pose: np.ndarray,
    orders: Sequence[str],
    frames: int,
) -> None:
    """Films a camera that turns in place and then steps aside.

    Args:
        file: .mp4, .webm or .gif.
        model: what is shown.
        plain: the same without harmonics, in double, whose swaps are shown.
        camera: the lens.
        pose: camera_from_world (4, 4) of the first frame.
        orders: one panel each.
        frames: of the turn, and of the steps.
    """
    path = [pose]
    for motion in ["turn"] * frames + ["step"] * frames:
        path.append(move_camera(path[-1])[motion])
    write_video(file, _draw_frames(model, plain, camera, path, orders), _FRAMES_PER_SECOND)


def _draw_frames(
    model: Gaussians,
    plain: Gaussians,
    camera: gsut.Camera,
    path: Sequence[np.ndarray],
    orders: Sequence[str],
) -> Iterator[np.ndarray]:
    scale = -(-_PANEL // camera.width)
    largest = dict.fromkeys(orders, 0.0)
    for before, pose in zip([path[0], *path], path, strict=False):
        panels = []
        for order in orders:
            image = gsut.render(model, camera, pose, order=order).image
            swaps = _find_swaps(plain, camera, before, pose, order)
            now = float(np.abs(swaps).max())
            largest[order] = max(largest[order], now)
            both = [to_uint8(image), to_uint8(0.5 + _GAIN * swaps)]
            stacked = np.concatenate(both).repeat(scale, axis=0).repeat(scale, axis=1)
            text = f"{order}: largest swap {now:.3f}, so far {largest[order]:.3f}"
            panels.append(np.concatenate([_write_caption(text, stacked.shape[1]), stacked]))
        yield np.concatenate(panels, axis=1)


def _find_swaps(
    g: Gaussians, camera: gsut.Camera, before: np.ndarray, pose: np.ndarray, order: str
) -> np.ndarray:
    """Finds what the change of order alone changes (H, W, 3): of every `_CELL`-th pixel."""
    sides = [np.arange(_CELL // 2, side, _CELL) for side in (camera.height, camera.width)]
    pixels = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
    has_ray = camera.rays()[1][pixels[..., 0], pixels[..., 1]]
    swaps = np.zeros((*has_ray.shape, 3))
    lines = find_lines(camera, pose, pixels[has_ray][:, None])
    drawn = (draw_lines(g, lines, place, order)[0] for place in (pose, before))
    swaps[has_ray] = np.subtract(*drawn)[:, 0]
    cells = swaps.repeat(_CELL, axis=0).repeat(_CELL, axis=1)
    return cells[: camera.height, : camera.width]


def _write_caption(text: str, width: int) -> np.ndarray:
    strip = Image.new("RGB", (width, _CAPTION), "white")
    ImageDraw.Draw(strip).text((4, 4), text, fill="black")
    return np.asarray(strip)
