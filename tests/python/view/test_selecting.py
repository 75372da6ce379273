"""Selecting by hand in the page: the right Gaussians, pictures, undo, files, on any screen."""

import base64
import contextlib

import numpy as np
import pytest

import gsut
from browser import browser
from gsut.cli import main
from gsut.hand_edits import apply_edits, read_edits
from gsut.view import Session, ViewServer
from gsut.view.stage import Stage

COUNT = 300  # Gaussians
SCREENS = {"desktop": (1280, 800), "phone": (390, 844)}
# Left, top, right, bottom of a box on the picture, shares of its width.
BOX = np.array([0.3, 0.25, 0.6, 0.7])
WHERE = """
  const box = $("canvas").getBoundingClientRect();
  return [box.left, box.top, box.width];"""


@contextlib.contextmanager
def open_page(screen, scene, gaussians):
    """A window that shows the scene."""
    session = Session(Stage("small", "run", gaussians, scene))
    with contextlib.ExitStack() as stack:
        window = stack.enter_context(browser(*SCREENS[screen]))
        width, height = SCREENS[screen]
        window.devtools(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
            mobile=screen == "phone",
        )  # fmt: skip
        window.devtools("Emulation.setTouchEmulationEnabled", enabled=screen == "phone")
        window.open(stack.enter_context(ViewServer(session.routes)).address)
        window.wait("document.body.dataset.frames > 0")
        yield window


def go_to(window, index):
    window.run(f"goTo({index});")
    window.wait(f"JSON.parse(document.body.dataset.frame).view === {index} && !busy && !wanted")


def drag(window, screen, *points):
    """Moves a pressed mouse, or a finger, through points of the window."""
    for number, (x, y) in enumerate([*points, points[-1]]):
        last = number == len(points)
        if screen == "phone":
            kind = "touchEnd" if last else "touchMove" if number else "touchStart"
            touched = [] if last else [{"x": x, "y": y}]
            window.devtools("Input.dispatchTouchEvent", type=kind, touchPoints=touched)
        else:
            kind = "mouseReleased" if last else "mouseMoved" if number else "mousePressed"
            window.devtools(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1,
                clickCount=1,
            )  # fmt: skip


def click(window, button):
    window.run(f"$('{button}').click();")
    settle(window)


def settle(window):
    window.run("await editing.catch(() => {});")
    window.wait("!busy && !wanted")


def read_still(window):
    settle(window)
    window.wait("!busy && !wanted && performance.now() - lastMove > 2 * REST_MS")
    window.run("redraw(false);")
    window.wait("!busy && !wanted")
    return window.read_canvas()[..., :3]


def find_in_box(stored, camera, pose, box):
    """Which Gaussians have their centres in a box of pixels, by projection alone."""
    places = (stored.means + stored.origin) @ pose[:3, :3].T + pose[:3, 3]
    pixels, valid = camera.project(places)
    x, y = np.nan_to_num(pixels, nan=-1.0).T
    left, top, right, bottom = box
    return valid & (x >= left) & (x <= right) & (y >= top) & (y <= bottom)


@pytest.mark.parametrize("screen", SCREENS)
def test_box_selects_deletes_undoes_and_repeats(screen, tmp_path, scene, gaussians):
    with open_page(screen, scene, gaussians) as window:
        go_to(window, 0)
        click(window, "select")
        assert window.run("return document.documentElement.scrollWidth;") == SCREENS[screen][0]
        off_screen = window.run("""
          return [...document.querySelectorAll("#selecting button, #selecting label")]
            .map((element) => element.getBoundingClientRect())
            .filter(({ width, left, right }) => width && (left < 0 || right > innerWidth)).length;
        """)
        assert off_screen == 0
        before = read_still(window)
        left, top, width = window.run(WHERE)
        corners = np.round(BOX * width) + np.array([left, top, left, top])
        drag(window, screen, corners[:2], corners[2:])
        settle(window)
        box = (corners - np.array([left, top, left, top])) * 32 / width
        inside = find_in_box(gaussians, scene.cameras[0], scene.views[0].camera_from_world, box)
        assert 10 < inside.sum() < COUNT - 10
        assert window.run("return [edits.selected, edits.kept];") == [inside.sum(), COUNT]
        tinted = read_still(window)
        assert np.abs(tinted.astype(int) - before).max() > 30

        click(window, "edit-delete")
        assert window.run("return [edits.selected, edits.kept];") == [0, COUNT - inside.sum()]
        window.run("state.lossless = true;")
        found = read_still(window).astype(int)
        pose = scene.views[0].camera_from_world
        shown = gsut.render(gaussians[~inside], scene.cameras[0], pose).image
        np.testing.assert_array_equal(found, gsut.rendering.to_uint8(shown))
        window.run("state.lossless = false;")
        for _ in range(2):
            click(window, "undo")
        np.testing.assert_array_equal(read_still(window), before)
        for _ in range(2):
            click(window, "redo")
        check_files(window, tmp_path, scene, gaussians, inside)
        own = ("No available adapters", "software WebGL", "GPU stall")  # Chromium's, without a card
        assert [line for line in window.errors() if not any(word in line for word in own)] == []


