"""The map of blocks in the report."""

import itertools

import numpy as np

from gsut.blocks.block_map import choose_colors


def test_neighbours_have_different_colours():
    grid = np.array([(x, y, 0.0) for x in range(4) for y in range(4)])
    chosen = choose_colors(grid)
    pairs = [
        (a, b)
        for a, b in itertools.combinations(range(16), 2)
        if np.linalg.norm(grid[a] - grid[b]) < 1.1
    ]
    assert len(pairs) == 24
    assert all(chosen[a] != chosen[b] for a, b in pairs)
