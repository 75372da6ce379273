"""Tests the demo's scenes: the pixels that the tracer made, complete data sets, clear errors."""

import hashlib
import json

import cv2
import numpy as np
import pytest

import gsut
from gsut.cli import main
from gsut.demo.scenes import DEMO_SCENES, write_demo_scene

# SHA-256 over names, shapes and pixels of all pictures, as lab/demo_tracer makes them.
PIXELS = {
    "fisheye_hall": "b48db90c47ff0d4bad755019ff2ca6cc8cc2b9eebb9937cf8c3b50cce87b9d52",
    "rig_hall": "3d205dc7870e5c84a7132c39f1e1507950cc22cfb63791965e65011114f3100b",
}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A folder with each of the demo's scenes."""
    folder = tmp_path_factory.mktemp("demo")
    for name in DEMO_SCENES:
        assert write_demo_scene(folder / name, name) == folder / name
    return folder


@pytest.mark.quick
@pytest.mark.parametrize("name", DEMO_SCENES)
def test_demo_pictures_have_the_pixels_that_the_tracer_made(scenes, name):
    digest = hashlib.sha256()
    files = sorted((scenes / name).rglob("*.png"))
    for file in files:
        pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        digest.update(f"{file.relative_to(scenes).as_posix()} {pixels.shape}".encode())
        digest.update(pixels.tobytes())
    assert len(files) > 15
    assert digest.hexdigest() == PIXELS[name]


def test_demo_hall_is_complete(scenes):
    content = json.loads((scenes / "fisheye_hall" / "transforms.json").read_text())
    assert content["camera_model"] == "OPENCV_FISHEYE"
    scene = gsut.load_dataset(scenes / "fisheye_hall")
    assert (len(scene.train_indices), len(scene.test_indices)) == (30, 5)
    assert len(scene.points) == 4000
    assert [view.depth_path is not None for view in scene.views] == [
        index in scene.test_indices for index in range(35)
    ]
    for index, view in enumerate(scene.views):
        assert scene.image(index).shape == (200, 200, 3) and 0.5 < scene.mask(index).mean() < 1
        labels = cv2.imread(
            str(scenes / "fisheye_hall" / "labels" / view.image_path.name), cv2.IMREAD_UNCHANGED
        )
        assert labels.dtype == np.uint8 and np.all(labels[scene.mask(index)] < 255)


def test_demo_rig_is_complete(scenes):
    rig = scenes / "rig_hall"
    scene = gsut.load_dataset(rig, test_every=8)
    assert len({view.image_path.parent.name for view in scene.views}) == 2
    assert all((rig / f"{name}.yaml").is_file() for name in ("left", "right"))
    assert list(json.loads((rig / "rig.json").read_text())["cameras"]) == ["left", "right"]
    for index in scene.test_indices:
        name = scene.views[index].image_path.relative_to(rig / "images")
        assert (rig / "depth" / name).is_file()


def test_demo_rig_for_real_tells_its_errors(tmp_path, capsys):
    words = ["demo", "--rig", "-o", str(tmp_path / "demo"), "--steps", "30", "--no-open", "--json"]
    assert main(words) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["poses"]["images"] == len(list((tmp_path / "demo/rig_hall/images").rglob("0*")))
    assert abs(figures["poses"]["scale_error_percent"]) < 1
    assert figures["depth"]["abs_rel_median"] < 0.5
    assert (tmp_path / "demo" / "rig_run" / "report.html").is_file()


def test_demo_scene_existing_folder_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("kept")
    with pytest.raises(gsut.InputError, match="nothing was overwritten"):
        write_demo_scene(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_demo_scene_interrupted_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("gsut.demo.scenes.write_picture", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_demo_scene(tmp_path / "data")
    assert not list(tmp_path.iterdir())


def test_demo_scene_of_another_name_raises(tmp_path):
    with pytest.raises(gsut.InputError, match="fisheye_hall, rig_hall"):
        write_demo_scene(tmp_path / "data", "kitchen")
