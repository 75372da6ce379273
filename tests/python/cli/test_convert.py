"""Tests `gsut convert`: what it writes, prints and refuses."""

import json

import numpy as np
import pytest

import gsut
import small_run
from formats.scene_cases import plain_scene
from gsut.cli import main
from gsut.gaussians import press_surfels


@pytest.fixture
def ply(tmp_path, rng):
    path = tmp_path / "in.ply"
    gsut.formats.save_ply(path, plain_scene(rng, 200, 16))
    return path


def test_convert_writes_the_format_of_the_suffix_and_prints_what_it_cost(ply, tmp_path, capsys):
    assert main(["convert", str(ply), str(tmp_path / "out.spz")]) == 0
    assert len(gsut.load_gaussians(tmp_path / "out.spz")) == 200
    said = capsys.readouterr().out
    assert "200 Gaussians" in said and "(SPZ)" in said


def test_convert_json_has_the_errors_of_the_file(ply, tmp_path, capsys):
    out = tmp_path / "out.glb"
    assert main(["convert", str(ply), str(out), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["format"] == "glTF"
    assert figures["bytes"] == out.stat().st_size
    assert figures["errors"]["position"] == 0.0
    before, after = gsut.load_gaussians(ply), gsut.load_gaussians(out)
    np.testing.assert_array_equal(after.sh, before.sh)


def test_convert_keeps_surfels_or_says_that_they_are_gaussians_now(tmp_path, rng, capsys):
    g = plain_scene(rng, 50, 1)
    press_surfels(g.log_scales)
    gsut.formats.save_ply(tmp_path / "in.ply", g)
    for name in ("out.ply", "out.glb"):
        assert main(["convert", str(tmp_path / "in.ply"), str(tmp_path / name)]) == 0
        said = capsys.readouterr().out
        assert "50 surfels" in said
        assert ("the file holds Gaussians" in said) == (name != "out.ply")
    assert b"scale_2" not in (tmp_path / "out.ply").read_bytes()


def test_convert_takes_the_folder_of_a_run(tmp_path, monkeypatch, capsys):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene)
    run = small_run.finished_run(tmp_path / "run", scene, report=False)
    assert main(["convert", str(run.path), str(tmp_path / "out.splat"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["format"] == "splat"
    assert len(gsut.load_gaussians(tmp_path / "out.splat")) == len(small_run.GAUSSIANS)


def test_convert_run_to_a_page_is_linked_from_the_report(tmp_path, monkeypatch, capsys):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene)
    run = small_run.finished_run(tmp_path / "run", scene)
    assert "scene.html" not in (run.path / "report.html").read_text()
    assert main(["convert", str(run.path), str(run.path / "scene.html")]) == 0
    assert "a double click opens it" in capsys.readouterr().out
    assert '<a href="scene.html">' in (run.path / "report.html").read_text()
