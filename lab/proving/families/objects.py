"""Scenes about one thing: an object walked around, a facade, a plane and nothing else."""

from __future__ import annotations

import math

import numpy as np

from lab.proving.paints import (
    Style,
    draw_color,
    draw_ground,
    draw_leaves,
    draw_picture,
    draw_surface,
    draw_window_front,
)
from lab.proving.stage import Stage
from lab.proving.world import Material, Mesh, Sky, turn_about_z


def draw_day(rng: np.random.Generator, strength: float = 1.0) -> Sky:
    """Draws a sky: blue with clouds and sun, or overcast of one colour."""
    if rng.random() < 0.35:
        grey = rng.uniform(0.7, 0.95)
        return Sky(zenith=(grey,) * 3, horizon=(grey,) * 3, ambient=(0.8 * strength,) * 3,
                   sky_share=0.6, reach=8.0)  # fmt: skip
    high, around = rng.uniform(0.3, 1.2), rng.uniform(0, 2 * math.pi)
    toward = (math.cos(around) * math.cos(high), math.sin(around) * math.cos(high), math.sin(high))
    return Sky(
        toward,
        np.array([1.5, 1.4, 1.2]) * strength,
        ambient=np.array([0.5, 0.55, 0.65]) * strength,
        sky_share=0.5,
        clouds=float(rng.choice([0.0, 0.4, 0.6])),
        reach=8.0,
        seed=int(rng.integers(1000)),
    )


def build_object(rng: np.random.Generator, style: Style) -> Stage:
    """Builds a thing on a table or on the ground, with something or nothing behind it."""
    scale = float(np.exp(rng.uniform(math.log(0.2), math.log(3.0))))
    mesh = Mesh()
    profile = [(0.3, 0.0)]
    for height in np.linspace(0.15, 1.2, 7):
        profile.append((rng.uniform(0.15, 0.5), float(height)))
    profile.append((0.0, 1.25))
    body = draw_surface(rng, style, 0.6 * scale)
    mesh.add_lathe((0, 0, 0), [(scale * r, scale * h) for r, h in profile], body, 32)
    for _ in range(rng.integers(2, 7)):
        angle, away = rng.uniform(0, 2 * math.pi), rng.uniform(0.55, 0.9) * scale
        place = [away * math.cos(angle), away * math.sin(angle), 0.15 * scale]
        half = scale * rng.uniform(0.06, 0.18, 3)
        if rng.random() < 0.5:
            place[2] = half[2]
            mesh.add_box(np.array(place) - half, np.array(place) + half,
                         draw_surface(rng, style, 0.4 * scale), angle)  # fmt: skip
        else:
            mesh.add_ball(place, half, draw_surface(rng, style, 0.4 * scale))
    ground = draw_surface(rng, style, scale) if rng.random() < 0.7 else Material(draw_color(rng))
    size = 6.0 * scale
    mesh.add_quad((-size, -size, 0), (2 * size, 0, 0), (0, 2 * size, 0), ground)
    if rng.random() < 0.6:  # surroundings
        for _ in range(rng.integers(5, 15)):
            angle, away = rng.uniform(0, 2 * math.pi), rng.uniform(3.5, 5.5) * scale
            low = np.array([away * math.cos(angle), away * math.sin(angle), 0.0])
            half = scale * rng.uniform(0.2, 0.9, 3)
            mesh.add_box(low - [half[0], half[1], 0], low + half * [1, 1, 2.5],
                         draw_surface(rng, style, scale), angle)  # fmt: skip
    radius = rng.uniform(1.6, 2.6) * scale
    return Stage(
        mesh, draw_day(rng), (0, 0, 0.5 * scale), (radius, rng.uniform(0.2, 1.2) * scale),
        ((-radius, -1.7 * scale, 0.7 * scale), (radius, -1.7 * scale, 0.7 * scale)),
        (radius, 0, scale), True, ("orbit", "photos", "walk"), lean=math.pi / 2, tilt=-0.2,
        reach=radius,
    )  # fmt: skip


