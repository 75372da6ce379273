"""The page of one file in a headless browser: the renderer's picture, nothing from elsewhere."""

import base64
import dataclasses
import json
import re

import numpy as np
import pytest

import gsut
import small_run
from browser import browser
from gsut.cli import main
from gsut.formats import save_gaussians
from gsut.view import Session
from gsut.view.stage import Stage
from random_scenes import fisheye, gaussians_in_view, list_models, rng_of, small_camera
from tolerances.view import MOVING_LEVELS, MOVING_SURROUNDED_LEVELS


@pytest.fixture(scope="module")
def window():
    with browser() as window:
        yield window


def write_and_open(window, folder, stage, part=""):
    page = folder / "page.html"
    Session(stage).write_page(page, 3)
    window.open(f"file://{page}{part}")
    window.wait("document.body.dataset.frames > 0")
    return page


@pytest.mark.parametrize("background", [(0.2, 0.5, 0.1), None])
def test_page_at_rest_is_within_one_level_of_render(window, tmp_path, scene, gaussians, background):
    write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene, background))
    stored = window.read_gaussians()
    nearest = np.abs(stored.means[:, None] - gaussians.means[None]).max(axis=2).min(axis=0)
    assert len(stored) == len(gaussians) and nearest.max() < np.exp(gaussians.log_scales).min()
    for index in (0, 1):
        window.run(f"goTo({index}); state.lossless = true;")
        window.wait(f"JSON.parse(document.body.dataset.frame).view === {index}")
        window.wait("JSON.parse(document.body.dataset.frame).lossless && !busy && !wanted")
        found = window.read_canvas()[..., :3].astype(np.int64)
        row = window.run(f"return scene.views[{index}].name;")
        view = next(view for view in scene.views if view.name == row)
        assert view.turns == index
        camera = scene.cameras[view.camera_index]
        truth = gsut.render(stored, camera, view.camera_from_world, background=background)
        shown = np.rot90(gsut.rendering.to_uint8(truth.image), -view.turns)
        assert found.shape == shown.shape
        assert np.abs(found - shown).max() <= 1
        assert found.std() > 10
    assert "WebAssembly" in window.run("return $('pace').textContent;")


# A frame of a moving eye and one at rest, of one pose and size: their pixels, and what drew them.
_BOTH = """
  const read = (picture) => {
    const brush = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
    brush.drawImage(picture, 0, 0);
    return Array.from(brush.getImageData(0, 0, picture.width, picture.height).data);
  };
  const values = request(false), drawn = [];
  for (const moving of [true, false]) {
    const { picture, way } = await server.frame({ ...values, width: 192, height: 160, moving });
    drawn.push([way, read(picture)]);
  }
  return drawn;"""


@pytest.mark.parametrize("background", [(0.2, 0.5, 0.1), None])
def test_moving_picture_is_near_the_picture_at_rest(window, tmp_path, scene, gaussians, background):
    write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene, background), "#card")
    window.run("goTo(1);")  # its picture is turned
    window.wait("state.view === 1 && !busy && !wanted")
    for lens in ("dataset", "pinhole", "opencv8", "equirectangular"):
        if lens != "dataset":
            window.run(f"await makeLens({{ model: {lens!r}, fit: [192, 160] }});")
        (way, moving), (_, exact) = window.run(_BOTH)
        assert "WebGL 2" in way, lens
        off = np.subtract(moving, exact)
        assert np.std(exact) > 10, lens
        most = MOVING_LEVELS if background else MOVING_SURROUNDED_LEVELS
        assert np.sqrt(np.mean(off**2)) < most, lens


def test_page_without_a_graphics_card_moves_by_webassembly(window, tmp_path, scene, gaussians):
    write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene))
    assert "WebAssembly" in window.run(_BOTH)[0][0]


def test_eye_that_moves_does_not_wait_for_the_picture_at_rest(window, tmp_path, scene, gaussians):
    write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene), "#card")
    window.wait("!busy && !wanted")
    window.run("""
      const draw = server.draw.bind(server), held = [];
      document.release = () => held.forEach((go) => go());
      server.draw = async (...values) => {
        await new Promise((go) => held.push(go));
        return draw(...values);
      };
      redraw(false); // at rest, until it is released
      await new Promise((go) => setTimeout(go, 50));
      look(0.1, 0);""")
    window.wait("$('pace').textContent.includes('WebGL 2')")  # the picture at rest is still held
    window.run("delete server.draw; document.release();")
    window.wait("!busy && !wanted && $('pace').textContent.includes('WebAssembly')")


