"""The lens page: its reader against gsut's, its figures in a browser, nothing from elsewhere."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import gsut
from browser import browser
from core_in_node import CORE, run_node
from gsut.cli import main
from gsut.view import write_lens_page
from random_scenes import small_camera
from tolerances.view import LENS_PAGE_PIXEL

READER = Path(__file__).parent / "read_lens_files.js"
# Ending of a file that a page reads, and the models that it can hold and gsut writes.
FORMATS = {
    "lens.json": ("fisheye624", "opencv8", "division", "splined_stereographic"),
    "cameramodel": ("opencv8", "pinhole", "splined_stereographic"),
    "transforms.json": ("pinhole", "opencv4", "opencv5", "opencv8", "kannala_brandt"),
    "yaml": ("pinhole", "opencv4", "opencv5", "opencv8", "kannala_brandt"),
    "txt": ("pinhole", "opencv4", "opencv8", "kannala_brandt", "fov", "division"),
}


def read_in_page(*paths):
    done = run_node(READER, CORE, *paths)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def assert_same_lens(found, camera):
    assert (found["model"], found["width"], found["height"]) == (
        camera.model, camera.width, camera.height,
    )  # fmt: skip
    assert found["params"] == list(camera.params)
    assert found["valid_field_angle"] == camera.valid_field_angle


def test_page_reads_what_gsut_writes_with_the_same_numbers(tmp_path):
    paths, cameras = [], []
    for ending, models in FORMATS.items():
        for model in models:
            path = tmp_path / model / (ending if "." in ending else f"lens.{ending}")
            path.parent.mkdir(exist_ok=True)
            path = path.with_name("a.lens.json") if ending == "lens.json" else path
            gsut.save_camera(small_camera(model), path)
            paths.append(path)
            cameras.append(gsut.load_camera(path))
    rows = read_in_page(*paths)
    assert len(rows) == sum(map(len, FORMATS.values()))
    for path, row, camera in zip(paths, rows, cameras, strict=True):
        assert "error" not in row, (path, row)
        assert_same_lens(row["lenses"][0], camera)


ROS = """image_width: 640
image_height: 480
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [500., 0., 320.5, 0., 501.25, 240., 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-.25, 0.07,
         1.e-4, 2e-5, 0.]
"""


def test_page_reads_files_of_other_programs_as_gsut_does(tmp_path):
    texts = {
        "ros.yaml": ROS,
        "cameras.txt": "# text\n1 SIMPLE_RADIAL 640 480 500 320 240 -0.1\n\n",
        "transforms.json": '{"camera_angle_x": 1.0, "w": 640, "h": 480, "k1": 0.1, "frames": []}',
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    paths = [tmp_path / name for name in texts]
    rows = read_in_page(*paths)
    assert len(rows) == 3
    for path, row in zip(paths, rows, strict=True):
        assert "error" not in row, (path, row)
        assert_same_lens(row["lenses"][0], gsut.load_camera(path))


def test_page_names_what_is_wrong_with_a_file(tmp_path):
    cases = {
        "a.json": ("{", "no JSON"),
        "b.json": ('{"model": "pinhol", "params": [], "width": 4, "height": 3}', "known"),
        "c.json": ('{"model": "pinhole", "params": [1, 1, 1, 1], "height": 3}', "width"),
        "d.txt": ("1 OPENCV 640 480 1 2 3", "8 parameters, found 3"),
        "e.txt": ("1 NOTHING 640 480 1 2 3", "line 1"),
        "f.yaml": (ROS.replace("plumb_bob", "?").replace(", 0.]", "]"), "nothing says which"),
        "g.yaml": ("{ what: is this }", "line 1"),
        "h.cameramodel": ("{ nothing", "line 1"),
        "i.json": ('{"lens_file": "a.lens.json", "frames": []}', "drop that file"),
        "j.json": ('{"camera_model": "PINHOLE", "w": 9, "h": 9}', "camera_angle_x is missing"),
        "k.txt": ("# nothing", "holds no camera"),
        "l.yaml": (ROS.replace("[-.25", "[-.x25"), "not a list of numbers"),
    }
    for name, (text, _) in cases.items():
        (tmp_path / name).write_text(text)
    rows = read_in_page(*(tmp_path / name for name in cases))
    assert len(rows) == len(cases)
    for (name, (_, words)), row in zip(cases.items(), rows, strict=True):
        assert name in row["error"] and words in row["error"], (name, row)


@pytest.fixture(scope="module")
def window():
    with browser() as window:
        yield window


def test_page_draws_every_model_and_turns_pixels_into_rays(window, tmp_path):
    camera = small_camera("kannala_brandt")
    write_lens_page(tmp_path / "lens.html", camera, "mine.json")
    window.open(f"file://{tmp_path / 'lens.html'}")
    window.wait("document.body.dataset.drawn > 0")
    assert window.run("return $('name').textContent;") == "mine.json"
    window.run("$('u').value = 10; $('v').value = 20; showRay();")
    rays, valid = camera.unproject(np.array([[10.0, 20.0]]))
    shown = window.run("return $('ray-text').textContent;")
    if valid[0]:
        assert f"{math.degrees(math.atan2(np.hypot(*rays[0, :2]), rays[0, 2])):.4f}"[:5] in shown
    pixels = window.run("return [...project([[0.2, 0.1, 1]]).pixels];")
    truth, _ = camera.project(np.array([[0.2, 0.1, 1.0]]))
    assert np.abs(np.array(pixels) - truth[0]).max() < LENS_PAGE_PIXEL
    models = gsut.lens.camera_models()
    for model in models:
        window.run(f"useExample({model!r});")
        assert window.run("return [lens.model, $('error').hidden];") == [model, True]
    assert len(models) > 20
    text = "1 PINHOLE 64 48 50 50 32 24\\n2 NOTHING 1"
    window.run(f"""await guarded(readFile)(new File(["{text}"], "cameras.txt"));""")
    assert "line 2" in window.run("return $('error').textContent;")
    assert window.run("return lens.model;") == models[-1]
    asked = window.run(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
        ".filter((name) => !/^(blob|data):/.test(name));"
    )
    assert asked == [] and window.errors() == []


def test_camera_page_writes_one_file_and_refuses_others(tmp_path, capsys):
    gsut.save_camera(small_camera("opencv8"), tmp_path / "a.lens.json")
    page = tmp_path / "lens.html"
    assert main(["camera", "page", str(page), "--lens", str(tmp_path / "a.lens.json")]) == 0
    assert '"name": "a.lens.json"' in page.read_text(encoding="utf-8")
    for flags, words in (
        ([str(page)], "exists"),
        ([str(tmp_path / "b.pdf")], ".html"),
        ([str(tmp_path / "b.html"), "--camera-id", "1"], "--lens"),
    ):
        assert main(["camera", "page", *flags]) != 0
        assert words in capsys.readouterr().err
