"""`gsut calibrate` from photographs to files, and its one-sentence errors."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gsut
import tolerances
from calib.solve.mrcal_process import INSTALL
from calib_fakes import FISHEYE, ROOT, write_pictures
from gsut.cli.calibrate import _list_images


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with ten drawn boards of a fisheye."""
    path = tmp_path_factory.mktemp("photographs")
    write_pictures(path, 10, np.random.default_rng(21))
    return path


def _run(*words, path=None):
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "python")}
    if path is not None:
        environment["PATH"] = path
    return subprocess.run(
        [sys.executable, "-m", "gsut", "calibrate", *map(str, words)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_calibrate_fisheye_writes_lens_report_and_corners(folder, tmp_path):
    out = tmp_path / "new" / "lens.yaml"
    arguments = ("--board", "7x5", "--spacing", "0.03", "--lens", "fisheye", "-o", out)
    done = _run(folder, *arguments)
    assert done.returncode == 0, done.stderr
    assert "verdict: " in done.stdout
    camera = gsut.load_camera(out)
    assert camera.model == "kannala_brandt"
    error = np.abs(camera.params - FISHEYE.params)[:4]
    assert error.max() < tolerances.CALIB_DRAWN_LENS_PX
    report = json.loads((out.parent / "report.json").read_text())
    assert report["boards_total"] == report["boards_found"] == 10
    assert (report["lens"], report["solver"]) == ("fisheye", "opencv")
    assert report["rms_2d_px"] == pytest.approx(2**0.5 * report["rms_axis_px"], abs=2e-6)
    degrees = np.degrees(camera.valid_field_angle)
    assert report["valid_angle_degrees"] == pytest.approx(degrees, abs=1e-5)
    assert set(report["cameras"]) == {"camera"}
    page = (out.parent / "report.html").read_text()
    assert page.count("data:image/svg+xml") >= 4
    assert "http" not in page  # self-contained
    assert len(list((out.parent / "corners").iterdir())) == 10
    assert (out.parent / "corners.vnl").read_text().count("\n") == 1 + 10 * 35


def test_help_of_run_and_calibrate_name_mrcal_and_its_installation():
    run = subprocess.run(
        [str(ROOT / "run"), "help"], capture_output=True, text=True, check=True
    ).stdout
    calibrate = _run("--help").stdout
    for text in (run, calibrate):
        assert "mrcal" in text
        assert INSTALL in " ".join(text.split())


def test_calibrate_missing_mrcal_is_one_sentence_with_the_command(folder, tmp_path):
    out = tmp_path / "lens.cameramodel"
    words = (folder, "--board", "7x5", "--spacing", "0.03", "--lens", "splined", "-o", out)
    done = _run(*words, path=str(tmp_path))
    assert done.returncode == 2
    assert done.stderr.startswith("gsut: error: mrcal is not installed")
    assert "apt-get install mrcal python3-mrcal" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not out.exists()


def test_images_folders_and_patterns_are_expanded(folder, tmp_path):
    assert len(_list_images([str(folder)])) == 10
    assert len(_list_images([str(folder / "board1*.png")])) == 1
    assert _list_images(["absent.png"]) == [Path("absent.png")]  # calib names it
    with pytest.raises(gsut.InputError, match="holds no images"):
        _list_images([str(tmp_path)])
    with pytest.raises(gsut.InputError, match="no file matches"):
        _list_images([str(tmp_path / "*.png")])
