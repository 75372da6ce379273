"""Tests `gsut edit`: what it cuts, turns and scales, and refuses."""

import importlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import small_run
from formats.scene_cases import plain_scene
from gsut.cli import main


@pytest.fixture
def ply(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gsut.formats.save_ply("in.ply", plain_scene(rng, 400, 4))
    return gsut.formats.load_ply("in.ply")


def edited(capsys, *words):
    assert main(["edit", *words, "-o", "out.ply", "--json"]) == 0
    return gsut.formats.load_ply("out.ply"), json.loads(capsys.readouterr().out)


def test_edit_crops_by_box_and_opacity(ply, capsys):
    flags = "--crop-box -5 -5 -5 5 5 5 --min-opacity 0.3"
    found, figures = edited(capsys, "in.ply", *flags.split())
    kept = np.all(np.abs(ply.means) <= 5, axis=1)
    kept &= ply.opacity_logits >= np.log(0.3 / 0.7)
    assert figures["num_gaussians"] == len(found) == kept.sum() > 5
    np.testing.assert_array_equal(found.means, ply.means[kept])


def test_edit_scales_and_turns_up(ply, capsys):
    flags = "--scale 2.5 --up 0 0 1"
    found, figures = edited(capsys, "in.ply", *flags.split())
    assert figures["scale"] == 2.5
    expected = 2.5 * ply.means @ np.array(figures["rotation"]).T
    np.testing.assert_allclose(found.means, expected, atol=1e-5)
    np.testing.assert_allclose(found.means[:, 1], -2.5 * ply.means[:, 2], atol=1e-5)
    np.testing.assert_allclose(found.log_scales, ply.log_scales + np.log(2.5), atol=1e-6)


def test_edit_repeats_edits_made_by_hand(ply, capsys):
    lens = {"model": "pinhole", "params": [40.0, 40.0, 50.0, 50.0], "width": 100, "height": 100}
    pose = np.eye(4)
    pose[2, 3] = 30.0
    region = {"do": "select", "camera_from_world": pose.tolist(), "lens": lens}
    box = [[30, 30], [60, 30], [60, 70], [30, 70]]
    line = {"points": [[45, 10], [45, 90]], "radius": 4.0, "subtract": True}
    edits = [{**region, "points": box}, {**region, **line}, {"do": "delete"}, {"do": "clear"}]
    Path("a.json").write_text(json.dumps({"edits": edits}))
    found, figures = edited(capsys, "in.ply", "--apply", "a.json")
    x, y, z = (ply.means + np.array([0, 0, 30.0])).T
    u, v = 40 * x / z + 50, 40 * y / z + 50
    gone = (z > 0) & (u >= 30) & (u <= 60) & (v >= 30) & (v <= 70) & (np.abs(u - 45) > 4)
    assert figures["removed_by_hand"] == gone.sum() > 5
    np.testing.assert_array_equal(found.means, ply.means[~gone])


def test_edit_in_front_leaves_what_a_surface_hides(ply, capsys):
    # A wall of three Gaussians, one before it, one behind it, both small.
    wall = gsut.Gaussians(
        np.array([[0, 0, 4.0], [0.1, 0, 4], [0, 0.1, 4], [0, 0, 2], [0, 0, 6]]),
        np.tile([1.0, 0, 0, 0], (5, 1)), np.log([[2, 2, 0.01]] * 3 + [[0.01] * 3] * 2),
        np.full(5, 5.0), np.zeros((5, 1, 3)),
    ).to_dtype(np.float32)  # fmt: skip
    gsut.formats.save_ply("wall.ply", wall)
    lens = {"model": "pinhole", "params": [50.0, 50.0, 50.0, 50.0], "width": 100, "height": 100}
    edit = {
        "do": "select", "camera_from_world": np.eye(4).tolist(), "lens": lens, "front": True,
        "points": [[20, 20], [80, 20], [80, 80], [20, 80]],
    }  # fmt: skip
    Path("a.json").write_text(json.dumps({"edits": [edit, {"do": "delete"}]}))
    found, _ = edited(capsys, "wall.ply", "--apply", "a.json")
    np.testing.assert_array_equal(found.means, [[0, 0, 6]])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"edits": [{"do": "paint"}]}, "paint"),
        ({"edits": [{"do": "select"}]}, "lacks 'camera_from_world'"),
        ({"steps": []}, "lacks 'edits'"),
    ],
)
def test_edit_refuses_other_edits(ply, capsys, content, said):
    Path("a.json").write_text(json.dumps(content))
    assert main(["edit", "in.ply", "-o", "out.ply", "--apply", "a.json"]) == 2
    assert said in capsys.readouterr().err
    assert not Path("out.ply").exists()


def test_edit_merges_several(ply, capsys):
    found, figures = edited(capsys, "in.ply", "in.ply")
    assert figures["source_num_gaussians"] == len(found) == 800
    np.testing.assert_array_equal(found.means[400:], ply.means)


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene)
    return small_run.finished_run(tmp_path / "run", scene, report=False), scene


def test_edit_leaves_floaters_out_of_a_run(run, monkeypatch, capsys):
    asked = []

    def find_support(scene, gaussians, rows, **_):
        asked.append(rows)
        marks = np.arange(len(gaussians))
        return SimpleNamespace(unseen=marks < 100, contradicted=marks % 2 == 0)

    monkeypatch.setattr(importlib.import_module("gsut.compact"), "find_support", find_support)
    found, figures = edited(capsys, "run", "--floaters")
    assert asked == [(1, 2, 4, 5)]  # the training photographs
    assert figures["floaters"] == 100 + (1234 - 100) // 2
    assert len(found) == 1234 - figures["floaters"]


def test_edit_makes_a_run_metric_by_positions(run, capsys):
    lines = ["name,x,y,z"]
    for view in run[1].views:
        x, y, z = 3 * (view.camera_center + run[1].world_offset) + [100, 200, 300]
        lines.append(f"{view.name},{x},{y},{z}")
    Path("p.csv").write_text("\n".join(lines))
    found, figures = edited(capsys, "run", "--positions", "p.csv")
    assert figures["scale"] == pytest.approx(3.0)
    assert figures["positions_rms"] == pytest.approx(0.0, abs=1e-9)
    zero = [[100, -300, 200]] * len(found)  # of the dataset: east, down, north
    np.testing.assert_allclose(found.means + found.origin, zero, rtol=1e-6)
