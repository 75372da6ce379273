"""The page in a headless browser: its pixels are the renderer's, its parts work, nothing fails."""

import numpy as np
import pytest

import gsut
import small_run
from browser import browser
from gsut.view import Session, Stage, ViewServer
from random_scenes import fisheye, gaussians_in_view, rng_of

_PIXELS = """
  const canvas = document.getElementById("canvas");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return [canvas.width, canvas.height, Array.from(data)];"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_run.make_scene(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module")
def gaussians(scene):
    return gaussians_in_view(rng_of("view"), fisheye(), scene.views[0].camera_from_world, 300)


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
    width, height, data = window.run(_PIXELS)
    found = np.array(data, np.uint8).reshape(height, width, 4)
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[1].camera_from_world)
    np.testing.assert_array_equal(found[..., :3], gsut.to_uint8(truth.image))
    assert np.all(found[..., 3] == 255)
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


def test_every_model_is_chosen_without_an_error(window):
    for model in gsut.camera_models():
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
