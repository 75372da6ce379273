"""Views that do not connect become models of their own."""

import json

import cv2
import numpy as np
import pytest

from gsut.data import load_dataset
from gsut.sfm.photographs.listing import Photographs
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.report.output import write_models
from gsut.sfm.solution.models import find_further_models
from gsut.sfm.solution.solver import solve_poses
from synthetic_walk import Synthetic

IMAGES = 12
OPTIONS = PosesOptions()


@pytest.fixture(scope="module")
def walk():
    """A walk, its pairs, and those of them within its two halves."""
    scene = Synthetic(np.random.default_rng(3), images=IMAGES, points=500)
    pairs = scene.verified()
    return scene, pairs, [p for p in pairs if (p.first < 6) == (p.second < 6)]


def solved(scene, pairs):
    return solve_poses(scene.images(), pairs, OPTIONS)


def test_views_that_do_not_connect_become_two_models(walk, tmp_path):
    scene, _, apart = walk
    first = solved(scene, apart)
    assert first.num_registered == 6
    same, models = find_further_models(first, scene.features, apart, OPTIONS)
    assert same is first and [m.num_registered for m in models] == [6]
    assert not (models[0].registered & first.registered).any()
    for name in first.names:
        cv2.imwrite(str(tmp_path / name), np.zeros((1010, 1000, 3), np.uint8))
    photographs = Photographs(
        tmp_path, first.names, [tmp_path / n for n in first.names], [None] * IMAGES,
        [scene.camera] * IMAGES,
    )  # fmt: skip
    (note,) = write_models(models, photographs, tmp_path)
    assert "6 images do not connect" in note and "model_2" in note
    assert len(load_dataset(tmp_path / "model_2", test_every=0).views) == 6
    assert json.loads((tmp_path / "model_2" / "poses.json").read_text())["model"] == 2
    assert write_models([], photographs, tmp_path) == []
    assert not (tmp_path / "model_2").exists()


def test_the_largest_model_is_the_first(walk):
    scene, pairs, _ = walk
    # Four images, found first, and eight others.
    apart = [p for p in pairs if (p.first < 4) == (p.second < 4)]
    small = solved(scene, [p for p in apart if p.first < 4])
    assert small.num_registered == 4
    first, (second,) = find_further_models(small, scene.features, apart, OPTIONS)
    assert second is small and first.registered.tolist() == [False] * 4 + [True] * 8
