"""Builds the furnished hall: its shapes, their materials, and its lights."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from lab.demo_tracer import pictures, surfaces
from lab.demo_tracer.shapes import Box, Cylinder, Room, Shape, Sphere
from lab.demo_tracer.texture import Material, finish_picture

# Half the room's length and width, and its height: metres, origin on the middle of the floor.
HALF_X = 4.5  # metres from the middle to the walls at -x and +x
HALF_Y = 3.5  # metres from the middle to the walls at -y and +y
HEIGHT = 3.8  # metres


@dataclasses.dataclass(frozen=True)
class Window:
    """A stained-glass window in the wall at +x; the sun shines through it."""

    y: float
    z: float
    width: float
    height: float
    glass: np.ndarray  # (h, w, 3) linear, 0 outside the arch


@dataclasses.dataclass(frozen=True)
class Lamp:
    """A glowing ball that lights the hall."""

    centre: tuple[float, float, float]
    radius: float


@dataclasses.dataclass(frozen=True)
class Hall:
    """The scene that the tracer renders."""

    room: Room
    shapes: tuple[Shape, ...]
    windows: tuple[Window, ...]
    lamps: tuple[Lamp, ...]


@functools.lru_cache(maxsize=2)
def make_hall(seed: int) -> Hall:
    """Builds the hall with textures drawn from a seed; its geometry is always the same."""
    rng = np.random.default_rng(seed)
    windows = tuple(
        Window(y, 0.95, 1.15, 2.3, finish_picture(pictures.paint_stained_glass(rng, 230, 115)))
        for y in (-2.1, 0.0, 2.1)
    )
    lamps = tuple(Lamp((x, 0.0, 2.62), 0.14) for x in (-1.5, 1.5))
    glow = Material(np.full((1, 1, 3), (1.0, 0.83, 0.58), np.float32), emission=2.2)
    shapes: list[Shape] = [Sphere(lamp.centre, lamp.radius, glow, False) for lamp in lamps]
    brass = Material(np.full((1, 1, 3), (0.30, 0.20, 0.08), np.float32))
    for lamp in lamps:
        x, y, z = lamp.centre
        shapes.append(Cylinder((x, y), 0.02, z + 0.14, HEIGHT, brass, False))
        shapes.append(Cylinder((x, y), 0.09, z + 0.12, z + 0.17, brass, False))
    shapes += (
        _build_structure(rng)
        + _build_furniture(rng)
        + _build_decoration(rng)
        + _hang_paintings(rng)
    )
    return Hall(_build_walls(rng, windows), tuple(shapes), windows, lamps)


def _make_material(picture: np.ndarray, width: float, height: float) -> Material:
    return Material(finish_picture(picture), (width, height))


def _build_walls(rng: np.random.Generator, windows: tuple[Window, ...]) -> Room:
    length, width = 2 * HALF_X, 2 * HALF_Y
    east = surfaces.paint_plaster(rng, width, HEIGHT, (0.85, 0.72, 0.50))
    _paint_window_frames(rng, east, windows)
    ceiling_x, ceiling_y = surfaces.place_texels(length, width)
    ceiling = surfaces.paint_planks(rng, ceiling_x, ceiling_y, 0.3, (0.74, 0.60, 0.43))
    sides = (
        _make_material(
            surfaces.paint_panels(rng, width, HEIGHT, (0.52, 0.20, 0.19)), width, HEIGHT
        ),
        _make_material(east, width, HEIGHT),
        _make_material(surfaces.paint_bricks(rng, length, HEIGHT), length, HEIGHT),
        _make_material(
            surfaces.paint_panels(rng, length, HEIGHT, (0.24, 0.45, 0.46)), length, HEIGHT
        ),
        _make_material(surfaces.paint_floor(rng, length, width), length, width),
        _make_material(ceiling, length, width),
    )
    low, high = (-HALF_X, -HALF_Y, 0.0), (HALF_X, HALF_Y, HEIGHT)
    return Room(low, high, sides[0], sides=sides)


def _paint_window_frames(rng, wall: np.ndarray, windows: tuple[Window, ...]) -> None:
    """Paints a stone frame of voussoirs around each arch."""
    y, z = surfaces.place_texels(2 * HALF_Y, HEIGHT)
    y = y - HALF_Y
    block = surfaces.paint_stone(rng, (0.66, 0.63, 0.57))
    for window in windows:
        across = y - window.y
        above = z - (window.z + 0.75 * window.height)
        arch = np.where(above > 0, np.hypot(across, above), np.abs(across)) - window.width / 2
        outside = np.maximum(arch, window.z - z)
        frame = (outside < 0.17) & (z > window.z - 0.14)
        rows, columns = np.nonzero(frame)
        along = np.where(above > 0, np.arctan2(above, np.abs(across)) * 0.7, above)
        joint = np.abs(along[frame] % 0.22 - 0.11) > 0.10
        paint = block[rows % block.shape[0], columns % block.shape[1]]
        wall[frame] = paint * np.where(joint, 0.6, 1.0)[:, None]


def _build_structure(rng: np.random.Generator) -> list[Shape]:
    """Builds beams and columns."""
    oak = _make_material(surfaces.paint_wood(rng, (0.34, 0.20, 0.11)), 2.0, 2.0)
    shapes: list[Shape] = [
        Box((x - 0.13, -HALF_Y, HEIGHT - 0.28), (x + 0.13, HALF_Y, HEIGHT), oak)
        for x in (-3.4, -1.7, 0.0, 1.7, 3.4)
    ]
    mantle = _make_material(surfaces.paint_flutes(rng, (0.80, 0.76, 0.68)), 1.0, 1.0)
    block = _make_material(surfaces.paint_stone(rng, (0.70, 0.64, 0.55)), 1.0, 1.0)
    for x in (-2.9, 2.9):
        for y in (-2.2, 2.2):
            shapes.append(Cylinder((x, y), 0.19, 0.22, HEIGHT - 0.50, mantle))
            for half, bottom, top in ((0.30, 0.0, 0.22), (0.30, HEIGHT - 0.46, HEIGHT - 0.28),
                                      (0.24, HEIGHT - 0.54, HEIGHT - 0.46)):  # fmt: skip
                shapes.append(Box((x - half, y - half, bottom), (x + half, y + half, top), block))
    return shapes


def _build_furniture(rng: np.random.Generator) -> list[Shape]:
    """Builds a table, benches, a bookcase, a chest and crates."""
    walnut = _make_material(surfaces.paint_wood(rng, (0.50, 0.30, 0.16), board=0.16), 2.0, 2.0)
    pine = _make_material(surfaces.paint_wood(rng, (0.72, 0.53, 0.32), board=0.13), 2.0, 2.0)
    shapes: list[Shape] = [Box((-1.0, -0.5, 0.74), (1.0, 0.5, 0.80), walnut)]
    for x in (-0.86, 0.86):
        for y in (-0.38, 0.38):
            shapes.append(Box((x - 0.05, y - 0.05, 0.0), (x + 0.05, y + 0.05, 0.74), walnut))
    for y in (-0.88, 0.88):
        shapes.append(Box((-0.8, y - 0.14, 0.40), (0.8, y + 0.14, 0.45), walnut))
        for x in (-0.62, 0.62):
            shapes.append(Box((x - 0.04, y - 0.12, 0.0), (x + 0.04, y + 0.12, 0.40), walnut))
    books = Material(finish_picture(pictures.paint_bookcase(rng, 230, 280)))
    shapes.append(Box((-HALF_X, -1.4, 0.0), (-HALF_X + 0.36, 1.4, 2.3), books, fitted=True))
    shapes.append(Box((-HALF_X, -1.46, 2.3), (-HALF_X + 0.42, 1.46, 2.38), walnut))
    shapes.append(Box((0.55, HALF_Y - 0.55, 0.0), (1.75, HALF_Y - 0.05, 0.62), walnut))
    shapes.append(Box((0.50, HALF_Y - 0.60, 0.62), (1.80, HALF_Y - 0.05, 0.68), pine))
    shapes.append(Box((-4.2, -3.3, 0.0), (-3.5, -2.6, 0.6), pine))
    shapes.append(Box((-4.1, -3.25, 0.6), (-3.65, -2.8, 1.0), walnut))
    return shapes


def _build_decoration(rng: np.random.Generator) -> list[Shape]:
    """Builds the things on the table, plinths with balls, and potted trees."""

    def wrap_ball(picture: np.ndarray) -> Material:
        return Material(finish_picture(picture))

    def make_plain(red: float, green: float, blue: float) -> Material:
        return Material(finish_picture(np.full((1, 1, 3), (red, green, blue))))

    pot = _make_material(pictures.paint_zigzags(rng), 1.0, 0.45)
    shapes: list[Shape] = [
        Cylinder((-0.62, 0.05), 0.13, 0.80, 0.83, make_plain(0.35, 0.22, 0.12)),
        Cylinder((-0.62, 0.05), 0.03, 0.83, 0.92, make_plain(0.70, 0.52, 0.22)),
        Sphere((-0.62, 0.05, 1.13), 0.22, wrap_ball(pictures.paint_globe(rng))),
        Cylinder(
            (0.62, 0.12), 0.12, 0.80, 1.12, _make_material(pictures.paint_zigzags(rng), 1.0, 0.32)
        ),
        Sphere((0.62, 0.12, 1.27), 0.19, wrap_ball(surfaces.paint_leaves(rng))),
    ]
    bottom = 0.80
    for x, y, half, tall, color in (
        (0.05, -0.20, 0.20, 0.07, (0.55, 0.12, 0.14)),
        (0.07, -0.18, 0.17, 0.06, (0.12, 0.28, 0.45)),
        (0.04, -0.21, 0.15, 0.05, (0.80, 0.64, 0.24)),
    ):  # a pile of books
        low, high = (x - half, y - 0.7 * half, bottom), (x + half, y + 0.7 * half, bottom + tall)
        shapes.append(Box(low, high, make_plain(*color)))
        bottom += tall
    fruit = ((0.02, -0.20, 0.98, 0.06, (0.80, 0.16, 0.10)),
             (0.30, 0.22, 0.87, 0.07, (0.92, 0.58, 0.10)),
             (0.17, 0.27, 0.86, 0.06, (0.55, 0.68, 0.15)))  # fmt: skip
    shapes += [Sphere((x, y, z), r, make_plain(*color)) for x, y, z, r, color in fruit]
    stone = _make_material(surfaces.paint_stone(rng, (0.78, 0.75, 0.70)), 1.0, 1.0)
    for x, y, picture in (
        (-3.75, 2.85, pictures.paint_marble(rng)),
        (3.7, -2.95, pictures.paint_stripes(rng)),
    ):
        shapes.append(Box((x - 0.28, y - 0.28, 0.0), (x + 0.28, y + 0.28, 0.85), stone))
        shapes.append(Sphere((x, y, 1.17), 0.32, wrap_ball(picture)))
    for x, y in ((3.85, 2.85), (-1.2, -3.05), (2.0, -3.05)):
        shapes.append(Cylinder((x, y), 0.24, 0.0, 0.45, pot))
        shapes.append(Cylinder((x, y), 0.04, 0.45, 0.95, make_plain(0.32, 0.21, 0.12)))
        shapes.append(Sphere((x, y, 1.25), 0.40, wrap_ball(surfaces.paint_leaves(rng))))
    return shapes


def _hang_paintings(rng: np.random.Generator) -> list[Shape]:
    """Hangs framed pictures, 4 cm thick, on three walls."""
    thick = 0.04
    shapes: list[Shape] = []

    def hang(kind, along: float, width: float, height: float, wall: int) -> None:
        picture = pictures.paint_framed(rng, kind, round(height * 120), round(width * 120))
        low_z, high_z = 2.05 - height / 2, 2.05 + height / 2
        low, high = along - width / 2, along + width / 2
        material = Material(finish_picture(picture))
        if wall == 0:  # at -x
            corners = (-HALF_X, low, low_z), (-HALF_X + thick, high, high_z)
        elif wall == 2:  # at -y
            corners = (low, -HALF_Y, low_z), (high, -HALF_Y + thick, high_z)
        else:  # at +y
            corners = (low, HALF_Y - thick, low_z), (high, HALF_Y, high_z)
        shapes.append(Box(*corners, material, fitted=True))

    hang(pictures.paint_landscape, -1.55, 1.7, 1.1, 3)
    hang(pictures.paint_rectangles, 1.15, 1.2, 1.2, 3)
    hang(pictures.paint_circles, -3.4, 0.9, 1.2, 3)
    hang(pictures.paint_night, 0.4, 1.8, 1.2, 2)
    hang(pictures.paint_circles, 3.0, 0.9, 0.9, 2)
    hang(pictures.paint_landscape, -2.7, 1.3, 1.0, 2)
    hang(pictures.paint_rectangles, 2.45, 0.9, 1.2, 0)
    hang(pictures.paint_night, -2.45, 0.9, 1.2, 0)
    return shapes
