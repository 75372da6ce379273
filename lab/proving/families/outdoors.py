"""Scenes under the sky: street, square with trees, terrain from the air, street at night."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lab.demo_tracer.texture import make_noise
from lab.proving.families.objects import add_tree, draw_day
from lab.proving.paints import (
    Style,
    draw_color,
    draw_fence,
    draw_ground,
    draw_leaves,
    draw_picture,
    draw_surface,
    draw_window_front,
)
from lab.proving.stage import Stage
from lab.proving.world import MOVER, Material, Mesh, Sky


def build_street(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a street between two rows of houses, with cars and perhaps walkers."""
    width = rng.uniform(8.0, 16.0)
    mesh = Mesh()
    ground = draw_ground(rng, 3.0)
    mesh.add_quad((-40, -60, 0), (160, 0, 0), (0, 120, 0), ground)
    front = draw_window_front(rng, 4, 4, 1.0)
    for side in (-1, 1):
        start = -20.0
        while start < 60:
            long, tall = rng.uniform(8, 16), rng.uniform(7, 18)
            alike = rng.uniform(0.2, 0.9)
            own = (
                front
                if style.repeated
                else draw_window_front(rng, int(long / 2.6), int(tall / 3.2), alike)
            )
            back = side * (width / 2 + 10)
            low = (start, min(side * width / 2, back), 0.0)
            mesh.add_box(low, (start + long, max(side * width / 2, back), tall), own)
            if rng.random() < 0.6:
                at = (start + 0.3 * long, side * (width / 2 - 0.03), 2.2)
                mesh.add_quad(at, (2.5, 0, 0), (0, 0, 0.8), draw_picture(rng))
            start += long + (0.0 if rng.random() < 0.7 else 3.0)
    _park_cars(rng, mesh, style, width)
    movers = _make_walkers(rng, width) if rng.random() < 0.4 else None
    way = rng.uniform(4.0, 15.0)
    return Stage(
        mesh, draw_day(rng), (5, 0, 2.0), (0.25 * width, 0.0), ((0, -0.15 * width, 1.6),
        (way, -0.15 * width, 1.6)), (4, 0, 1.6), False, ("straight", "walk", "turn", "photos"),
        lean=float(rng.choice([0.0, 0.5, math.pi / 2])), tilt=0.08, reach=width, movers=movers,
    )  # fmt: skip


def _park_cars(rng: np.random.Generator, mesh: Mesh, style: Style, width: float) -> None:
    for x in np.arange(-15, 40, 6.0):
        for side in (-1, 1):
            if rng.random() < 0.5:
                continue
            gloss = 0.05 if style.glossy > 0 else 0.0
            paint = Material(draw_color(rng, 0.05, 0.6), gloss=gloss, roughness=0.02)
            at = np.array([x + rng.uniform(0, 1.5), side * (width / 2 - 1.4), 0.0])
            mesh.add_box(np.add(at, (0, -0.85, 0.25)), np.add(at, (4.2, 0.85, 0.85)), paint)
            mesh.add_box(np.add(at, (0.9, -0.75, 0.85)), np.add(at, (3.3, 0.75, 1.4)),
                         Material((0.05, 0.06, 0.07), gloss=gloss))  # fmt: skip
            for wheel in (0.7, 3.4):
                mesh.add_ball(np.add(at, (wheel, -side * 0.85, 0.3)), (0.3, 0.1, 0.3),
                              Material((0.03, 0.03, 0.03)), rings=6)  # fmt: skip


def _make_walkers(rng: np.random.Generator, width: float):
    """Returns a function of time that builds people who walk along the street."""
    count = int(rng.integers(1, 4))
    starts = rng.uniform([2, -0.35 * width], [14, 0.35 * width], (count, 2))
    speeds = rng.choice([-1.3, -1.0, 1.0, 1.3], count)
    coats = [Material(draw_color(rng, 0.05, 0.5), grain=0.3, grain_size=0.2) for _ in range(count)]
    skin = Material((0.5, 0.33, 0.25))

    def build(time: float) -> Mesh:
        mesh = Mesh()
        for start, speed, coat in zip(starts, speeds, coats, strict=True):
            x, y = start[0] + speed * time, start[1]
            mesh.add_ball((x, y, 0.45), (0.16, 0.2, 0.45), coat, MOVER, rings=8)
            mesh.add_ball((x, y, 1.15), (0.18, 0.26, 0.35), coat, MOVER, rings=8)
            mesh.add_ball((x, y, 1.62), 0.13, skin, MOVER, rings=8)
        return mesh

    return build


