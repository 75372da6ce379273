"""Draws materials: painted surfaces, walls that are bare or glossy, leaves, fences and signs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from lab.demo_tracer import pictures, surfaces
from lab.demo_tracer.texture import finish_picture, make_noise
from lab.proving.world import Material

_GLOSS = 0.05  # reflectance of varnish and glazed tiles at normal incidence
_POLISHED = 0.35  # of polished metal


@dataclasses.dataclass(frozen=True)
class Style:
    """What the surfaces of a capture are like.

    Args:
        bare: share of the surfaces that have one colour.
        glossy: share of the surfaces that reflect.
        grain: strength of the noise on textured surfaces.
        repeated: all walls have the same texture, without grain.
    """

    bare: float = 0.1
    glossy: float = 0.0
    grain: float = 0.15
    repeated: bool = False


def draw_color(rng: np.random.Generator, low: float = 0.1, high: float = 0.75) -> np.ndarray:
    """Draws a linear albedo that is rather grey."""
    return np.clip(rng.uniform(low, high) * (1 + rng.normal(0, 0.18, 3)), 0.02, 0.9)


def _paint_wall(rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Paints a piece of wall, floor or ground, and returns it with its width in metres."""
    color = np.clip(draw_color(rng) ** 0.45, 0, 1)
    kinds: list[Callable[[], np.ndarray]] = [
        lambda: surfaces.paint_bricks(rng, 2.88, 2.6),
        lambda: surfaces.paint_plaster(rng, 3.0, 2.6, color),
        lambda: surfaces.paint_panels(rng, 3.0, 2.6, color),
        lambda: surfaces.paint_stone(rng, color, 2.0),
        lambda: surfaces.paint_wood(rng, color, 2.0, float(rng.choice([0.1, 0.2]))),
    ]
    picture = kinds[rng.integers(len(kinds))]()
    return finish_picture(picture), picture.shape[1] / surfaces.PIXELS_PER_METRE


def draw_surface(rng: np.random.Generator, style: Style, scale: float = 1.0) -> Material:
    """Draws the material of a wall, a floor or a large thing; `scale` enlarges its pattern."""
    gloss = rough = 0.0
    if rng.random() < style.glossy:
        gloss, rough = (_POLISHED, 0.03) if rng.random() < 0.25 else (_GLOSS, 0.01)
    if rng.random() < style.bare:
        faint = 0.4 * style.grain  # stains
        return Material(draw_color(rng), gloss=gloss, roughness=rough, grain=faint,
                        grain_size=scale)  # fmt: skip
    if rng.random() < 0.4 and not style.repeated:
        return Material(
            draw_color(rng), gloss=gloss, roughness=rough, grain=0.1 + 2.2 * style.grain,
            grain_size=scale * rng.uniform(0.3, 1.5),
        )  # fmt: skip
    texture, width = _paint_wall(rng)
    height = width * texture.shape[0] / texture.shape[1]
    return Material(
        texture=texture, size=(scale * width, scale * height), gloss=gloss, roughness=rough,
        grain=0.0 if style.repeated else 1.8 * style.grain, grain_size=scale,
    )  # fmt: skip


def draw_ground(rng: np.random.Generator, size: float, strength: float = 0.4) -> Material:
    """Draws asphalt, grass or gravel: noise in space alone."""
    paint = ((0.16, 0.16, 0.17), (0.12, 0.2, 0.06), (0.4, 0.36, 0.3), (0.25, 0.16, 0.1))
    return Material(paint[rng.integers(len(paint))], grain=strength, grain_size=size)


def draw_picture(rng: np.random.Generator) -> Material:
    """Draws a picture or sign, each another one."""
    kinds = (pictures.paint_landscape, pictures.paint_circles, pictures.paint_rectangles,
             pictures.paint_night)  # fmt: skip
    if rng.random() < 0.35:
        return Material(texture=finish_picture(_paint_sign(rng)), size=None)
    kind = kinds[rng.integers(len(kinds))]
    return Material(texture=finish_picture(pictures.paint_framed(rng, kind, 96, 128)), size=None)


