"""The page in a headless browser: its pixels are the renderer's, its parts work, nothing fails."""

import numpy as np
import pytest

import gsut
from browser import WAIT_SECONDS, browser
from gsut.view import Session, ViewServer
from gsut.view.stage import Stage
from held_frames import hold_frames
from random_scenes import list_models


@pytest.fixture(scope="module")
def window(scene, gaussians):
    session = Session(Stage("small", "run", gaussians, scene))
    with browser() as window, ViewServer(session.routes) as server:
        window.open(server.address)
        window.wait("document.body.dataset.frames > 0")
        yield window


def test_lossless_canvas_has_the_bits_of_render(window, scene, gaussians):
    window.run("goTo(1); state.lossless = true;")
    window.wait("JSON.parse(document.body.dataset.frame).view === 1")
    window.wait("JSON.parse(document.body.dataset.frame).lossless")
    found = window.read_canvas()
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[1].camera_from_world)
    np.testing.assert_array_equal(found[..., :3], gsut.rendering.to_uint8(truth.image))
    assert np.all(found[..., 3] == 255)
    window.run("state.lossless = false; redraw();")


def test_frame_of_a_moved_eye_is_ordered_from_there(window, scene, gaussians):
    window.run("goTo(1); state.lossless = true;")
    window.wait("state.view === 1 && !busy && !wanted")
    window.run("move(1.5, 0.2, 1); look(0.7, 0.1);")
    window.wait("JSON.parse(document.body.dataset.frame).view === null && !busy && !wanted")
    window.wait("JSON.parse(document.body.dataset.frame).lossless")
    pose = np.reshape(window.run("return poseOf(state.eye);"), (4, 4))
    truth = gsut.render(gaussians, scene.cameras[0], pose)
    np.testing.assert_array_equal(
        window.read_canvas()[..., :3], gsut.rendering.to_uint8(truth.image)
    )
    window.run("state.lossless = false; redraw();")


def test_eye_moves_while_a_large_exact_frame_is_drawn(window, monkeypatch):
    going, moved = hold_frames(monkeypatch, lambda _, request: request.is_large, WAIT_SECONDS)
    window.run("state.lossless = true; await makeLens({ model: 'pinhole', fit: [16000, 1000] });")
    assert going.wait(WAIT_SECONDS)
    before = int(window.run("return document.body.dataset.frames;"))
    window.run("look(0.1, 0);")
    window.wait(f"document.body.dataset.frames > {before}")
    assert not window.run("return JSON.parse(document.body.dataset.frame).lossless;")
    moved.set()
    window.run("state.lossless = false; goTo(1);")
    window.wait("state.view === 1 && !busy && !wanted")


def test_photograph_of_a_phone_held_upright_stands_upright(window, scene, gaussians):
    window.run("goTo(3); state.lossless = true;")
    window.wait("JSON.parse(document.body.dataset.frame).view === 3")
    window.wait("JSON.parse(document.body.dataset.frame).lossless && !busy && !wanted")
    found = window.read_canvas()
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[3].camera_from_world)
    expected = np.rot90(gsut.rendering.to_uint8(truth.image), -1)
    np.testing.assert_array_equal(found[..., :3], expected)
    window.run("state.lossless = false; redraw();")


def test_page_moves_by_keys_and_pointer_and_compares(window):
    window.run("goTo(0); choose('compare', 'wipe');")
    window.wait("JSON.parse(document.body.dataset.frame).view === 0 && !$('photo').hidden")
    assert not window.run("return $('wipe').hidden;")
    before = window.run("return state.eye.c;")
    window.run("""
      const key = (type) => dispatchEvent(new KeyboardEvent(type, { code: "KeyW", bubbles: true }));
      document.body.dispatchEvent(new KeyboardEvent("keydown", { code: "KeyW", bubbles: true }));
      await new Promise((done) => setTimeout(done, 300));
      key("keyup");""")
    assert np.linalg.norm(np.subtract(window.run("return state.eye.c;"), before)) > 0
    assert window.run("return $('photo').hidden && state.view === null;")
    turned = window.run("""
      const before = [...state.eye.R], canvas = $("canvas"), box = canvas.getBoundingClientRect();
      const at = (type, x) => canvas.dispatchEvent(new PointerEvent(type, {
        pointerId: 1, clientX: box.left + x, clientY: box.top + 40, bubbles: true }));
      canvas.setPointerCapture = () => {};
      at("pointerdown", 40); at("pointermove", 50); at("pointermove", 90); at("pointerup", 90);
      return Math.hypot(...state.eye.R.map((value, k) => value - before[k]));""")
    assert turned > 0.05
    window.wait("!busy && !wanted")


