"""A scene that is looked at while it is made: poses, the training; bits of a plain run."""

import base64

import cv2
import numpy as np
import pytest

import gsut
import rendered_dataset
from browser import browser
from gsut.sfm.solution import Solution
from gsut.view import LiveScene, ViewServer


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live")
    return gsut.load_dataset(rendered_dataset.write_dataset(folder, np.random.default_rng(5)))


def solve(scene, registered):
    """What the solver would have found by then: the truth of the first images."""
    count, points = len(scene), len(scene.points)
    empty = np.zeros((0, 2))
    return Solution(
        [view.name for view in scene.views], [scene.cameras[0]] * count,
        np.arange(count) < registered, np.array([v.camera_from_world for v in scene.views]),
        np.zeros((count, 6, 6)), scene.points, scene.point_colors, np.zeros(points),
        np.zeros((0, 3), np.int32), empty, empty, np.zeros(0), (0, 1), 0, 0.0, 0.0, None,
        np.zeros((0, 3), np.int32),
    )  # fmt: skip


def bits(result):
    g = result.gaussians
    return [a.tobytes() for a in (g.means, g.quats, g.log_scales, g.opacity_logits, g.sh)]


def test_scene_in_the_making_shows_poses_and_the_training(scene, monkeypatch):
    options = gsut.TrainOptions(steps=12, max_gaussians=600)
    alone = gsut.train(scene, options, progress=False)
    live = LiveScene("walk")
    ask = lambda route, **values: live.routes[route](values).content  # noqa: E731
    assert ask("scene") == {"name": "walk", "kind": "making", "shown": 0}
    live.show_pictures({view.name: view.image_path for view in scene.views})
    live.show_progress({"stage": "mapping", "share": 0.4, "seconds_left": 9.0, "text": "images"})
    live.show_poses(lambda: solve(scene, 5))
    now = ask("making")
    assert (now["stage"], now["version"], now["shown"]) == ("mapping", 1, 0)
    assert np.shape(now["found"]["cameras"]) == (5, 12) and now["found"]["images"] == len(scene)
    points = np.frombuffer(base64.b64decode(now["found"]["points"]), "<f4").reshape(-1, 3)
    np.testing.assert_array_equal(points, scene.points.astype(np.float32))
    assert "found" not in ask("making", version=1)
    small = cv2.imdecode(np.frombuffer(ask("picture", name=scene.views[3].name), np.uint8), 1)
    assert small.shape == (6, 6, 3)

    live.show_poses(lambda: pytest.fail("looked at too soon"))
    monkeypatch.setattr("gsut.view.live_scene._LOOK_SECONDS", 0.0)
    live.show_poses(lambda: solve(scene, len(scene)))
    assert (ask("making")["version"], ask("making")["shown"]) == (2, 0)
    watched = gsut.train(
        scene, options, progress=False, watch=live.begin_training(scene, options)
    )  # fmt: skip
    live.finish(watched.gaussians)
    assert bits(watched) == bits(alone)
    pose = scene.views[0].camera_from_world.ravel().tolist()
    frame = {"pose": pose, "lens": 0, "quality": None, "view": 0, "width": 48, "height": 48}
    assert cv2.imdecode(np.frombuffer(ask("frame", **frame), np.uint8), 1).std() > 10  # a picture
    seen = ask("scene")
    assert (seen["kind"], seen["shown"], seen["name"]) == ("training", 1, "walk")
    assert ask("making")["stage"] == "finished" and ask("training")["step"] == 12


def test_page_draws_cameras_and_points_before_there_are_gaussians(scene):
    live = LiveScene("walk")
    live.show_pictures({view.name: view.image_path for view in scene.views})
    live.show_progress({"stage": "mapping", "share": 0.4, "seconds_left": 70.0, "text": "images"})
    live.show_poses(lambda: solve(scene, 5))
    with ViewServer(live.routes) as server, browser(390, 844) as window:
        window.open(server.address)
        window.wait("document.body.dataset.cameras === '5'")
        drawn = window.read_canvas()[..., :3].reshape(-1, 3)
        assert len(np.unique(drawn, axis=0)) > 10  # colours of points, and of cameras
        seen = window.run("return document.getElementById('making').innerText;")
        assert "mapping: images" in seen and "about 1 min 10 s left" in seen
        assert "5 of 12 pictures have a pose" in seen
        window.wait("document.querySelectorAll('#strip img').length === 12")
        assert window.errors() == []


def test_picture_that_is_gone_is_not_found(scene):
    live = LiveScene("walk")
    live.show_pictures({view.name: view.image_path.with_suffix(".gone") for view in scene.views})
    with pytest.raises(FileNotFoundError):
        live.routes["picture"]({"name": scene.views[0].name})
