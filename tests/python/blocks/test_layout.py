"""Layouts: partitions of space, by work, in three dimensions."""

import json

import numpy as np
import pytest

from gsut.blocks.layout import Layout, cut_scene
from tolerances.blocks import MOST_OF_A_SHARE


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 16])
def test_bisection_gives_each_block_its_share_of_the_work(rng, count):
    points = rng.normal(size=(5000, 3)) * (5, 1, 3)
    work = rng.exponential(size=5000)
    layout = cut_scene(points, work, count)
    owners = layout.find_owners(points)
    assert len(layout) == count
    shares = np.bincount(owners, work, minlength=count) / work.sum()
    assert shares.min() > 0
    assert shares.max() * count < MOST_OF_A_SHARE


def test_every_point_has_one_owner_and_cuts_are_half_open(rng):
    layout = Layout({"axis": 1, "at": 0.5, "below": None,
                     "above": {"axis": 0, "at": -1.0, "below": None, "above": None}})  # fmt: skip
    points = np.array([[0, 0.5, 0], [0, np.nextafter(0.5, 0), 0], [-1, 9, 9], [-1e30, 9, 0]])
    assert layout.find_owners(points).tolist() == [2, 0, 2, 1]
    assert len(layout) == 3


def test_points_at_one_place_are_one_block():
    assert len(cut_scene(np.ones((9, 3)), np.ones(9), 4)) == 1


def test_layout_is_read_back_as_written(rng, tmp_path):
    points = rng.normal(size=(300, 3))
    layout = cut_scene(points, np.ones(300), 5)
    file = tmp_path / "layout.json"
    file.write_text(json.dumps(layout.as_dict()))
    assert Layout.read(str(file)) == layout