@pytest.mark.parametrize(("part", "word"), [("", "WebAssembly"), ("#card", "WebGL 2")])
def test_every_moving_frame_is_ordered_from_its_own_pose(window, tmp_path, scene, part, word):
    # Two Gaussians, green before red as photographed; the eye walks around them.
    one = gaussians_in_view(rng_of("walk"), fisheye(), scene.views[0].camera_from_world, 2)
    pose = scene.views[0].camera_from_world
    ahead = np.linalg.inv(pose)[:3] @ [[0.0, 0.0], [0.0, 0.0], [2.0, 2.4], [1.0, 1.0]]
    one.means[:] = ahead.T - one.origin
    one.log_scales[:] = np.log(0.4)
    one.opacity_logits[:] = 4.0
    one.sh[:] = 0.0
    one.sh[:, 0] = [[-1.5, 1.5, -1.5], [1.5, -1.5, -1.5]]
    write_and_open(window, tmp_path, Stage("two", "run", one, scene), part)
    window.run("goTo(0);")
    window.wait("JSON.parse(document.body.dataset.frame).view === 0 && !busy && !wanted")
    found = window.run(f"""
      const colors = [], frame = server.frame.bind(server);
      server.frame = async (values) => {{
        const drawn = await frame(values), {{ width, height }} = drawn.picture;
        const brush = new OffscreenCanvas(width, height).getContext("2d");
        brush.drawImage(drawn.picture, 0, 0);
        const at = [Math.floor(width / 2), Math.floor(height / 2)];
        const [red, green] = brush.getImageData(...at, 1, 1).data;
        colors.push([values.pose, red, green, drawn.way]);
        return drawn;
      }};
      state.pivot = {(ahead.mean(axis=1)).tolist()};
      for (let k = 0; k < 24; k++) {{
        orbit(Math.PI / 24, 0);
        await new Promise((done) => setTimeout(done, 30));
      }}
      server.frame = frame;
      return colors;""")
    assert any(word in way for *_, way in found)
    greens = 0
    for pose, red, green, _ in found:
        distances = np.linalg.norm(
            np.reshape(pose, (4, 4))[:3] @ np.vstack([ahead, [1, 1]]), axis=0
        )
        if abs(distances[0] - distances[1]) > 0.02:
            assert (green > red) == (distances[0] < distances[1])
            greens += green > red
    assert 3 <= greens <= len(found) - 3


def test_page_draws_every_lens_and_measures(window, tmp_path, scene, gaussians):
    write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene))
    for model in list_models():
        window.run(f"await makeLens({{ model: {model!r}, fit: windowShape() }});")
        assert window.run("return [lens.model, $('lens-error').hidden];") == [model, True]
        window.wait("!busy && !wanted")
    window.run("goTo(0); state.lossless = false;")
    window.wait("JSON.parse(document.body.dataset.frame).view === 0 && !busy && !wanted")
    for mode in ("distance", "color"):
        window.run(f"choose('modes', '{mode}');")
        window.wait(f"JSON.parse(document.body.dataset.frame).mode === '{mode}'")
    found = window.run("""
      const values = request(false), at = [values.width / 2, values.height / 2];
      return await ask("pick", { frame: values, pixel: at });""")
    assert found["point"] is None or found["distance"] > 0
    assert "WebAssembly" in window.run("return $('pace').textContent;")


