"""Paints building materials: floor, bricks, panels, wallpaper, planks, wood, stone, leaves.

All return (h, w, 3) sRGB pictures at PIXELS_PER_METRE, row 0 at the top of the wall.
"""

from __future__ import annotations

import numpy as np

from lab.demo_tracer.texture import blend, make_noise

PIXELS_PER_METRE = 100  # finer than the demo's images resolve


def place_texels(width: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns x from the left and y from the bottom, in metres, of every texel of a surface."""
    columns, rows = (round(length * PIXELS_PER_METRE) for length in (width, height))
    x = (np.arange(columns) + 0.5) / PIXELS_PER_METRE
    y = (np.arange(rows)[::-1] + 0.5) / PIXELS_PER_METRE
    return np.broadcast_to(x, (rows, columns)), np.broadcast_to(y[:, None], (rows, columns))


def _fill(shape: tuple[int, ...], color: tuple[float, float, float]) -> np.ndarray:
    return np.broadcast_to(np.asarray(color), (*shape, 3)).copy()


def _mark_lines(position: np.ndarray, period: float, width: float) -> np.ndarray:
    """Returns 1 within width/2 of multiples of the period, with soft borders of a texel."""
    away = np.abs((position + period / 2) % period - period / 2)
    return np.clip((width / 2 - away) * PIXELS_PER_METRE + 0.5, 0.0, 1.0)


def _mark_band(position: np.ndarray, low: float, high: float) -> np.ndarray:
    """Returns 1 in [low, high], with soft borders of a texel."""
    inside = np.minimum(position - low, high - position)
    return np.clip(inside * PIXELS_PER_METRE + 0.5, 0.0, 1.0)


def paint_floor(rng: np.random.Generator, width: float, depth: float) -> np.ndarray:
    """Paints checkered tiles with veins, a dark frieze along the walls, a carpet in the middle."""
    x, y = place_texels(width, depth)
    tile = 0.5
    column, row = np.floor(x / tile).astype(int), np.floor(y / tile).astype(int)
    light = ((column + row) % 2)[..., None]
    color = np.where(light, (0.86, 0.80, 0.69), (0.40, 0.46, 0.45))
    color = color * (1 + 0.16 * (rng.random((40, 40))[row, column] - 0.5)[..., None])
    veins = np.abs(make_noise(rng, x.shape, cell=90, octaves=4) - 0.5)
    color = blend(color, color * 0.72, np.clip(1 - veins / 0.03, 0, 1))
    color = color * (0.9 + 0.2 * make_noise(rng, x.shape, cell=12)[..., None])
    joint = np.maximum(_mark_lines(x, tile, 0.018), _mark_lines(y, tile, 0.018))
    color = blend(color, (0.30, 0.27, 0.24), 0.8 * joint)
    to_wall = np.minimum(np.minimum(x, width - x), np.minimum(y, depth - y))
    color = blend(color, (0.36, 0.16, 0.13), 0.85 * _mark_band(to_wall, 0.25, 0.45))
    color = blend(color, (0.83, 0.66, 0.36), 0.8 * _mark_lines(to_wall - 0.35, 10.0, 0.04))
    return _paint_carpet(rng, color, x - width / 2, y - depth / 2)


def _paint_carpet(rng: np.random.Generator, color: np.ndarray, x: np.ndarray, y: np.ndarray):
    half_x, half_y = 1.75, 1.15
    to_rim = np.minimum(half_x - np.abs(x), half_y - np.abs(y))
    inside = np.clip(to_rim * PIXELS_PER_METRE, 0, 1)
    weave = 0.9 + 0.2 * make_noise(rng, x.shape, cell=5, octaves=2)[..., None]
    carpet = _fill(x.shape, (0.56, 0.10, 0.12))
    lattice = np.abs((x / 0.35 + y / 0.35) % 1 - 0.5) + np.abs((x / 0.35 - y / 0.35) % 1 - 0.5)
    carpet = blend(carpet, (0.78, 0.52, 0.24), 9 * (0.22 - lattice))
    carpet = blend(carpet, (0.20, 0.22, 0.42), 9 * (lattice - 0.80))
    medallion = np.hypot(x / 0.75, y / 0.52)
    petals = medallion * (1 + 0.12 * np.cos(8 * np.arctan2(y / 0.52, x / 0.75)))
    for limit, paint in ((1.0, (0.87, 0.74, 0.50)), (0.9, (0.13, 0.19, 0.38)),
                         (0.62, (0.80, 0.58, 0.27)), (0.5, (0.60, 0.13, 0.13)),
                         (0.2, (0.88, 0.78, 0.58))):  # fmt: skip
        carpet = blend(carpet, paint, (limit - petals) * 40)
    carpet = blend(carpet, (0.13, 0.17, 0.35), _mark_band(to_rim, 0.06, 0.26))
    flowers = np.cos(x * 2 * np.pi / 0.25) * np.cos(y * 2 * np.pi / 0.25)
    carpet = blend(carpet, (0.85, 0.68, 0.40), _mark_band(to_rim, 0.09, 0.23) * (flowers * 4 - 1))
    for line in (0.06, 0.26):
        carpet = blend(carpet, (0.85, 0.70, 0.42), _mark_lines(to_rim - line, 10.0, 0.03))
    return blend(color, carpet * weave, inside)


def paint_bricks(rng: np.random.Generator, width: float, height: float) -> np.ndarray:
    """Paints bricks in running bond above a stone plinth."""
    x, y = place_texels(width, height)
    brick_x, brick_y = 0.36, 0.13
    row = np.floor(y / brick_y).astype(int)
    shifted = x + (row % 2) * brick_x / 2
    column = np.floor(shifted / brick_x).astype(int)
    pick = rng.random((64, 64))[row % 64, column % 64][..., None]
    color = np.asarray((0.50, 0.24, 0.18)) * (1 - pick) + np.asarray((0.78, 0.46, 0.32)) * pick
    color = color * (0.86 + 0.28 * make_noise(rng, x.shape, cell=10)[..., None])
    mortar = np.maximum(_mark_lines(shifted, brick_x, 0.022), _mark_lines(y, brick_y, 0.022))
    color = blend(color, (0.76, 0.71, 0.63), 0.9 * mortar)
    color = color * (0.86 + 0.28 * make_noise(rng, x.shape, cell=120)[..., None])
    plinth = np.asarray((0.60, 0.57, 0.52)) * (
        0.85 + 0.3 * make_noise(rng, x.shape, cell=30)[..., None]
    )
    plinth = blend(plinth, plinth * 0.6, _mark_lines(x, 0.9, 0.02))
    color = blend(color, plinth, _mark_band(y, -1.0, 0.42))
    return blend(color, (0.42, 0.39, 0.35), _mark_lines(y - 0.42, 20.0, 0.03))


def paint_panels(rng: np.random.Generator, width: float, height: float, paper) -> np.ndarray:
    """Paints wooden panels to hip height and, above, damask wallpaper of the given colour."""
    x, y = place_texels(width, height)
    color = np.asarray(paper) * (0.93 + 0.14 * make_noise(rng, x.shape, cell=60)[..., None])
    cell = 0.6
    row = np.floor(y / cell)
    u = (x + (row % 2) * cell / 2) % cell / cell - 0.5
    v = y % cell / cell - 0.5
    angle, radius = np.arctan2(v, u), np.hypot(u, 0.8 * v)
    ornament = 0.30 + 0.10 * np.cos(6 * angle) - radius
    color = blend(color, np.asarray(paper) * 1.22 + 0.05, np.clip(ornament * 25, 0, 1) * 0.8)
    color = blend(color, np.asarray(paper) * 0.72, np.clip((0.12 - radius) * 25, 0, 1) * 0.8)
    wood = paint_planks(rng, x, y, 0.24, (0.45, 0.28, 0.17), vertical=True)
    panel = 0.75
    u, v = np.abs(x % panel - panel / 2), np.abs(y - 0.58)
    to_frame = np.maximum(u - 0.28, v - 0.36)
    wood = blend(wood, wood * 1.35, _mark_band(to_frame, -0.05, 0.0))
    wood = blend(wood, wood * 0.5, _mark_lines(to_frame, 10.0, 0.025))
    color = blend(color, wood, _mark_band(y, -1.0, 1.12))
    color = blend(color, (0.34, 0.20, 0.12), _mark_band(y, 1.10, 1.20))
    return blend(color, (0.66, 0.46, 0.28), _mark_lines(y - 1.19, 20.0, 0.02))


def paint_plaster(rng: np.random.Generator, width: float, height: float, paint) -> np.ndarray:
    """Paints plaster with a skirting and a stencilled frieze under the ceiling."""
    x, y = place_texels(width, height)
    color = np.asarray(paint) * (
        0.88 + 0.24 * make_noise(rng, x.shape, cell=90, octaves=5)[..., None]
    )
    color = blend(color, np.asarray((0.50, 0.24, 0.17)), _mark_band(y, -1.0, 0.35))
    color = blend(color, (0.80, 0.62, 0.36), _mark_lines(y - 0.36, 20.0, 0.04))
    top = height - 0.30
    color = blend(color, np.asarray((0.32, 0.40, 0.36)), _mark_band(y, top - 0.22, top + 0.16))
    wave = y - top + 0.03 - 0.09 * np.sin(x * 2 * np.pi / 0.6)
    color = blend(color, (0.88, 0.74, 0.44), np.clip((0.035 - np.abs(wave)) * 60, 0, 1))
    return color


def paint_planks(rng: np.random.Generator, x, y, board: float, color, vertical: bool = False):
    """Paints boards with grain over a grid of x and y in metres, running along x (or y)."""
    along, across = (y, x) if vertical else (x, y)
    number = np.floor(across / board).astype(int) % 64
    shade = 0.8 + 0.4 * rng.random(64)[number]
    phase = rng.random(64)[number] * 10
    wobble = make_noise(rng, x.shape, cell=40)
    grain = np.sin(2 * np.pi * (across / 0.035 + 3.0 * wobble + phase + 0.3 * along))
    wood = np.asarray(color) * (shade * (1 + 0.14 * grain))[..., None]
    return blend(wood, wood * 0.35, _mark_lines(across, board, 0.014))


def paint_wood(
    rng: np.random.Generator, color, size: float = 2.0, board: float = 0.2
) -> np.ndarray:
    """Paints a square of boards, for furniture and beams."""
    return paint_planks(rng, *place_texels(size, size), board, color)


def paint_stone(rng: np.random.Generator, color, size: float = 1.0) -> np.ndarray:
    """Paints a square of veined stone."""
    x, _ = place_texels(size, size)
    base = np.asarray(color) * (0.8 + 0.4 * make_noise(rng, x.shape, cell=30, octaves=4)[..., None])
    veins = np.abs(make_noise(rng, x.shape, cell=45, octaves=4) - 0.5)
    return blend(base, base * 0.6, np.clip(1 - veins / 0.025, 0, 1))


def paint_flutes(rng: np.random.Generator, color, flutes: int = 12) -> np.ndarray:
    """Paints the mantle of a column: 1 unit around, 1 metre high, with shaded flutes."""
    base = paint_stone(rng, color)
    angle = (np.arange(base.shape[1]) + 0.5) / base.shape[1]
    return base * (0.82 + 0.18 * np.cos(2 * np.pi * flutes * angle))[None, :, None]


def paint_leaves(rng: np.random.Generator) -> np.ndarray:
    """Paints dense foliage around a ball."""
    pick = make_noise(rng, (128, 256), cell=11, octaves=2)
    pick = np.clip((pick - 0.5) * 2.4 + 0.5, 0, 1)[..., None]
    color = np.asarray((0.07, 0.20, 0.07)) * (1 - pick) + np.asarray((0.45, 0.66, 0.22)) * pick
    berries = make_noise(rng, (128, 256), cell=5, octaves=1) > 0.86
    return blend(color, (0.85, 0.25, 0.20), berries.astype(float))
