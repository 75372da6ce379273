"""Frames: the renderer's own pixels, and what is drawn over and made of them."""

import base64
import concurrent.futures
import dataclasses
import json

import cv2
import numpy as np
import pytest

import gsut
import small_run
from gsut.data.poses import read_path
from gsut.lens import measure_field_of_view, with_field_of_view
from gsut.lens.files import camera_from_values
from gsut.render import Falloff, Light, PixelFilter, to_uint8
from gsut.view import Session
from gsut.view.frame_request import MODES
from gsut.view.frames import _draw_normals
from gsut.view.lenses import Lenses
from gsut.view.overlays import make_frustum
from gsut.view.stage import Stage
from random_scenes import every_lens, fisheye, gaussians_in_view, pinhole, rng_of
from tolerances.view import FIELD_OF_VIEW_DEGREES, PICKED_POINT

SIZE = small_run.SIZE


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Photographs of what the Gaussians show, the last with a rolling shutter."""
    scene = small_run.scene_from_arrays(tmp_path_factory.mktemp("view"))
    view = scene.views[5]
    twist = gsut.exp_pose(np.array([0.05, 0.02, 0, 0, 0.03, 0]))
    rolling = dataclasses.replace(
        view, camera_from_world_start=np.linalg.inv(twist) @ view.camera_from_world,
        camera_from_world_end=twist @ view.camera_from_world,
        shutter=gsut.Shutter("top_to_bottom"),
    )  # fmt: skip
    points = rng_of("points").normal(size=(50, 3))
    return scene.replace(
        views=(*scene.views[:5], rolling), points=points,
        point_colors=np.full((50, 3), 200, np.uint8),
    )  # fmt: skip


@pytest.fixture(scope="module")
def gaussians(scene):
    return gaussians_in_view(rng_of("view"), fisheye(), scene.views[0].camera_from_world, 300)


@pytest.fixture
def session(scene, gaussians):
    return Session(Stage("small", "run", gaussians, scene, (0.1, 0.2, 0.3)))


def wanted(scene, index=0, **changes):
    pose = scene.views[index].camera_from_world.ravel().tolist()
    values = {"pose": pose, "lens": 0, "width": SIZE, "height": SIZE, "view": index}
    return {**values, "quality": None, **changes}


def pixels(reply):
    return cv2.cvtColor(cv2.imdecode(np.frombuffer(reply.content, np.uint8), 1), cv2.COLOR_BGR2RGB)


def test_a_frame_in_a_photograph_has_its_light_and_none_elsewhere(scene, gaussians):
    falloff = Falloff(1.5, np.tile([-0.5, 0.0, 0.0], (3, 1)))
    light = Light(np.linspace(0.5, 1.5, 3 * len(scene.views)).reshape(-1, 3), (falloff,))
    stage = Stage("small", "run", gaussians, scene, (0.1, 0.2, 0.3), light=light)
    session = Session(stage)
    plain = gsut.render(
        gaussians, scene.cameras[0], scene.views[1].motion, background=(0.1, 0.2, 0.3)
    ).image
    lit = to_uint8(plain * light.on(scene.cameras[0], 1, 0))
    assert np.array_equal(pixels(session.draw_frame(wanted(scene, 1))), lit)
    elsewhere = pixels(session.draw_frame(wanted(scene, 1, view=None)))
    assert np.array_equal(elsewhere, to_uint8(plain))
    assert not np.array_equal(lit, elsewhere)


def test_a_frame_coarser_than_the_photographs_is_filtered_once_it_rests(session, scene, gaussians):
    side = 3 * SIZE // 4
    small = {"width": side, "height": side}
    camera, pose = scene.cameras[0].resize(side, side), scene.views[0].camera_from_world
    lenses = [scene.camera(row) for row in scene.train_indices]
    filtered = PixelFilter(gaussians, lenses, scene.poses(scene.train_indices)).widen(camera, pose)
    shown = [
        to_uint8(gsut.render(each, camera, pose, background=(0.1, 0.2, 0.3)).image)
        for each in (filtered, gaussians)
    ]
    assert np.abs(shown[0].astype(int) - shown[1]).max() > 1
    still = session.frames.draw(session._request(wanted(scene, **small, quality=92)))
    moving = session.frames.draw(session._request(wanted(scene, **small, quality=75)))
    assert np.abs(still.image.astype(int) - shown[0]).max() <= 1
    assert np.abs(moving.image.astype(int) - shown[1]).max() <= 1


@pytest.mark.threads
def test_small_and_large_frames_at_once_have_the_bits_of_each_alone(session, scene, monkeypatch):
    monkeypatch.setattr("gsut.view.frame_request._LARGE_PIXELS", SIZE * SIZE)
    asked = [
        wanted(scene, row % 6, width=side, height=side, **more)
        for row in range(12)
        for more in ({"share": 0.5}, {"mode": "distance"}, {"layers": ["domain"]})
        for side in (SIZE, 2 * SIZE)
    ]  # fmt: skip
    alone = [session.draw_frame(values).content for values in asked]
    fresh = Session(session.stage)
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        at_once = list(pool.map(lambda values: fresh.draw_frame(values).content, asked))
    assert len(asked) == 72 and len(set(alone)) > 30
    assert at_once == alone


def drawn(session, scene, index=0, **changes):
    reply = session.draw_frame(wanted(scene, index, **changes))
    assert reply.kind == "image/png"
    return pixels(reply)


@pytest.mark.parametrize(("name", "camera"), every_lens(32))
def test_frame_has_the_bits_of_render_through_every_lens(session, scene, gaussians, name, camera):
    number = session.lenses.add(camera)
    found = drawn(session, scene, lens=number, width=camera.width, height=camera.height)
    pose = scene.views[0].camera_from_world
    truth = gsut.render(gaussians, camera, pose, background=(0.1, 0.2, 0.3))
    np.testing.assert_array_equal(found, gsut.rendering.to_uint8(truth.image))


def test_frame_at_a_photograph_has_its_rolling_shutter(session, scene, gaussians):
    truth = gsut.render(
        gaussians, scene.cameras[0], scene.views[5].motion, background=(0.1, 0.2, 0.3)
    )
    found = drawn(session, scene, 5, shutter=5)
    np.testing.assert_array_equal(found, gsut.rendering.to_uint8(truth.image))
    assert np.any(found != drawn(session, scene, 5))


def test_rolling_shutter_goes_along_with_the_free_eye(session, scene, gaussians):
    moved = scene.views[5].camera_from_world @ gsut.exp_pose(np.array([0.2, 0, 0, 0, 0, 0.3]))
    view = scene.views[5]
    there = np.linalg.inv(view.camera_from_world) @ moved
    motion = gsut.CameraMotion(
        view.camera_from_world_start @ there, view.camera_from_world_end @ there, view.shutter
    )
    truth = gsut.render(gaussians, scene.cameras[0], motion, background=(0.1, 0.2, 0.3))
    found = drawn(session, scene, 5, shutter=5, view=None, pose=moved.ravel().tolist())
    off = np.abs(found.astype(int) - gsut.rendering.to_uint8(truth.image))
    assert off.max() <= 1  # a byte's rounding: the motion is composed in another order


def test_every_mode_is_drawn(session, scene):
    pictures = [drawn(session, scene, mode=mode) for mode in MODES]
    assert len(pictures) == 6
    assert len({picture.tobytes() for picture in pictures}) == len(MODES)
    assert all(picture.any() for picture in pictures)


def test_error_is_nothing_where_the_photograph_is_the_render(session, scene, gaussians):
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[0].camera_from_world)
    session.stage.background = (0.0, 0.0, 0.0)
    path = scene.views[0].image_path.with_name("same.png")
    gsut.write_png(path, gsut.rendering.to_uint8(truth.image))
    same = dataclasses.replace(scene.views[0], image_path=path)
    session.stage.scene = scene.replace(views=(same, *scene.views[1:]))
    mask = scene.mask(0)
    found = drawn(session, scene, mode="error")
    assert found[mask].max() <= 10  # the map's first colours
    assert drawn(session, scene, 1, mode="error")[mask].max() > 100


def test_distance_tells_the_range_of_its_colours(session, scene):
    near, far = map(
        float, session.draw_frame(wanted(scene, mode="distance")).headers["X-Span"].split()
    )
    assert 0 < near < far < 20


@pytest.mark.parametrize(
    "camera", [pinhole(40), fisheye(40, degrees=150)], ids=["pinhole", "fisheye"]
)
def test_normals_of_a_plane_point_back_at_the_camera(camera):
    rays = camera.rays()[0]
    distance = np.where(rays[..., 2] > 0.3, 2 / rays[..., 2], np.nan)  # the plane z = 2
    colors = _draw_normals(np.eye(3), camera, np.eye(4), distance)[10:-10, 10:-10]
    seen = np.isfinite(distance)[10:-10, 10:-10] & (colors.max(axis=2) > 0)
    assert seen.mean() > 0.8
    assert np.abs(colors[seen].astype(int) - [128, 128, 0]).max() <= 1  # (0, 0, -1)


def test_layers_are_drawn_over_the_frame(session, scene):
    plain = drawn(session, scene)
    for layers in (["cameras"], ["points"], ["domain"]):
        assert np.any(drawn(session, scene, layers=layers) != plain), layers
    assert np.any(drawn(session, scene, marks=[[0, 0, 0], [0.5, 0, 0]]) != plain)


def test_picked_point_lies_on_the_pixels_ray_at_its_distance(session, scene, gaussians):
    pose = scene.views[0].camera_from_world
    truth = gsut.render(gaussians, scene.cameras[0], pose)
    row, column = np.unravel_index(np.argmax(truth.alpha), truth.alpha.shape)
    frame = wanted(scene)
    found = session.pick_point({"frame": frame, "pixel": [column + 0.5, row + 0.5]}).content
    ray = scene.cameras[0].unproject(np.array([[column + 0.5, row + 0.5]]))[0][0]
    distance = truth.depth[row, column] / truth.alpha[row, column]
    assert found["distance"] == pytest.approx(distance, rel=PICKED_POINT)
    in_camera = pose[:3, :3] @ found["point"] + pose[:3, 3]
    np.testing.assert_allclose(in_camera, ray * distance, atol=PICKED_POINT)
    np.testing.assert_allclose(found["in_dataset"], found["point"] + scene.world_offset)
    assert session.pick_point({"frame": frame, "pixel": [0.5, 0.5]}).content == {"point": None}


def test_camera_of_a_screenshot_is_a_path_that_render_takes(session, scene, tmp_path):
    pose = scene.views[2].camera_from_world
    reply = session.save_cameras(
        {"poses": [pose.ravel().tolist()], "lens": 0, "width": 64, "height": 64}
    )
    path = tmp_path / "camera.json"
    path.write_bytes(reply.content)
    np.testing.assert_allclose(read_path(path, scene.world_offset)[0], pose, atol=1e-12)
    assert camera_from_values(json.loads(reply.content)["lens"]) == scene.cameras[0].resize(64, 64)


def test_photograph_is_shrunk_and_its_mask_tinted(session, scene):
    small = pixels(session.send_photograph({"view": 0, "side": 16}))
    assert small.shape == (16, 16, 3)
    assert np.any(pixels(session.send_photograph({"view": 0, "side": 16, "mask": 1})) != small)


def test_scene_tells_what_the_page_needs(session, scene):
    value = session.describe_scene({}).content
    assert [view["held_out"] for view in value["views"]] == [i in (0, 3) for i in range(6)]
    assert value["views"][5]["rolling"] and not value["views"][0]["rolling"]
    np.testing.assert_allclose(value["up"], [0, 0, 1], atol=1e-9)  # cameras stand in a circle
    assert set(value["models"]) == set(gsut.lens.camera_models())


def test_file_without_cameras_is_seen_from_the_outside(gaussians):
    session = Session(Stage("a.ply", "file", gaussians))
    value = session.describe_scene({}).content
    request = {
        "pose": value["pose"].tolist(),
        "lens": 0,
        "width": 40,
        "height": 30,
        "quality": None,
    }
    assert pixels(session.draw_frame(request)).max() > 60


def test_share_draws_the_gaussians_that_are_seen_most(session, scene, gaussians):
    whole, half = (drawn(session, scene, share=share) for share in (1, 0.5))
    assert np.any(whole != half)
    assert gsut.psnr(half / 255, whole / 255) > gsut.psnr(np.zeros(whole.shape), whole / 255)


# Lenses.


@pytest.mark.parametrize(("name", "camera"), every_lens(40))
def test_every_lens_is_described_and_its_field_set(name, camera):
    lenses = Lenses([camera])
    value = lenses.describe(0)
    assert len(value["sliders"]) <= 24
    assert all(row["low"] <= row["value"] <= row["high"] for row in value["sliders"])
    across = value["field_of_view"]
    if value["can_zoom"] and across:
        try:
            zoomed = with_field_of_view(camera, 0.7 * across)
        except gsut.InputError as error:
            assert "cannot span" in str(error)
            return
        assert measure_field_of_view(zoomed) == pytest.approx(
            0.7 * across, abs=FIELD_OF_VIEW_DEGREES
        )


@pytest.mark.parametrize("model", gsut.lens.camera_models())
def test_any_model_fits_the_window(model):
    lenses = Lenses([pinhole(40)])
    value = lenses.describe(lenses.make({"model": model, "fit": [900, 600]}))
    assert value["model"] == model
    if "cx" in value["sliders"][0:4].__repr__() and model != "splined_stereographic":
        assert value["width"] / value["height"] == pytest.approx(1.5, rel=0.01)


def test_lens_of_a_slider_keeps_the_other_parameters():
    lenses = Lenses([fisheye(40)])
    params = list(fisheye(40).params)
    number = lenses.make({"id": 0, "params": [2 * params[0]]})
    assert lenses.describe(number)["params"] == [2 * params[0], *params[1:]]


def test_frustum_reaches_where_the_lens_sees():
    camera = fisheye(40)
    rays = make_frustum(camera)
    assert rays.shape == (8, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-12)
    assert camera.project(rays)[1].all()


@pytest.mark.parametrize("name", ["a.lens.json", "cameras.bin", "cameras.txt"])
def test_uploaded_lens_file_is_read(tmp_path, name):
    gsut.save_camera(fisheye(40), tmp_path / name)
    content = base64.b64encode((tmp_path / name).read_bytes()).decode()
    lenses = Lenses([pinhole(40)])
    value = lenses.describe(lenses.make({"name": name, "base64": content}))
    assert (value["model"], value["width"]) == ("kannala_brandt", 40)
    np.testing.assert_allclose(value["params"][:4], fisheye(40).params)


def test_large_frame_gives_its_memory_back(session, scene, monkeypatch):
    monkeypatch.setattr("gsut.view.frames.MOST_KEPT", (2 * SIZE) ** 2)
    monkeypatch.setattr("gsut.view.lenses.MOST_KEPT", (2 * SIZE) ** 2)
    session.draw_frame(wanted(scene, width=2 * SIZE, height=2 * SIZE))
    assert session.frames._buffers and session.lenses._resized
    session.draw_frame(wanted(scene, width=3 * SIZE, height=3 * SIZE))
    assert session.frames._buffers == ()
    assert [size[1] for size in session.lenses._resized] == [2 * SIZE]


def test_file_of_gaussians_is_first_shown_from_where_it_is_clear():
    # A coloured ball inside a shell of large dull Gaussians: from outside only the shell is seen.
    rng = rng_of("first pose")
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radii = np.where(np.arange(5000) < 4000, 1.0, 4.0)[:, None]
    colors = np.where(radii < 2.0, rng.uniform(-1.5, 1.5, (5000, 3)), 0.0)
    gaussians = gsut.Gaussians(
        radii * directions + [10.0, 0.0, -5.0], np.tile([1.0, 0.0, 0.0, 0.0], (5000, 1)),
        np.log(np.repeat(np.where(radii < 2.0, 0.03, 0.6), 3, axis=1)), np.full(5000, 4.0),
        colors[:, None, :],
    )  # fmt: skip
    stage = Stage("ball", "file", gaussians)
    place = stage.place()
    eye = np.linalg.inv(place["pose"])[:3, 3]
    assert np.linalg.norm(eye - [10.0, 0.0, -5.0]) < 3.9
    np.testing.assert_allclose(place["center"], [10.0, 0.0, -5.0], atol=0.1)
    assert stage.place()["pose"] is place["pose"]  # looked for once


def test_stage_without_gaussians_has_a_first_pose():
    assert np.linalg.inv(Stage("none", "file").place()["pose"])[2, 3] == -2.5
