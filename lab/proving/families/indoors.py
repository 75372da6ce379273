"""Scenes in houses: a furnished hall, a corridor of one texture, rooms with doors, a staircase."""

from __future__ import annotations

import math

import numpy as np

from lab.proving.paints import (
    Style,
    draw_bookcase,
    draw_color,
    draw_picture,
    draw_surface,
)
from lab.proving.stage import Stage
from lab.proving.world import Material, Mesh, Sky

_GLAZED = 3  # every such picture hangs behind glass
_INDOORS = Sky(ambient=(0.5, 0.48, 0.45), reach=1.6)


def furnish(
    rng: np.random.Generator,
    mesh: Mesh,
    style: Style,
    low: np.ndarray,
    high: np.ndarray,
    count: int,
) -> None:
    """Puts furniture along the walls of a room and pictures on them."""
    for _ in range(count):
        side = int(rng.integers(4))
        deep, wide, tall = rng.uniform([0.3, 0.4, 0.4], [0.6, 1.6, 2.0])
        axis, is_far = side // 2, side % 2
        wide = min(wide, 0.9 * float(high[1 - axis] - low[1 - axis]))
        along = rng.uniform(low[1 - axis] + wide / 2, high[1 - axis] - wide / 2)
        a, b = np.zeros(3), np.zeros(3)
        a[axis] = high[axis] - deep if is_far else low[axis]
        b[axis] = a[axis] + deep
        a[1 - axis], b[1 - axis] = along - wide / 2, along + wide / 2
        a[2], b[2] = low[2], low[2] + tall
        books = tall > 1.2 and rng.random() < 0.5
        mesh.add_box(a, b, draw_bookcase(rng) if books else draw_surface(rng, style))
        if tall < 1.2:
            place = [rng.uniform(a[0], b[0]), rng.uniform(a[1], b[1]), b[2] + 0.12]
            mesh.add_ball(place, rng.uniform(0.06, 0.15, 3), draw_surface(rng, style, 0.3))


def hang_pictures(
    rng: np.random.Generator, mesh: Mesh, low: np.ndarray, high: np.ndarray, count: int
) -> None:
    """Hangs pictures on the walls of a room."""
    for number in range(count):
        side = int(rng.integers(4))
        wide, tall = rng.uniform(0.4, 1.4), rng.uniform(0.4, 1.1)
        axis, is_far = side // 2, side % 2
        along = rng.uniform(low[1 - axis] + 0.1, max(low[1 - axis] + 0.2, high[1 - axis] - wide))
        corner = np.zeros(3)
        corner[axis] = high[axis] - 0.02 if is_far else low[axis] + 0.02
        corner[1 - axis] = along
        corner[2] = low[2] + rng.uniform(1.0, 1.5)
        edge = np.zeros(3)
        edge[1 - axis] = wide
        mesh.add_quad(corner, edge, (0, 0, tall), draw_picture(rng))
        if number % _GLAZED == 0:
            before = corner.copy()
            before[axis] += -0.02 if is_far else 0.02
            mesh.add_quad(before, edge, (0, 0, tall), Material((0.95, 0.95, 0.95), glass=True))


