"""A model carries its response: through files, rows, merges and a training."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.edit import merge_gaussians
from gsut.formats import open_ply
from gsut.formats.ply import read_comments
from random_scenes import random_gaussians


def make_model(rng, response="extinction", count=40):
    return dataclasses.replace(random_gaussians(rng, count), response=response)


def test_response_stays_with_rows_copies_types_and_origins(rng):
    g = make_model(rng)
    moved = g.translate((1e6, 0, 0))
    for same in (g[3:5], g.copy(), g.to_dtype(np.float64), moved, moved.with_origin((0, 0, 0))):
        assert same.response == "extinction"
    assert random_gaussians(rng, 2).response == "maximum"
    with pytest.raises(InputError, match='"beta" is unknown; known: maximum, extinction, density'):
        dataclasses.replace(g, response="beta")


def test_save_ply_names_the_response_and_load_ply_reads_it(rng, tmp_path):
    g, path = make_model(rng), tmp_path / "scene.ply"
    gsut.save_gaussians(path, g)
    assert "gsut: response extinction" in read_comments(path)
    found = gsut.load_gaussians(path)
    assert found.response == open_ply(path, memory=1).response == "extinction"
    assert found.means.tobytes() == g.means.tobytes()
    gsut.save_gaussians(path, dataclasses.replace(g, response="maximum"))
    assert not any("response" in comment for comment in read_comments(path))
    assert gsut.load_gaussians(path).response == "maximum"


def test_load_ply_of_an_unknown_response_is_refused(rng, tmp_path):
    path = tmp_path / "scene.ply"
    gsut.save_gaussians(path, make_model(rng))
    path.write_bytes(path.read_bytes().replace(b"response extinction", b"response extincted!"))
    with pytest.raises(InputError, match=r"scene\.ply: the comment .*extincted!.* known: maximum"):
        gsut.load_gaussians(path)


def test_save_gltf_names_the_response_and_an_unknown_one_is_refused(rng, tmp_path):
    path = tmp_path / "scene.glb"
    assert not gsut.save_gaussians(path, make_model(rng)).left_out
    assert gsut.load_gaussians(path).response == "extinction"
    path.write_bytes(path.read_bytes().replace(b'"extinction"', b'"extincted!"'))
    with pytest.raises(InputError, match=r"scene\.glb: extras .*extincted!.* known: maximum"):
        gsut.load_gaussians(path)
    other = b'["of another program"]'.ljust(len(b'{"gsut: response":"extincted!"}'))
    path.write_bytes(path.read_bytes().replace(b'{"gsut: response":"extincted!"}', other))
    assert gsut.load_gaussians(path).response == "maximum"


@pytest.mark.parametrize("suffix", [".splat", ".compressed.ply"])
def test_save_other_formats_say_that_the_response_is_lost(rng, tmp_path, suffix):
    path = tmp_path / f"scene{suffix}"
    left_out = gsut.save_gaussians(path, make_model(rng)).left_out
    assert any("response extinction: the file is drawn by the maximum" in each for each in left_out)
    assert gsut.load_gaussians(path).response == "maximum"
    left_out = gsut.save_gaussians(path, make_model(rng, "maximum")).left_out
    assert not any("response" in each for each in left_out)


def test_merge_of_two_responses_is_refused(rng):
    two = [make_model(rng), make_model(rng, "maximum")]
    with pytest.raises(InputError, match="one response, found extinction, maximum"):
        merge_gaussians(two)
    assert merge_gaussians([two[0], two[0]]).response == "extinction"
