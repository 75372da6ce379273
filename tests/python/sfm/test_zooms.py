"""Images of two zooms: told by the focal length that each asks for; one zoom is none."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut.lens import with_scaled_focal
from gsut.sfm.lens import zooms
from gsut.sfm.lens.zooms import describe_zooms, find_zooms, search_zooms
from gsut.sfm.mapping import Findings
from gsut.sfm.matches.matching import match_images
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.report.verdict import judge_solution
from gsut.sfm.solution.solver import solve_poses
from synthetic_walk import Synthetic, quiet

IMAGES, FACTOR = 9, 1.5
OPTIONS = PosesOptions()
LENS = gsut.Camera("kannala_brandt", [500, 500, 500, 505, 0.02, -0.01, 0, 0], 1000, 1010)
NAMES = [f"{i:03d}.png" for i in range(IMAGES)]
SECOND = [2, 5, 8]  # images of the second zoom


@pytest.fixture(scope="module")
def mixed():
    """A walk with every third image of another zoom, and its raw matches."""
    factors = [FACTOR if i in SECOND else 1.0 for i in range(IMAGES)]
    scene = Synthetic(
        np.random.default_rng(4), images=IMAGES, points=500, camera=LENS, zooms=factors
    )
    return scene, match_images(NAMES, scene.features, OPTIONS, quiet)


@pytest.fixture(scope="module")
def of_one(mixed):
    """Poses of the images of the first zoom alone, the lens known."""
    scene, _ = mixed
    pairs = [p for p in scene.verified() if not {p.first, p.second} & set(SECOND)]
    found = solve_poses(scene.images(), pairs, OPTIONS)
    assert found.num_registered == IMAGES - len(SECOND)
    return found


def test_zooms_are_found_with_their_focal_lengths_and_names(mixed, of_one):
    scene, raw = mixed
    first, second = find_zooms(of_one, scene.features, raw, OPTIONS)
    assert second.names == [NAMES[i] for i in SECOND]
    assert first.focal == pytest.approx(500, rel=0.01)
    assert second.focal == pytest.approx(FACTOR * 500, rel=0.01)
    (note,) = describe_zooms([first, second])
    assert "2 zooms: 6 at a focal length of 500 px, 3 at" in note
    assert "put 002.png, 005.png, 008.png into a folder of their own" in note
    verdict = judge_solution(of_one, scene.features, Findings(zooms=[first, second]))
    assert verdict.level != "good" and "the images were taken at 2 zooms" in verdict.reasons


def test_images_of_one_zoom_are_none():
    scene = Synthetic(np.random.default_rng(4), images=IMAGES, points=300, camera=LENS)
    raw = match_images(NAMES, scene.features, OPTIONS, quiet)
    pairs = scene.verified()
    whole = solve_poses(scene.images(), pairs, OPTIONS)
    assert describe_zooms([]) == []
    assert whole.registered.all() and find_zooms(whole, scene.features, raw, OPTIONS) == []
    of_first = [p for p in pairs if not {p.first, p.second} & set(SECOND)]
    some = solve_poses(scene.images(), of_first, OPTIONS)
    assert not some.registered.all() and find_zooms(some, scene.features, raw, OPTIONS) == []


def test_lens_is_sought_by_the_images_of_one_zoom_where_many_are_left_out(
    mixed, of_one, monkeypatch
):
    scene, raw = mixed
    few = np.zeros(IMAGES, bool)
    few[:4] = True
    compromise = dataclasses.replace(
        of_one,
        registered=few,
        cameras=[with_scaled_focal(LENS, 1.2)] * IMAGES,
        observations=np.zeros((0, 3), np.int32),
        pixels=np.zeros((0, 2)),
    )
    searched = []

    def search(mapping):
        searched.append({int(image) for image in mapping.raw.pairs.ravel()})
        return mapping.replace(solution=compromise if len(searched) == 1 else of_one)

    monkeypatch.setattr(zooms, "search_lens", search)
    monkeypatch.setattr(zooms, "_FOCALS", np.geomspace(0.7, 1.6, 5))
    mapping = scene.mapping(OPTIONS, raw=raw)
    mapping = search_zooms(mapping)
    assert mapping.solution is of_one
    assert [len(zoom.names) for zoom in mapping.found.zooms] == [6, 3]
    whole, own = searched
    assert whole == set(range(IMAGES)) and own and not own & set(SECOND)


def test_lens_is_not_sought_again_where_images_only_do_not_connect(monkeypatch):
    scene = Synthetic(np.random.default_rng(4), images=IMAGES, points=300, camera=LENS)
    raw = match_images(NAMES, scene.features, OPTIONS, quiet)
    pairs = [p for p in scene.verified() if (p.first < 5) == (p.second < 5)]
    half = solve_poses(scene.images(), pairs, OPTIONS)
    assert half.num_registered == 5
    searched = []

    def search(mapping):
        searched.append(1)
        return mapping.replace(solution=half)

    monkeypatch.setattr(zooms, "search_lens", search)
    apart = [i for i, (a, b) in enumerate(raw.pairs) if (a < 5) == (b < 5)]
    raw = dataclasses.replace(raw, pairs=raw.pairs[apart], matches=[raw.matches[i] for i in apart])
    mapping = scene.mapping(OPTIONS, raw=raw)
    mapping = search_zooms(mapping)
    assert mapping.solution is half and mapping.found.zooms == [] and len(searched) == 1
