"""`gsut measure`: distances between pixels of photographs and points."""

import dataclasses
import json

import numpy as np
import pytest

import gsut
from gsut.cli import main
from gsut.view import Session
from gsut.view.measure import find_point_in_photograph
from gsut.view.stage import Stage
from tolerances.view import MEASURED, PICKED_POINT


@pytest.fixture
def session(scene, gaussians):
    return Session(Stage("small", "run", gaussians, scene))


def measured(monkeypatch, capsys, stage, *words):
    monkeypatch.setattr("gsut.view.open_stage", lambda *_: stage)
    assert main(["measure", "RUN", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_measure_by_pixels_of_photographs_and_points(
    session, scene, gaussians, monkeypatch, capsys
):
    stage = session.stage
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[0].camera_from_world)
    row, column = np.unravel_index(np.argmax(truth.alpha), truth.alpha.shape)
    pixel = [column + 0.5, row + 0.5]
    words = ["--pixel", "0.png", *map(str, pixel), "--point", "1", "2", "3", "--length", "5"]
    found = measured(monkeypatch, capsys, stage, *words)
    frame = {"pose": scene.views[0].camera_from_world.ravel().tolist(), "lens": 0, "width": 32}
    picked = session.pick_point({"frame": {**frame, "height": 32}, "pixel": pixel}).content[
        "in_dataset"
    ]
    np.testing.assert_allclose(found["points"], [picked, [1, 2, 3]], atol=PICKED_POINT)
    distance = np.linalg.norm(picked - [1, 2, 3])
    assert found["distances"] == pytest.approx([distance])
    assert found["scale_sigma_percent"] is None  # the dataset does not say
    assert 0.005 * truth.depth[row, column] < found["sigmas"][0] < distance
    assert found["scale"] == pytest.approx(5 / distance)


def test_measure_knows_when_a_rolling_shutter_read_the_pixel(scene, gaussians):
    view = scene.views[0]
    twist = gsut.exp_pose(np.array([0.4, 0.2, 0, 0, 0, 0]))
    rolling = dataclasses.replace(
        view, camera_from_world_start=np.linalg.inv(twist) @ view.camera_from_world,
        camera_from_world_end=twist @ view.camera_from_world,
        shutter=gsut.Shutter("top_to_bottom"),
    )  # fmt: skip
    moving = scene.replace(views=(rolling, *scene.views[1:]))
    truth = gsut.render(gaussians, scene.cameras[0], rolling.motion)
    row, column = np.unravel_index(np.argmax(truth.alpha[:8]), truth.alpha[:8].shape)
    assert truth.alpha[row, column] > 0.5
    pixel = (column + 0.5, row + 0.5)
    found, _ = find_point_in_photograph(Stage("a", "run", gaussians, moving), "images/0.png", pixel)
    pose = rolling.motion.at((row + 0.5) / 32)
    in_camera = pose[:3, :3] @ (found - moving.world_offset) + pose[:3, 3]
    ray = scene.cameras[0].unproject(np.array([pixel]))[0][0]
    np.testing.assert_allclose(np.cross(in_camera, ray), 0, atol=MEASURED)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--point 1 2 3", "a distance needs two"),
        ("--pixel 9.png 1 1 --point 1 2 3", "0 photographs are named 9.png; names are like images"),
        ("--pixel 0.png 99 1 --point 1 2 3", "has 32 x 32 pixels"),
        ("--pixel 0.png a 1 --point 1 2 3", "a photograph's name and two numbers, found 'a'"),
        ("--pixel 0.png 0.5 0.5 --point 1 2 3", "nothing is seen at pixel 0.5, 0.5"),
        ("--point 1 2 3 --point 1 2 3 --length 2", "the first two points are one"),
        ("--point 1 2 3 --point 1 2 4 --length -2", "--length must be above 0"),
    ],
)
def test_measure_refuses_in_one_sentence(session, monkeypatch, capsys, words, said):
    monkeypatch.setattr("gsut.view.open_stage", lambda *_: session.stage)
    assert main(["measure", "RUN", *words.split()]) == 2
    assert said in capsys.readouterr().err