def test_page_loads_nothing_and_logs_no_error(window, tmp_path, scene, gaussians):
    page = write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene))
    asked = window.run(
        "return performance.getEntriesByType('resource').map((entry) => entry.name)"
        ".filter((name) => !/^(blob|data):/.test(name));"
    )
    assert asked == []
    # Chromium's own words where there is no graphics card.
    own = ("No available adapters", "Automatic fallback to software WebGL", "GPU stall")
    assert [line for line in window.errors() if not any(word in line for word in own)] == []
    assert not re.search(r'(src|href)="http', page.read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("part", "word"), [("core", "core"), ("scene", "scene"), ("content", ""), ("texts", "texts")]
)
def test_damaged_page_says_what_is_wrong(window, tmp_path, scene, gaussians, part, word):
    page = tmp_path / "page.html"
    Session(Stage("small", "run", gaussians, scene)).write_page(page, 1)
    text = page.read_text(encoding="utf-8")
    begin = text.index(">", text.index(f'<script id="{part}"')) + 1
    end = text.index("</script>", begin)
    page.write_text(text[:begin] + text[begin : (begin + end) // 8 * 4] + text[end:])
    window.open(f"file://{page}")
    toast = "document.getElementById('toast')"  # before any script of the page runs
    window.wait(f"!{toast}.hidden")
    words = window.run(f"return {toast}.textContent;")
    assert "damaged" in words and word in words and "copy it again" in words
    assert window.run("return document.body.classList.contains('narrow');")  # no dead controls


def test_page_of_photographs_with_hostile_names_shows_them(window, tmp_path, scene, gaussians):
    name = "x<!--<script></script><script>window.hit=1</script>\u202e.png"
    named = scene.replace(views=[dataclasses.replace(view, name=name) for view in scene.views])
    write_and_open(window, tmp_path, Stage(name, "run", gaussians, named))
    assert window.run("return [scene.name, scene.views[0].name, window.hit ?? null];") == [
        name, name, None,
    ]  # fmt: skip
    assert name in window.run("return document.body.textContent;")


def test_page_of_another_scene_is_refused(window, tmp_path, scene, gaussians):
    page = tmp_path / "page.html"
    Session(Stage("small", "run", gaussians, scene)).write_page(page, 1)
    text = page.read_text(encoding="utf-8")
    core = re.search(r'<script id="core"[^>]*>([^<]*)', text).group(1)
    stored = re.search(r'<script id="scene"[^>]*>([^<]*)', text).group(1)
    page.write_text(text.replace(stored, core), encoding="utf-8")
    window.open(f"file://{page}")
    window.wait("!$('toast').hidden")
    assert "Gaussians" in window.run("return $('toast').textContent;")


def test_page_on_a_phone_comes_to_rest_and_fits_its_screen(tmp_path, scene, gaussians):
    with browser(390, 844) as phone:
        phone.devtools(
            "Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=2,
            mobile=True,
        )  # fmt: skip
        write_and_open(phone, tmp_path, Stage("small", "run", gaussians, scene))
        phone.wait("!busy && !wanted && $('canvas').width > 390")  # at rest: all of its pixels
        phone.run("look(0.1, 0);")
        phone.wait("!busy && !wanted && $('canvas').width > 390")
        assert phone.run("return document.documentElement.scrollWidth;") == 390


@pytest.mark.quick
def test_convert_writes_the_page_of_a_file(tmp_path, gaussians):
    save_gaussians(tmp_path / "a.ply", gaussians)
    assert main(["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.html")]) == 0
    assert "exact/core.js" not in (tmp_path / "b.html").read_text(encoding="utf-8")  # compressed


def test_convert_writes_title_views_and_what_a_link_shows(window, tmp_path, gaussians):
    save_gaussians(tmp_path / "a.ply", gaussians)
    poses = [np.eye(4).tolist(), small_run.inward_pose(1.0).tolist()]
    path = {"camera_from_world": poses}
    (tmp_path / "tour.json").write_text(json.dumps(path))
    (tmp_path / "start.json").write_text(json.dumps({"camera_from_world": poses[1:]}))
    given = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.html"), "--title", "A <hall>"]
    given += ["--credit", "</script><b>Ann & Bo"]
    given += [
        "--view",
        f"Start={tmp_path / 'start.json'}",
        "--view",
        f"Tour={tmp_path / 'tour.json'}",
    ]
    assert main([*given, "--address", "https://example.org/scenes/"]) == 0
    text = (tmp_path / "b.html").read_text(encoding="utf-8")
    assert '<meta property="og:title" content="A &lt;hall&gt;">' in text
    assert "walk through · &lt;/script&gt;&lt;b&gt;Ann &amp; Bo" in text and "<b>Ann" not in text
    assert '<meta property="og:image" content="https://example.org/scenes/b.jpg">' in text
    assert (tmp_path / "b.jpg").read_bytes()[:2] == b"\xff\xd8"
    window.open(f"file://{tmp_path}/b.html")
    window.wait("document.body.dataset.frames > 0 && !busy && !wanted")
    assert window.run("return document.title;") == "A <hall>"
    assert window.run("return $('credit').innerText;") == "</script><b>Ann & Bo"
    window.wait("Math.abs(poseOf(state.eye)[3] - scene.presets[0].poses[0][3]) < 1e-9")
    window.run("document.querySelectorAll('.preset')[1].click();")
    end = np.linalg.inv(poses[1])[:3, 3]
    window.wait(f"Math.hypot(...add(state.eye.c, {end.tolist()}, -1)) < 1e-6 && !busy && !wanted")


@pytest.mark.parametrize("view", ["Start", "Start=nowhere.jpg", "=a.json"])
def test_convert_refuses_a_view_that_is_not_there(capsys, tmp_path, gaussians, view):
    save_gaussians(tmp_path / "a.ply", gaussians)
    given = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.html"), "--view", view]
    assert main(given) != 0
    assert "--view" in capsys.readouterr().err and not (tmp_path / "b.html").exists()


def test_page_takes_gsut_s_and_mrcal_s_lens_files_alone(window, tmp_path, scene, gaussians):
    write_and_open(window, tmp_path, Stage("small", "run", gaussians, scene))
    for name in ("a.lens.json", "a.cameramodel", "a.yaml"):
        gsut.save_camera(small_camera("opencv8"), tmp_path / name)
        text = base64.b64encode((tmp_path / name).read_bytes()).decode()
        window.run(f"await makeLens({{ name: {name!r}, base64: {text!r} }});")
        shown = window.run(
            "return [lens.model, $('lens-error').hidden, $('lens-error').textContent];"
        )
        if name == "a.yaml":
            assert not shown[1] and "gsut camera convert" in shown[2]
        else:
            assert shown[:2] == ["opencv8", True]
            window.run("await makeLens({ model: 'pinhole', fit: windowShape() });")