def build_facade(rng: np.random.Generator, style: Style) -> Stage:
    """Builds the front of a house with things before it."""
    columns, rows = int(rng.integers(4, 9)), int(rng.integers(2, 5))
    width, height = 2.6 * columns, 3.2 * rows
    mesh = Mesh()
    alike = 1.0 if style.repeated else rng.uniform(0.0, 0.9)
    front = draw_window_front(rng, columns, rows, alike)
    mesh.add_box((-width / 2, 0, 0), (width / 2, 8, height), front)
    for column in range(columns):
        if rng.random() < 0.5:
            at = -width / 2 + (column + 0.2) * width / columns
            floor = int(rng.integers(1, max(2, rows)))
            mesh.add_box((at, -1.0, 3.2 * floor), (at + 1.6, 0, 3.2 * floor + 0.9),
                         draw_surface(rng, style))  # fmt: skip
    mesh.add_quad((-60, -60, 0), (120, 0, 0), (0, 120, 0), draw_ground(rng, 4.0))
    for _ in range(rng.integers(0, 8)):
        x, y = rng.uniform([-width, -8], [width, -2])
        add_tree(rng, mesh, (x, y), rng.uniform(2.0, 6.0), draw_leaves(rng))
    away = rng.uniform(8.0, 16.0)
    return Stage(
        mesh, draw_day(rng), (0, 0, 0.4 * height), (away, 1.6 - 0.4 * height),
        ((-0.4 * width, -away, 1.6), (0.4 * width, -away, 1.6)), (0, -away, 1.6), True,
        ("photos", "straight", "walk", "turn"), lean=math.pi / 2, tilt=0.12, reach=away,
    )  # fmt: skip


def build_plane(rng: np.random.Generator, style: Style) -> Stage:
    """Builds one plane that fills the view: a wall with pictures, or a field from above."""
    mesh = Mesh()
    width, height = 16.0, 9.0
    mesh.add_quad((-width / 2, 0, -height / 2), (width, 0, 0), (0, 0, height),
                  draw_surface(rng, Style(0.0, 0.0, 0.3)))  # fmt: skip
    for number in range(rng.integers(6, 25)):
        x, z = rng.uniform([-6, -3], [6, 3])
        size = rng.uniform(0.4, 1.3)
        before = -0.002 * (1 + number)  # of two that overlap, one hangs in front
        mesh.add_quad((x, before, z), (1.3 * size, 0, 0), (0, 0, size), draw_picture(rng))
    return Stage(
        mesh,
        Sky(ambient=(0.8, 0.8, 0.8)),
        (0, 0, 0),
        (2.5, 0.0),
        ((-2.5, -2.6, 0), (2.5, -2.6, 0.3)),
        (0, -2.5, 0),
        True,
        ("straight", "photos", "turn"),
        lean=math.pi / 2,
        tilt=0.0,
        reach=2.5,
    )


def add_tree(
    rng: np.random.Generator, mesh: Mesh, place: tuple[float, float], tall: float, leaves: Material,
    ground: float = 0.0,
) -> None:  # fmt: skip
    """Adds a trunk and cards of leaves."""
    bark = Material((0.16, 0.11, 0.07), grain=0.4, grain_size=0.3)
    foot = (*place, ground)
    mesh.add_cylinder(foot, 0.04 * tall, 0.6 * tall, bark, sides=8, top_radius=0.02 * tall)
    for _ in range(28):
        offset = rng.normal(0, 1, 3)
        offset *= rng.uniform(0.3, 1.0) * 0.32 * tall / np.linalg.norm(offset)
        middle = np.add(foot, (0, 0, 0.68 * tall)) + offset
        turned = turn_about_z(rng.uniform(0, math.pi))
        edge = turned[:, 0] * 0.34 * tall
        lean = (turned[:, 1] * rng.normal(0, 0.5) + [0, 0, 1]) * 0.34 * tall
        mesh.add_quad(middle - edge / 2 - lean / 2, edge, lean, leaves)
