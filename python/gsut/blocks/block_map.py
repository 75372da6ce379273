"""Draws the map of blocks: Gaussians from above in a colour for each block, and the cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsut.data import Scene
from gsut.files import write_file
from gsut.gaussians import Gaussians
from gsut.page import Chart, Style

# Name of the picture in the folder of the blocks.
MAP = "map.svg"
# Gaussians that are drawn, evenly chosen: more would cover each other.
_DOTS = 20_000
# Percent of the Gaussians on each side that may lie beyond the map's edge.
_FARTHEST_PERCENT = 1.0
# Most blocks whose numbers are written: more would cover each other.
_MOST_NUMBERS = 100


def write_map(folder: Path, gaussians: Gaussians, owners: np.ndarray, scene: Scene) -> None:
    """Writes FOLDER/map.svg.

    Args:
        folder: exists.
        gaussians, owners: N Gaussians in the scene's coordinates and their blocks.
        scene: whose cameras are shown.
    """
    points = gaussians.means.astype(np.float64) + scene.world_offset
    centers = np.array([scene.views[i].camera_center for i in scene.train_indices])
    centers = centers + scene.world_offset
    low, high = np.percentile(points, (_FARTHEST_PERCENT, 100 - _FARTHEST_PERCENT), axis=0)
    low, high = np.minimum(low, centers.min(axis=0)), np.maximum(high, centers.max(axis=0))
    across, along = np.sort(np.argsort(-np.ptp(centers, axis=0), kind="stable")[:2])
    rows = np.linspace(0, len(points) - 1, min(_DOTS, len(points))).astype(int)
    blocks, number = np.unique(owners, return_inverse=True)
    middles = np.array([np.median(points[number == each], axis=0) for each in range(len(blocks))])
    colors = np.array([_read_color(text) for text in Style.SERIES], np.uint8)
    chart = Chart.make_map(
        "Blocks, and the cameras as rings", f"{'xyz'[across]} across, {'xyz'[along]} up",
        np.array([low[across], high[across]]), np.array([low[along], high[along]]),
    )  # fmt: skip
    chart.draw_points(
        points[rows, across], points[rows, along], colors[choose_colors(middles)[number[rows]]]
    )
    chart.draw_marks(centers[:, across], centers[:, along])
    for block, at in zip(blocks, middles, strict=True) if len(blocks) <= _MOST_NUMBERS else ():
        chart.label_place(at[across], at[along], str(block))
    write_file(folder / MAP, chart.build())


def _read_color(text: str) -> list[int]:
    """Reads red, green and blue of a colour such as #1668b8."""
    return list(bytes.fromhex(text[1:]))


def choose_colors(middles: np.ndarray) -> np.ndarray:
    """Chooses a colour's number (B,) for each block, so that blocks of one colour lie far apart.

    Args:
        middles: (B, 3) of the blocks.
    """
    chosen = np.zeros(len(middles), int)
    for block, middle in enumerate(middles):
        away = np.full(len(Style.SERIES), np.inf)
        np.minimum.at(away, chosen[:block], np.linalg.norm(middles[:block] - middle, axis=1))
        chosen[block] = int(np.argmax(away))
    return chosen