def build_square(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a square with trees, benches, a fence and houses around."""
    mesh = Mesh()
    mesh.add_quad((-50, -50, 0), (100, 0, 0), (0, 100, 0), draw_ground(rng, 2.0))
    size = rng.uniform(12.0, 25.0)
    for angle in np.arange(0, 2 * math.pi, 0.7):
        if rng.random() < 0.8:
            at = np.array([size * math.cos(angle), size * math.sin(angle), 0.0])
            front = draw_window_front(rng, 4, 3, rng.uniform(0, 0.9))
            mesh.add_box(
                at - [5, 3, 0], np.add(at, (5, 3, rng.uniform(6, 12))), front, angle + math.pi / 2
            )
    leaves = [draw_leaves(rng) for _ in range(3)]
    for _ in range(rng.integers(4, 12)):
        place = rng.uniform(-0.6 * size, 0.6 * size, 2)
        if np.linalg.norm(place) > 5.0:
            add_tree(rng, mesh, tuple(place), rng.uniform(3, 7), leaves[rng.integers(3)])
    stone = draw_surface(rng, style)
    mesh.add_lathe((0, 0, 0), [(1.6, 0), (1.6, 0.5), (0.5, 0.6), (0.4, 1.8), (0, 2.0)], stone)
    for angle in rng.uniform(0, 2 * math.pi, 4):
        at = np.array([3.0 * math.cos(angle), 3.0 * math.sin(angle), 0.0])
        mesh.add_box(
            at - [0.8, 0.2, 0], np.add(at, (0.8, 0.2, 0.45)), draw_surface(rng, style), angle
        )
    if rng.random() < 0.5:
        mesh.add_quad((-8, -6.5, 0), (16, 0, 0), (0, 0, 1.0), draw_fence(rng))
    return Stage(
        mesh,
        draw_day(rng),
        (0, 0, 1.2),
        (rng.uniform(3.8, 4.6), 0.4),
        ((-6, -4.5, 1.6), (6, -4.5, 1.6)),
        (4.2, 1.0, 1.6),
        rng.random() < 0.6,
        ("orbit", "walk", "straight", "turn", "photos"),
        lean=float(rng.choice([0.3, math.pi / 2])),
        tilt=0.03,
        reach=6.0,
        movers=_make_walkers(rng, 8.0) if rng.random() < 0.3 else None,
    )


def build_terrain(rng: np.random.Generator, style: Style) -> Stage:
    """Builds hills with houses and trees, seen from a drone."""
    mesh, half, cells = Mesh(), 120.0, 96
    steep = rng.uniform(0.0, 25.0)
    height = steep * make_noise(rng, (cells + 1, cells + 1), cell=40, octaves=4)
    axis = np.linspace(-half, half, cells + 1)
    x, y = np.meshgrid(axis, axis)
    grid = np.stack([x, y, height], axis=2)
    mesh.add_grid(grid, draw_ground(rng, 12.0, 0.3), np.zeros((cells + 1, cells + 1, 2)))

    def find_ground(place: np.ndarray) -> float:
        column, row = np.clip(np.rint((place + half) / (2 * half) * cells).astype(int), 0, cells)
        return float(height[row, column])

    for _ in range(rng.integers(3, 25)):
        place = rng.uniform(-70, 70, 2)
        low = np.array([*place, find_ground(place) - 1.0])
        size = rng.uniform([6, 6, 4], [16, 12, 10])
        roof = draw_surface(rng, style, 2.0)
        mesh.add_box(low, low + size, draw_window_front(rng, 3, 2, 0.5), rng.uniform(0, 3), roof)
    leaves = [draw_leaves(rng) for _ in range(3)]
    for _ in range(rng.integers(5, 50)):
        place = rng.uniform(-70, 70, 2)
        add_tree(rng, mesh, tuple(place), rng.uniform(3, 9), leaves[rng.integers(3)],
                 find_ground(place))  # fmt: skip
    up = rng.uniform(30.0, 70.0) + steep
    return Stage(
        mesh, draw_day(rng), (0, 0, 0.5 * steep), (rng.uniform(40, 70), up),
        ((-60, 0, up), (60, 0, up)), (0, 0, up), True, ("grid", "orbit", "straight"), lean=0.0,
        tilt=float(rng.choice([-1.57, -1.57, -1.2, -0.8])), reach=up,
    )  # fmt: skip


def build_night(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a street at night, lit by lamps."""
    day = build_street(rng, style)
    dark = Sky(zenith=(0.004, 0.005, 0.01), horizon=(0.02, 0.018, 0.02), ambient=(0.02, 0.02, 0.03))
    lamps = Mesh()
    for place in np.arange(-6, 36, rng.uniform(7, 14)):
        side = rng.choice([-1.0, 1.0]) * 3.0
        pole = Material((0.1, 0.1, 0.1))
        lamps.add_cylinder((place, side, 0), 0.06, 4.4, pole, sides=8)
        lamps.add_lamp((place, side, 4.6), (7.0, 5.5, 3.2), 0.15)
    return dataclasses.replace(day, mesh=day.mesh.combine(lamps), sky=dark)
