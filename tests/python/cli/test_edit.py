"""Tests `gsut edit`: what it cuts, turns and scales, and refuses."""

import json

import numpy as np
import pytest

import gsut
from formats.scene_cases import plain_scene
from gsut.cli import main


@pytest.fixture
def ply(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gsut.save_ply("in.ply", plain_scene(rng, 400, 4))
    return gsut.load_ply("in.ply")


def edited(capsys, *words):
    assert main(["edit", *words, "-o", "out.ply", "--json"]) == 0
    return gsut.load_ply("out.ply"), json.loads(capsys.readouterr().out)


def test_edit_crops_by_box_sphere_and_opacity(ply, capsys):
    crops = "--crop-box -5 -5 -5 5 5 5 --crop-sphere 1 0 0 5"
    found, figures = edited(
        capsys, "in.ply", *crops.split(),
        "--min-opacity", "0.3",
    )  # fmt: skip
    kept = np.all(np.abs(ply.means) <= 5, axis=1)
    kept &= np.linalg.norm(ply.means - [1, 0, 0], axis=1) <= 5
    kept &= ply.opacity_logits >= np.log(0.3 / 0.7)
    assert figures["num_gaussians"] == len(found) == kept.sum() > 5
    np.testing.assert_array_equal(found.means, ply.means[kept])


def test_edit_scales_by_a_known_length_and_turns_up(ply, capsys):
    flags = "--length 0 0 0 0 0 2 5 --up 0 0 1"
    found, figures = edited(capsys, "in.ply", *flags.split())
    assert figures["scale"] == 2.5
    expected = 2.5 * ply.means @ np.array(figures["rotation"]).T
    np.testing.assert_allclose(found.means, expected, atol=1e-5)
    np.testing.assert_allclose(found.means[:, 1], -2.5 * ply.means[:, 2], atol=1e-5)
    np.testing.assert_allclose(found.log_scales, ply.log_scales + np.log(2.5), atol=1e-6)


def test_edit_merges_several(ply, capsys):
    found, figures = edited(capsys, "in.ply", "in.ply")
    assert figures["source_num_gaussians"] == len(found) == 800
    np.testing.assert_array_equal(found.means[400:], ply.means)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("-o in.ply", "exists; give another name"),
        ("-o out.obj", "no format to write has this suffix"),
        ("-o out.ply --crop-box 1 2 3", "--crop-box: expected 6 arguments"),
        ("-o out.ply --crop-sphere 99 0 0 1", "nothing is left"),
        ("-o out.ply --length 1 1 1 1 1 1 2", "scale must be above 0"),
        ("-o out.ply --scale 2 --length 0 0 0 1 0 0 2", "not both"),
        ("-o out.ply --min-opacity 2", "must lie in 0 to 1"),
        ("-o out.ply --up 0 0 0", "must be a direction"),
        ("-o out.ply --up 0 0 1 --upright", "not both"),
        ("-o out.ply --ground", "is a file, which has no cameras"),
    ],
)
def test_edit_refuses_in_one_sentence(ply, words, said, capsys):
    assert main(["edit", "in.ply", *words.split()]) == 2
    assert said in capsys.readouterr().err
    assert len(gsut.load_ply("in.ply")) == 400