def build_hall(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a furnished room with a table in its middle."""
    x, y, z = rng.uniform([5.0, 4.5, 2.6], [10.0, 8.0, 4.2])
    low, high = np.array([-x / 2, -y / 2, 0.0]), np.array([x / 2, y / 2, z])
    mesh = Mesh()
    walls = [draw_surface(rng, style) for _ in range(4)]
    if style.repeated:
        walls = walls[:1] * 4
    mesh.add_room(low, high, walls, draw_surface(rng, style), Material(draw_color(rng, 0.5, 0.8),
                  grain=0.03))  # fmt: skip
    table = draw_surface(rng, style)
    half = rng.uniform([0.4, 0.3], [1.0, 0.6])
    mesh.add_box([*-half, 0.70], [*half, 0.76], table, rng.uniform(0, math.pi))
    mesh.add_cylinder((0, 0, 0), 0.08, 0.70, table)
    for _ in range(rng.integers(2, 6)):
        place = [*rng.uniform(-0.7, 0.7, 2) * half, 0.86]
        mesh.add_ball(place, rng.uniform(0.06, 0.14, 3), draw_surface(rng, style, 0.3))
    furnish(rng, mesh, style, low, high, int(rng.integers(4, 12)))
    hang_pictures(rng, mesh, low, high, int(rng.integers(2, 10) * (1 - 0.8 * style.bare)))
    for lamp in range(rng.integers(1, 3)):
        mesh.add_lamp((x * (0.25 - 0.5 * lamp), 0, z - 0.5), (3.0, 2.6, 2.1), 0.12)
    radius = 0.5 * min(x, y) - 1.0
    return Stage(
        mesh,
        _INDOORS,
        (0, 0, 1.0),
        (radius, rng.uniform(0.2, 0.7)),
        ((-x / 2 + 1.2, -y / 4, 1.5), (x / 2 - 1.5, -y / 4, 1.5)),
        (0.9, 0.6, 1.5),
        rng.random() < 0.5,
        ("walk", "orbit", "straight", "turn", "photos"),
        reach=0.5 * x,
    )


def build_corridor(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a corridor of one texture with doors that are nearly alike."""
    length, width, z = rng.uniform([10.0, 1.6, 2.4], [25.0, 2.8, 3.0])
    mesh = Mesh()
    wall, floor = draw_surface(rng, style), draw_surface(rng, style)
    low, high = np.array([0.0, -width / 2, 0.0]), np.array([length, width / 2, z])
    mesh.add_room(low, high, [wall] * 4, floor, Material((0.7, 0.7, 0.7), grain=0.02))
    door = draw_picture(rng)
    for number, place in enumerate(np.arange(1.5, length - 1, rng.uniform(2.0, 3.5))):
        own = door if style.repeated else draw_picture(rng)
        for side in (-1, 1):
            if rng.random() < 0.7:
                at = (place, side * (width / 2 - 0.02), 0.0)
                mesh.add_quad(at, (0.9, 0, 0), (0, 0, 2.0), own)
        if number % 2 == 0:
            mesh.add_lamp((place, 0, z - 0.15), (1.2, 1.2, 1.1), 0.08)
    way = min(length - 2.0, rng.uniform(3.0, 9.0))
    return Stage(
        mesh,
        _INDOORS,
        (length / 2, 0, 1.3),
        (0.3 * width, 0.2),
        ((0.8, 0, 1.5), (0.8 + way, 0, 1.5)),
        (length / 3, 0, 1.5),
        False,
        ("straight", "walk", "turn", "photos"),
        lean=float(rng.choice([0.0, 0.0, 0.6])),
        reach=3.0,
    )


def build_rooms(rng: np.random.Generator, style: Style) -> Stage:
    """Builds rooms in a row, whose doors stand open; furnished alike or not."""
    count = int(rng.integers(2, 4))
    x, y, z = rng.uniform([3.0, 3.5, 2.4], [4.5, 5.5, 3.0])
    mesh = Mesh()
    shared = int(rng.integers(2**31))
    for number in range(count):
        own = np.random.default_rng(shared) if style.repeated else rng
        low = np.array([number * x, -y / 2, 0.0])
        high = np.add(low, (x, y, z))
        walls = [draw_surface(own, style) for _ in range(4)]
        floor = draw_surface(own, style)
        mesh.add_quad(low, (x, 0, 0), (0, y, 0), floor)
        mesh.add_quad([low[0], low[1], z], (x, 0, 0), (0, y, 0), Material((0.7, 0.7, 0.7)))
        mesh.add_quad([low[0], y / 2, 0], (x, 0, 0), (0, 0, z), walls[0])
        mesh.add_quad([high[0], -y / 2, 0], (-x, 0, 0), (0, 0, z), walls[1])
        for end, wall in ((low[0] + 0.01, walls[2]), (high[0] - 0.01, walls[3])):
            is_outer = end < 0.1 or end > count * x - 0.1
            for side in (-1, 1):
                inner = 0.0 if is_outer else 0.5
                mesh.add_quad(
                    (end, side * inner, 0), (0, side * (y / 2 - inner), 0), (0, 0, z), wall
                )
            if not is_outer:
                mesh.add_quad((end, -0.5, 2.1), (0, 1.0, 0), (0, 0, z - 2.1), wall)
        furnish(own, mesh, style, np.add(low, (0.1, 0, 0)), np.array([high[0] - 0.1, -0.7, z]), 3)
        furnish(own, mesh, style, np.array([low[0] + 0.1, 0.7, 0]), high - [0.1, 0, 0], 3)
        mesh.add_lamp((low[0] + x / 2, 0, z - 0.4), (2.2, 2.0, 1.7), 0.1)
    return Stage(
        mesh, _INDOORS, (x / 2, 0, 1.2), (0.25 * min(x, y), 0.3),
        ((0.6, 0, 1.5), (count * x - 0.8, 0, 1.5)), (x, 0, 1.5), False,
        ("walk", "straight", "turn", "photos"), lean=0.3, reach=2.5,
    )  # fmt: skip


def build_staircase(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a staircase between two walls."""
    steps, width = int(rng.integers(10, 20)), rng.uniform(1.6, 3.0)
    deep, tall = 0.29, 0.17
    mesh, stone = Mesh(), draw_surface(rng, style)
    length = steps * deep + 4.0
    mesh.add_room((0, -width / 2, 0), (length, width / 2, steps * tall + 3.0),
                  [draw_surface(rng, style) for _ in range(4)], draw_surface(rng, style),
                  Material((0.6, 0.6, 0.6), grain=0.05))  # fmt: skip
    for number in range(steps):
        start = 2.0 + number * deep
        mesh.add_box((start, -width / 2, 0), (length, width / 2, (number + 1) * tall), stone)
    for post in range(0, steps, 2):
        mesh.add_cylinder(
            (2.1 + post * deep, -0.3 * width, post * tall), 0.015, 1.0, stone, sides=8
        )
    mesh.add_lamp((2.0, 0, 2.8), (2.0, 1.9, 1.7), 0.1)
    mesh.add_lamp((length - 2.0, 0, steps * tall + 2.5), (2.0, 1.9, 1.7), 0.1)
    return Stage(
        mesh,
        _INDOORS,
        (length / 2, 0, 1.6),
        (0.3, 0.2),
        ((0.5, 0.1, 1.5), (2.0 + 0.6 * steps * deep, 0.1, 1.5 + 0.6 * steps * tall)),
        (1.0, 0, 1.6),
        False,
        ("straight", "walk", "photos"),
        reach=3.0,
    )