def _paint_sign(rng: np.random.Generator, height: int = 96, width: int = 160) -> np.ndarray:
    """Paints lines of something like letters."""
    paper, ink = rng.uniform(0.5, 1, 3), rng.uniform(0, 0.35, 3)
    out = np.broadcast_to(paper, (height, width, 3)).copy()
    row = 6
    while row < height - 12:
        tall = int(rng.integers(6, 22))
        column = 6
        while column < width - 12 and row + tall < height - 4:
            wide = int(rng.integers(2, 3 + tall // 2))
            if rng.random() < 0.8:
                out[row : row + tall, column : column + 2] = ink
                if rng.random() < 0.7:
                    middle = row + int(rng.integers(0, tall - 1))
                    out[middle : middle + 2, column : column + wide] = ink
            column += wide + 2
        row += tall + 4
    return out


def draw_bookcase(rng: np.random.Generator) -> Material:
    """Draws shelves of books."""
    return Material(texture=finish_picture(pictures.paint_bookcase(rng, 200, 200)), size=None)


def draw_window_front(rng: np.random.Generator, columns: int, rows: int, alike: float) -> Material:
    """Draws a facade with rows of windows; `alike`: share of the windows that look the same."""
    cell_h, cell_w = 56, 44
    wall = draw_color(rng, 0.2, 0.7) ** 0.45
    out = np.broadcast_to(wall, (rows * cell_h, columns * cell_w, 3)).copy()
    out *= 0.9 + 0.2 * make_noise(rng, out.shape[:2], cell=50, octaves=5)[..., None]
    frame, pane = rng.uniform(0.6, 1.0, 3), rng.uniform(0.05, 0.3, 3)
    for row in range(rows):
        for column in range(columns):
            cell = out[row * cell_h : (row + 1) * cell_h, column * cell_w : (column + 1) * cell_w]
            own = rng.random() > alike
            lit = pane if not own else rng.uniform(0.05, 0.75, 3)
            cell[12:46, 10:34] = frame
            cell[14:44, 12:32] = lit
            cell[14:44, 21:23] = frame
            if own:  # a curtain, a blind, flowers
                curtain = int(rng.integers(2, 26))
                cell[14 : 14 + curtain, 12 : int(rng.integers(20, 32))] = rng.uniform(0.3, 1, 3)
                if rng.random() < 0.4:
                    cell[46:50, 8:36] = rng.uniform(0, 0.7, 3)
            else:
                cell[14:22, 12:32] = 0.8
        out[row * cell_h : row * cell_h + 3] *= 0.7
    return Material(texture=finish_picture(out), size=None)


def draw_leaves(rng: np.random.Generator) -> Material:
    """Draws a card of leaves with gaps."""
    size = 64
    thick = make_noise(rng, (size, size), cell=10, octaves=3)
    rows, columns = np.indices((size, size)) / size - 0.5
    alpha = (thick + 0.35 - np.hypot(rows, columns) > 0.42).astype(np.float32)
    tint = np.array([0.10, 0.24, 0.05]) * rng.uniform(0.6, 1.4, 3)
    shade = 0.4 + 1.2 * make_noise(rng, (size, size), cell=6, octaves=2)[..., None]
    return Material(texture=np.dstack([tint * shade, alpha]), size=None, cut_out=True)


def draw_fence(rng: np.random.Generator) -> Material:
    """Draws upright bars with gaps, one unit wide and high in metres."""
    alpha = np.zeros((64, 64))
    alpha[:, ::16] = alpha[:, 1::16] = 1
    alpha[4:7] = alpha[-8:-5] = 1
    color = np.broadcast_to(draw_color(rng, 0.05, 0.4), (64, 64, 3))
    return Material(texture=np.dstack([color, alpha]), size=(1.0, 1.0), cut_out=True)
