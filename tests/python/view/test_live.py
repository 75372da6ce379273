"""A training that is looked at: the same bits, drawn between its steps, paused and stopped."""

import json
import threading
import time
import urllib.request

import cv2
import numpy as np
import pytest

import gsut
import rendered_dataset
from gsut.cli import main
from gsut.view import ViewServer
from gsut.view.frame_request import MODES
from gsut.view.live import LiveTraining

STEPS = 24


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live")
    return gsut.load_dataset(rendered_dataset.write_dataset(folder, np.random.default_rng(5)))


def options():
    return gsut.TrainOptions(steps=STEPS, init="points", max_gaussians=600)


def request(scene, **changes):
    pose = scene.views[0].camera_from_world.ravel().tolist()
    camera = scene.cameras[0]
    size = {"width": camera.width, "height": camera.height}
    return {"pose": pose, "lens": 0, "quality": None, "view": 0, **size, **changes}


def pixels(reply):
    return cv2.cvtColor(cv2.imdecode(np.frombuffer(reply.content, np.uint8), 1), cv2.COLOR_BGR2RGB)


def bits(result):
    g = result.gaussians
    arrays = (g.means, g.quats, g.log_scales, g.opacity_logits, g.sh)
    return [array.tobytes() for array in arrays] + [p.tobytes() for p in poses(result.scene)]


def poses(scene):
    return [view.camera_from_world for view in scene.views]


def test_training_that_is_looked_at_has_the_same_bits(scene):
    alone = gsut.train(scene, options(), progress=False)
    live = LiveTraining(scene, options())
    seen = []

    def look(mode):
        seen.append(pixels(live.session.draw_frame(request(scene, mode=mode))))

    def watch(loop, row):
        live.watch(loop, {})  # from here on frames are drawn between steps
        looker = threading.Thread(target=look, args=(MODES[loop.step % len(MODES)],))
        looker.start()
        while looker.is_alive():
            assert live.watch(loop, {})
        looker.join()
        return live.watch(loop, row)

    watched = gsut.train(scene, options(), progress=False, watch=watch)
    live.finish(watched.gaussians)
    assert len(seen) == STEPS
    assert bits(watched) == bits(alone)
    assert len({picture.tobytes() for picture in seen}) == STEPS
    truth = gsut.render(watched.gaussians, scene.cameras[0], scene.views[0].camera_from_world)
    last = pixels(live.session.draw_frame(request(scene)))
    np.testing.assert_array_equal(last, gsut.rendering.to_uint8(truth.image))


@pytest.mark.threads
def test_eight_clients_of_a_training_leave_it_its_bits(scene):
    alone = gsut.train(scene, options(), progress=False)
    live = LiveTraining(scene, options())
    frames, ended = [], threading.Event()

    def look(address, number):
        wanted = json.dumps(request(scene, mode=MODES[number % len(MODES)])).encode()
        while not ended.is_set():
            with urllib.request.urlopen(address + "frame", wanted, timeout=60) as reply:
                frames.append(reply.read())
            with urllib.request.urlopen(address + "training", timeout=60) as reply:
                assert json.loads(reply.read())["state"] in ("training", "finished")

    with ViewServer(live.session.routes) as server:
        clients = [threading.Thread(target=look, args=(server.address, i)) for i in range(8)]

        def watch(loop, row):
            going = live.watch(loop, row)
            if loop.step == 1:
                for client in clients:
                    client.start()
            return going

        watched = gsut.train(scene, options(), progress=False, watch=watch)
        live.finish(watched.gaussians)
        ended.set()
        for client in clients:
            client.join()
    assert len(frames) >= len(clients)
    assert bits(watched) == bits(alone)


def test_a_page_that_asks_again_at_once_does_not_keep_the_training(scene):
    live, answered = LiveTraining(scene, options()), []

    def ask():
        threading.Thread(target=live._draw, args=(work,), daemon=True).start()
        while live._jobs.empty():
            time.sleep(1e-4)

    def work():
        answered.append(live._step)
        if live._step < STEPS and len(answered) < 2 * STEPS:
            ask()

    def watch(loop, row):
        if loop.step == 1:
            live.watch(loop, {})
            ask()
        return live.watch(loop, row)

    gsut.train(scene, options(), progress=False, watch=watch)
    assert answered == list(range(1, STEPS + 1))


def test_training_pauses_goes_on_and_stops_with_what_there_is(scene, tmp_path):
    live = LiveTraining(scene, options())
    told = lambda **values: live.session.routes["training"](values).content  # noqa: E731
    assert told()["state"] == "preparing"
    steps = []

    def watch(loop, row):
        steps.append(loop.step)
        if loop.step == 10:
            told(action="pause")
            threading.Thread(target=drawn_and_resumed, args=(loop,)).start()
        if loop.step == 16:
            told(action="stop")
        return live.watch(loop, row)

    paused = {}

    def drawn_and_resumed(loop):
        paused["first"] = pixels(live.session.draw_frame(request(scene)))
        paused["step"] = loop.step
        paused["told"] = told()
        told(action="resume")

    result = gsut.train(scene, options(), out=tmp_path / "run", progress=False, watch=watch)
    live.finish(result.gaussians)
    assert steps == list(range(1, 17))
    assert paused["step"] == 10
    assert paused["told"]["state"] == "paused"
    assert paused["told"]["history"][-1]["step"] == 10
    assert paused["first"].any()
    assert result.metrics["steps"] == 16
    assert "the training was stopped after 16 of 24 steps" in result.metrics["notes"]
    assert (tmp_path / "run/scene.ply").is_file()
    assert (tmp_path / "run/report.html").is_file()
    assert told()["state"] == "finished"
    with pytest.raises(gsut.InputError, match="pause, resume and stop, not 'jump'"):
        told(action="jump")
    resumed = gsut.train(scene, options(), out=tmp_path / "run", resume=True, progress=False)
    unbroken = gsut.train(scene, options(), progress=False)
    assert bits(resumed) == bits(unbroken)


def test_train_view_serves_the_finished_scene_until_the_end(scene, tmp_path, monkeypatch, capsys):
    told = {}

    def wait_for_end():
        address = next(word for word in capsys.readouterr().err.split() if "http://" in word)
        with urllib.request.urlopen(address + "training", timeout=30) as reply:
            told.update(json.loads(reply.read()))
        frame = json.dumps(request(scene)).encode()
        with urllib.request.urlopen(address + "frame", frame, timeout=30) as reply:
            told["frame"] = cv2.imdecode(np.frombuffer(reply.read(), np.uint8), 1)

    monkeypatch.setattr("gsut.cli.view.wait_for_end", wait_for_end)
    words = ["train", str(scene.path), "-o", str(tmp_path / "run"), "--steps", "8", "--quiet"]
    assert main([*words, "--view", "--serve", "127.0.0.1:0"]) == 0
    assert (told["state"], told["step"], told["steps"]) == ("finished", 8, 8)
    gaussians = gsut.formats.load_ply(tmp_path / "run/scene.ply")
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[0].camera_from_world)
    np.testing.assert_array_equal(told["frame"][..., ::-1], gsut.rendering.to_uint8(truth.image))