def read_blob(window, name, values):
    text = window.run(f"""
      const bytes = new Uint8Array(await (await server.file("{name}", {values})).arrayBuffer());
      return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));""")
    return base64.b64decode(text)


def check_files(window, folder, scene, gaussians, inside):
    edits = folder / "page.edits.json"
    edits.write_bytes(read_blob(window, "edits.json", "{ steps: edits.steps }"))
    placed = gaussians.translate(scene.world_offset)
    np.testing.assert_array_equal(apply_edits(placed, read_edits(edits)), ~inside)
    gsut.formats.save_ply(folder / "run.ply", placed)
    words = ["edit", str(folder / "run.ply"), "--apply", str(edits)]
    assert main([*words, "-o", str(folder / "repeated.ply")]) == 0
    repeated = gsut.load_gaussians(folder / "repeated.ply")
    assert len(repeated) == COUNT - inside.sum()


def test_page_selects_as_the_file_says(tmp_path, scene, gaussians):
    with open_page("desktop", scene, gaussians) as window:
        click(window, "select")
        go_to(window, window.run("return scene.views.findIndex((view) => view.turns);"))
        left, top, width = window.run(WHERE)
        at = lambda x, y: (left + x * width, top + y * width)  # noqa: E731
        window.run("choose('tools', 'lasso');")
        drag(window, "desktop", at(0.2, 0.2), at(0.8, 0.3), at(0.5, 0.9), at(0.4, 0.4))
        settle(window)
        window.run("choose('tools', 'brush'); $('front').checked = true;")
        drag(window, "desktop", at(0.1, 0.5), at(0.9, 0.55))
        settle(window)
        window.run("choose('how', 'subtract'); $('front').checked = false;")
        drag(window, "desktop", at(0.5, 0.3), at(0.5, 0.6))
        settle(window)
        window.run("await makeLens({ model: 'equirectangular' });")
        window.run("choose('tools', 'box'); choose('how', 'add');")
        window.wait("!busy && !wanted")
        left, top, width = window.run(WHERE)
        drag(window, "desktop", at(0.01, 0.2), at(0.12, 0.3))
        settle(window)
        selected = window.run("return edits.selected;")
        assert window.run("return edits.steps.length;") == 4
        window.run("await edit({ do: 'keep' });")
        kept = window.run("return edits.kept;")
        assert 0 < selected == kept < COUNT
        path = tmp_path / "some.edits.json"
        path.write_bytes(read_blob(window, "edits.json", "{ steps: edits.steps }"))
        edits = read_edits(path)
        assert [edit.get("front", False) for edit in edits] == [False, True, False, False, False]
        assert apply_edits(gaussians.translate(scene.world_offset), edits).sum() == kept


def test_keys_and_a_second_finger_leave_no_stroke(scene, gaussians):
    with open_page("phone", scene, gaussians) as window:
        click(window, "select")
        left, top, width = window.run(WHERE)
        one, two = ({"x": left + share * width, "y": top + 0.5 * width} for share in (0.3, 0.7))
        send = lambda kind, *fingers: window.devtools(  # noqa: E731
            "Input.dispatchTouchEvent", type=kind,
            touchPoints=[{**each, "id": k} for k, each in enumerate(fingers)],
        )  # fmt: skip
        send("touchStart", one)
        assert window.run("return stroke !== null;")
        send("touchStart", one, two)
        eye = window.run("return String(state.eye.c);")
        send("touchMove", {**one, "x": one["x"] - 30}, {**two, "x": two["x"] + 30})
        send("touchEnd")
        assert window.run("return [stroke, pointers.size, edits.steps.length];") == [None, 0, 0]
        assert window.run("return String(state.eye.c);") != eye
        press = lambda code, **more: window.run(  # noqa: E731
            f"dispatchEvent(Object.assign(new KeyboardEvent('keydown', {{ code: '{code}', "
            f"ctrlKey: {str(more.get('ctrl', False)).lower()} }})));"
        )
        press("KeyN")
        eye = window.run("return String(state.eye.R);")
        drag(window, "phone", (one["x"], one["y"]), (two["x"], two["y"]))
        assert window.run("return String(state.eye.R);") != eye  # it looks around
        go_to(window, 0)
        press("KeyB")
        left, top, width = window.run(WHERE)
        drag(window, "phone", (left + 1, top + 1), (left + width - 1, top + width - 1))
        settle(window)
        assert window.run("return edits.selected;") > 0
        press("Delete")
        settle(window)
        press("KeyZ", ctrl=True)
        settle(window)
        assert window.run("return [edits.selected > 0, edits.kept];") == [True, COUNT]
        press("Escape")
        settle(window)
        assert window.run("return [edits.on, edits.selected, $('selecting').hidden];") == [
            False, 0, True,
        ]  # fmt: skip
