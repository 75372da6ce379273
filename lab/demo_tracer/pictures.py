"""Paints pictures: stained glass, paintings, book spines, a globe, decorated pots and balls.

All return (h, w, 3) sRGB pictures, row 0 at the top.
"""

from __future__ import annotations

import numpy as np

from lab.demo_tracer.texture import blend, make_noise

_JEWELS = np.array(
    [(0.85, 0.13, 0.12), (0.12, 0.30, 0.80), (0.95, 0.72, 0.15), (0.10, 0.58, 0.36),
     (0.90, 0.45, 0.12), (0.42, 0.18, 0.62), (0.40, 0.75, 0.90), (0.96, 0.88, 0.62)]
)  # fmt: skip


def _place_texels(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns x to the right and y up, both in 0..1."""
    x = (np.arange(width) + 0.5) / width
    y = 1 - (np.arange(height) + 0.5) / height
    return np.broadcast_to(x, (height, width)), np.broadcast_to(y[:, None], (height, width))


def paint_stained_glass(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Paints a window twice as high as wide: rosette above lattice; 0 outside the arch."""
    x, y = _place_texels(height, width)
    u, v = x - 0.5, (y - 0.75) * (height / width)  # in window widths from the arch's centre
    radius, angle = np.hypot(u, v), np.arctan2(v, u) / (2 * np.pi) + 0.5
    # Lattice of diamonds below.
    a, b = x / 0.25 + y * height / width / 0.25, x / 0.25 - y * height / width / 0.25
    pick = rng.integers(0, len(_JEWELS), (64, 64))
    color = _JEWELS[pick[np.floor(a).astype(int) % 64, np.floor(b).astype(int) % 64]]
    lead = np.minimum(np.minimum(a % 1, 1 - a % 1), np.minimum(b % 1, 1 - b % 1)) * 0.18
    # Rings of petals above.
    for inner, outer, petals in ((0.0, 0.09, 1), (0.09, 0.24, 8), (0.24, 0.40, 12)):
        ring = (radius >= inner) & (radius < outer)
        sector = np.floor(angle * petals).astype(int) % petals
        wheel = _JEWELS[rng.permutation(len(_JEWELS))]
        color = np.where(ring[..., None], wheel[(sector + petals // 4) % len(wheel)], color)
        off = np.abs(angle * petals - np.round(angle * petals)) / petals * 2 * np.pi * radius
        edge = np.minimum(np.abs(radius - inner), np.abs(radius - outer))
        lead = np.where(ring, np.minimum(edge, off if petals > 1 else edge), lead)
    color = color * (0.8 + 0.4 * make_noise(rng, (height, width), cell=14)[..., None])
    color = blend((0.05, 0.05, 0.06), color, (lead - 0.010) * 90)
    rim = np.where(v > 0, 0.5 - radius, 0.5 - np.abs(u))
    rim = np.minimum(rim, y * height / width)
    color = blend((0.05, 0.05, 0.06), color, (rim - 0.03) * 60)
    return np.where((rim > 0)[..., None], color, 0.0)


def paint_landscape(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Paints an evening sky, the sun, three ranges of hills and a lake."""
    x, y = _place_texels(height, width)
    color = blend(np.asarray((0.98, 0.72, 0.42)), np.asarray((0.30, 0.45, 0.72)), (y - 0.35) * 1.8)
    color = blend(
        color, (1.0, 0.93, 0.70), (0.09 - np.hypot((x - 0.66) * width / height, y - 0.62)) * 40
    )
    for level, paint in ((0.52, (0.42, 0.40, 0.55)), (0.42, (0.28, 0.36, 0.40)),
                         (0.30, (0.18, 0.27, 0.17))):  # fmt: skip
        ridge = level + 0.22 * (make_noise(rng, (8, width), cell=width / 3)[3] - 0.5)
        color = blend(color, paint, (ridge[None, :] - y) * height * 0.5)
    ripples = 0.5 + 0.5 * np.sin(y * 180 + 4 * make_noise(rng, (height, width), cell=20))
    return blend(color, blend(np.asarray((0.22, 0.36, 0.52)), (0.92, 0.74, 0.52), ripples * 0.5),
                 (0.16 - y) * height * 0.5)  # fmt: skip


def paint_circles(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Paints concentric discs in squares."""
    x, y = _place_texels(height, width)
    columns, rows = max(2, round(4 * width / height)), 4
    u, v = x * columns, y * rows
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    radius = np.hypot(u % 1 - 0.5, v % 1 - 0.5)
    color = _JEWELS[rng.integers(0, len(_JEWELS), (rows, columns))[row, column]]
    for limit in (0.46, 0.33, 0.18):
        paint = _JEWELS[rng.integers(0, len(_JEWELS), (rows, columns))[row, column]]
        color = blend(color, paint, (limit - radius) * 25)
    return color


def paint_rectangles(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Paints a white canvas cut by black bars into fields, some of them red, blue or yellow."""
    x, y = _place_texels(height, width)
    cuts_x = np.sort(np.concatenate([[0, 1], rng.uniform(0.12, 0.9, 4)]))
    cuts_y = np.sort(np.concatenate([[0, 1], rng.uniform(0.12, 0.9, 3)]))
    paints = np.array([(0.94, 0.93, 0.88), (0.94, 0.93, 0.88), (0.80, 0.10, 0.10),
                       (0.10, 0.22, 0.62), (0.96, 0.80, 0.15)])  # fmt: skip
    field = rng.integers(0, len(paints), (6, 6))
    column, row = np.searchsorted(cuts_x, x) - 1, np.searchsorted(cuts_y, y) - 1
    color = paints[field[row, column]]
    for cut in cuts_x[1:-1]:
        color = blend(color, (0.06, 0.06, 0.06), (0.018 - np.abs(x - cut)) * 200)
    for cut in cuts_y[1:-1]:
        color = blend(color, (0.06, 0.06, 0.06), (0.022 - np.abs(y - cut)) * 200)
    return color


def paint_night(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Paints a swirling night sky with stars over a dark hill."""
    x, y = _place_texels(height, width)
    flow = make_noise(rng, (height, width), cell=height / 2.5, octaves=2)
    bands = 0.5 + 0.5 * np.sin(40 * flow + 8 * y)
    color = blend(np.asarray((0.07, 0.13, 0.38)), (0.35, 0.55, 0.80), bands * 0.8)
    aspect = width / height
    for _ in range(7):
        star = np.hypot((x - rng.uniform(0.05, 0.95)) * aspect, y - rng.uniform(0.45, 0.95))
        glow = rng.uniform(0.05, 0.09)
        color = blend(color, (0.98, 0.88, 0.45), np.exp(-((star / glow) ** 2)))
    hill = 0.25 + 0.2 * (make_noise(rng, (8, width), cell=width / 3)[3] - 0.5)
    return blend(color, (0.06, 0.10, 0.12), (hill[None, :] - y) * height * 0.5)


def paint_framed(rng: np.random.Generator, kind, height: int, width: int) -> np.ndarray:
    """Paints a picture by one of the painters above, with a gilt frame and a mount."""
    x, y = _place_texels(height, width)
    rim = np.minimum(np.minimum(x, 1 - x) * width, np.minimum(y, 1 - y) * height)
    color = blend(kind(rng, height, width), (0.90, 0.87, 0.78), (14 - rim) * 0.5)
    gilt = np.asarray((0.70, 0.52, 0.22)) * (0.8 + 0.35 * np.cos(rim * 2 * np.pi / 9))[..., None]
    return blend(color, gilt, (9 - rim) * 0.7)


def paint_bookcase(
    rng: np.random.Generator, height: int, width: int, shelves: int = 5
) -> np.ndarray:
    """Paints shelves of books of many colours and heights in a wooden case; 100 px a metre."""
    color = np.broadcast_to(np.asarray((0.07, 0.05, 0.04)), (height, width, 3)).copy()
    case = np.asarray((0.36, 0.22, 0.13))
    board, side = 4, 5
    shelf = (height - board) / shelves
    for number in range(shelves):
        bottom = height - board - round(number * shelf)
        room = round(shelf) - board
        column = side
        while column < width - side:
            thick = int(rng.integers(4, 11))
            if rng.random() < 0.06:  # a gap
                column += 2 * thick
                continue
            tall = round(room * rng.uniform(0.62, 0.95))
            paint = _JEWELS[rng.integers(len(_JEWELS))] * rng.uniform(0.35, 0.8) + 0.05
            spine = color[bottom - tall : bottom, column : min(column + thick, width - side)]
            across = np.linspace(-1, 1, thick)[: spine.shape[1]]
            spine[:] = paint * (1.05 - 0.45 * across**2)[None, :, None]
            for place in (0.15, 0.22, 0.8):
                spine[round(place * tall)] = (0.85, 0.72, 0.40)
            column += thick
        color[bottom : bottom + board] = case
    for side_of in (slice(0, side), slice(width - side, width)):
        color[:, side_of] = case
    color[:board] = case
    return color


def paint_globe(rng: np.random.Generator) -> np.ndarray:
    """Paints longitude by latitude: oceans, land, ice and a net of degrees."""
    x, y = _place_texels(128, 256)
    land = make_noise(rng, (128, 256), cell=48, octaves=5)
    land[:, 246:] += (land[:, :1] - land[:, 245:246]) * np.linspace(0, 1, 10)  # closes the seam
    color = blend(np.asarray((0.10, 0.30, 0.55)), (0.20, 0.45, 0.65), (land - 0.3) * 4)
    color = blend(color, (0.85, 0.76, 0.50), (land - 0.52) * 60)
    color = blend(color, (0.38, 0.52, 0.22), (land - 0.56) * 30)
    color = blend(color, (0.55, 0.38, 0.22), (land - 0.66) * 30)
    color = blend(color, (0.95, 0.96, 0.97), (np.abs(y - 0.5) - 0.42) * 60)
    meridian = np.abs((x * 12) % 1 - 0.5) > 0.47
    parallel = np.abs((y * 6) % 1 - 0.5) > 0.47
    return blend(color, (0.92, 0.86, 0.66), 0.6 * (meridian | parallel))


def paint_stripes(rng: np.random.Generator) -> np.ndarray:
    """Paints swirling stripes around a ball."""
    x, y = _place_texels(128, 256)
    phase = np.floor((x + 0.35 * y) * 10).astype(int) % len(_JEWELS)
    return _JEWELS[rng.permutation(len(_JEWELS))][phase]


def paint_marble(rng: np.random.Generator) -> np.ndarray:
    """Paints white marble with grey-green swirls around a ball."""
    flow = make_noise(rng, (128, 256), cell=70, octaves=4)
    bands = 0.5 + 0.5 * np.sin(34 * flow)
    return blend(np.asarray((0.93, 0.91, 0.87)), (0.35, 0.42, 0.42), bands**3)


def paint_zigzags(rng: np.random.Generator) -> np.ndarray:
    """Paints terracotta with zigzags: 1 unit around, 1 unit high."""
    x, y = _place_texels(100, 200)
    color = np.asarray((0.72, 0.36, 0.22)) * (
        0.85 + 0.3 * make_noise(rng, (100, 200), cell=12)[..., None]
    )
    wave = np.abs((x * 8) % 1 - 0.5) * 0.3
    for level, paint in ((0.30, (0.95, 0.88, 0.72)), (0.50, (0.16, 0.28, 0.40)),
                         (0.70, (0.95, 0.88, 0.72))):  # fmt: skip
        color = blend(color, paint, (0.05 - np.abs(y - level - wave + 0.075)) * 60)
    return color