def test_two_fingers_move_sideways_and_forward(window):
    window.run("goTo(0);")
    window.wait("JSON.parse(document.body.dataset.frame).view === 0 && !busy && !wanted")
    sideways, forward = window.run("""
      const canvas = $("canvas"), box = canvas.getBoundingClientRect();
      canvas.setPointerCapture = () => {};
      const at = (type, id, x, y) => canvas.dispatchEvent(new PointerEvent(type, {
        pointerId: id, pointerType: "touch", clientX: box.left + x, clientY: box.top + y }));
      const moved = (from) => add(state.eye.c, from, -1);
      const begin = () => { at("pointerdown", 11, 60, 60); at("pointerdown", 12, 120, 60); };
      const end = () => { at("pointerup", 11, 0, 0); at("pointerup", 12, 0, 0); };
      let from = [...state.eye.c];
      begin();
      for (let k = 1; k <= 8; k++) {
        at("pointermove", 11, 60 + 4 * k, 60);
        at("pointermove", 12, 120 + 4 * k, 60);
      }
      end();
      const right = dot(moved(from), column(state.eye.R, 0)) / norm(moved(from));
      from = [...state.eye.c];
      begin();
      for (let k = 1; k <= 8; k++) {
        at("pointermove", 11, 60 - 3 * k, 60);
        at("pointermove", 12, 120 + 3 * k, 60);
      }
      end();
      return [right, dot(moved(from), column(state.eye.R, 2)) / norm(moved(from))];""")
    assert sideways < -0.8  # the scene follows the fingers
    assert forward > 0.8
    window.wait("!busy && !wanted")


@pytest.mark.parametrize(
    ("least_ms", "whole_ms", "levels"),
    [(5, 20, [5]), (10, 100, [4]), (10, 150, [3, 4]), (30, 900, [0]), (200, 400, [0])],
)
def test_moving_frames_are_as_large_as_the_machine_keeps_up(window, least_ms, whole_ms, levels):
    found, slow = window.run(f"""
      const began = level, seen = new Set(), made = new Set();
      let slow = 0;
      took.length = 0;
      level = 3;
      for (let k = 0; k < 600; k++) {{
        const extra = made.has(level) ? 0 : 400; // the camera of a new size
        made.add(level);
        const ms = {least_ms} + {whole_ms} * SCALES.small[level] ** 2 + extra;
        if (k >= 300) seen.add(level);
        if (k >= 300 && level > 0) slow += ms > SLOW_MS;
        chooseLevel(ms);
      }}
      took.length = 0;
      level = began;
      return [[...seen].sort(), slow];""")
    assert found == levels
    assert slow < 30


def test_plain_lens_fills_the_window(window):
    window.run("$('lens').value = 'fill'; $('lens').dispatchEvent(new Event('change'));")
    window.wait("lens.model === 'pinhole'")
    shape = window.run("return [lens.width / lens.height, windowShape()[0] / windowShape()[1]];")
    assert shape[0] == pytest.approx(shape[1], rel=0.01)
    window.wait("!busy && !wanted")


def test_every_model_is_chosen_without_an_error(window):
    for model in list_models():
        window.run(f"await makeLens({{ model: {model!r}, fit: windowShape() }});")
        assert window.run("return [lens.model, $('lens-error').hidden];") == [model, True]
    window.run("await makeLens({ id: lens.id, params: [-1] });")
    assert "hidden" not in window.run("return $('lens-error').outerHTML;")
    window.wait("!busy && !wanted")


def test_small_window_shows_the_picture_without_scrolling(window):
    window.resize(500, 700)
    window.wait("innerWidth <= 760")
    box = window.run("const b = $('canvas').getBoundingClientRect(); return [b.width, b.height];")
    assert min(box) > 100
    assert window.run("return document.documentElement.scrollWidth <= innerWidth;")
    window.resize(1280, 800)


def test_page_asks_nobody_else_and_logs_no_error(window):
    asked = window.run(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
        ".filter((name) => !name.startsWith(location.origin) && !/^(blob|data):/.test(name));"
    )
    assert asked == []
    # A lens that cannot be is refused with status 400, which browsers log by themselves.
    assert [line for line in window.errors() if "400" not in line] == []
