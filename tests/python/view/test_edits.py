"""The page's edits: ground, floaters, and a scene saved anew; and `gsut measure`."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import small_run
from gsut import InputError
from gsut.cli import main
from gsut.view import Session
from gsut.view.measure import find_point_in_photograph
from gsut.view.stage import Stage
from random_scenes import fisheye, gaussians_in_view, rng_of
from tolerances.view import MEASURED, PICKED_POINT


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_run.scene_from_arrays(tmp_path_factory.mktemp("edits"))


@pytest.fixture(scope="module")
def gaussians(scene):
    return gaussians_in_view(rng_of("edits"), fisheye(), scene.views[0].camera_from_world, 300)


@pytest.fixture
def session(scene, gaussians, tmp_path):
    return Session(Stage("small", "run", gaussians, scene, folder=tmp_path))


def test_save_writes_what_is_shown_turned_and_scaled(session, gaussians, tmp_path):
    shown = session.shown
    crop = [[-9, -9, -9], [0.2, 9, 9]]
    up = np.array([0.1, 0.2, 1.0])
    values = {"name": "a.ply", "crop": crop, "up": up.tolist(), "level": 0.3, "scale": 2.0}
    said = session.save_scene(values).content
    inside = (gaussians.means - shown.center) @ shown.axes[0] <= 0.2 * shown.extent
    assert said["num_gaussians"] == inside.sum() and said["of"] == 300
    found = gsut.formats.load_ply(tmp_path / "a.ply")
    heights = -2.0 * (gaussians.means[inside] @ (up / np.linalg.norm(up)) - 0.3)
    np.testing.assert_allclose(found.means[:, 1], heights, atol=MEASURED)
    np.testing.assert_allclose(
        found.log_scales, gaussians.log_scales[inside] + np.log(2), atol=MEASURED
    )


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"name": "scene.ply"}, "exists; give another name"),
        ({"name": "../a.ply"}, "without folders"),
        ({"name": "a.obj"}, "no format to write"),
        ({"name": "a.ply", "crop": [[8, 8, 8], [9, 9, 9]]}, "nothing is left"),
        ({"name": "a.ply", "scale": -1}, "scale takes a number from 1e-12"),
        ({"name": "a.ply", "up": [0, 0, 0]}, "must be a direction"),
    ],
)
def test_save_refuses_in_one_sentence_and_writes_nothing(session, tmp_path, values, said):
    (tmp_path / "scene.ply").write_text("mine")
    with pytest.raises(InputError, match=said):
        session.save_scene(values)
    assert (tmp_path / "scene.ply").read_text() == "mine"
    assert len(list(tmp_path.iterdir())) == 1


def test_ground_is_found_and_a_training_has_no_file_yet(session, scene, gaussians):
    g = dataclasses.replace(gaussians, means=gaussians.means.copy())
    flat = np.arange(300) < 150
    g.means[flat] = np.random.default_rng(1).uniform(-1, 1, (150, 3)) * [3, 3, 0.01] + [0, 0, -2]
    g.quats[flat], g.log_scales[flat], g.opacity_logits[flat] = [1, 0, 0, 0], [-1, -1, -5], 2.0
    found = Session(Stage("a", "training", g, scene))
    plane = found.find_ground({"up": [0.1, 0, 1]}).content
    assert plane["normal"] @ [0, 0, 1] > 0.99
    assert plane["level"] == pytest.approx(-2, abs=0.1)
    with pytest.raises(InputError, match="not a file yet"):
        found.save_scene({"name": "a.ply"})
    with pytest.raises(InputError, match="run's photographs"):
        found.find_floaters({})


def test_floaters_are_left_out_of_frames_and_files(
    session, scene, gaussians, monkeypatch, tmp_path
):
    floats = np.arange(300) % 3 == 0
    support = SimpleNamespace(contradicted=floats, unseen=np.zeros(300, bool))
    monkeypatch.setattr("gsut.view.edits.find_support", lambda *_, **__: support)
    pose = scene.views[0].camera_from_world
    frame = {"pose": pose.ravel().tolist(), "lens": 0, "width": 32, "height": 32, "clean": True}
    request = session._request({**frame, "quality": None})
    before = session.frames.draw(request).image.copy()
    for wish in (
        lambda: session.save_scene({"name": "a.spz", "clean": True}),
        lambda: session.handle_film({"keys": [frame["pose"]] * 2, "frame": frame}),
    ):
        with pytest.raises(gsut.InputError, match="floaters are not found yet: wait"):
            wish()
    assert session.find_floaters({}).content == {"count": 100, "of": 300}
    after = session.frames.draw(request).image
    clean = gsut.render(gaussians[~floats], scene.cameras[0], pose).image
    np.testing.assert_array_equal(after, gsut.rendering.to_uint8(clean))
    assert np.any(before != after)
    assert session.save_scene({"name": "a.spz", "clean": True}).content["num_gaussians"] == 200


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
