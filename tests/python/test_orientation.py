"""Upright pictures: all orientations of EXIF, and quarter turns of pixels, cameras and paths."""

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

import gsut
from gsut.capture.photographs import collect_photographs
from gsut.data import load_dataset, write_transforms
from gsut.data.images import decode_image, read_header
from gsut.data.listing import Frame
from gsut.data.scene import find_up
from gsut.lens import Camera
from gsut.orientation import count_turns, turn_camera, turn_picture, turn_pixel, turn_size
from gsut.render import make_orbit_path, make_tour_path, smooth_path, write_png
from gsut.view import Session
from gsut.view.stage import Stage
from random_scenes import gaussians_in_view, rng_of
from small_run import inward_pose
from tolerances.view import JPEG_LEVELS, LEVEL_HORIZON

WIDTH, HEIGHT = 60, 40


def corners():
    """A picture of four colours, one a quarter: no turn or mirror leaves it as it is."""
    colors = np.array([[[230, 20, 20], [20, 230, 20]], [[20, 20, 230], [230, 230, 20]]], np.uint8)
    return colors.repeat(HEIGHT // 2, axis=0).repeat(WIDTH // 2, axis=1)


def save_photograph(path, orientation):
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    exif[0x0112] = orientation
    more = {"quality": 95}
    if path.suffix == ".webp":  # two kinds of pixels, whose headers differ
        more["lossless"] = orientation % 2 == 0
    elif path.suffix == ".jpg":
        more["subsampling"] = 0
    elif path.suffix == ".heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    Image.fromarray(corners()).save(path, exif=exif, **more)
    return ImageOps.exif_transpose(Image.open(path))


def differ(a, b):
    return np.abs(a.astype(int) - b.astype(int)).mean()


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".jpg", ".tiff", ".webp", ".heic"])
def test_photograph_of_each_orientation_is_shown_as_exif_says(tmp_path, orientation, suffix):
    truth = np.asarray(save_photograph(tmp_path / f"p/a{suffix}", orientation))
    taken = collect_photographs([tmp_path / "p"], tmp_path / "out")
    row = taken.figures["frames"][0]
    pixels = decode_image(taken.path / row["path"])[0]
    shown = turn_picture(pixels, count_turns(row["orientation"]))
    assert shown.shape == truth.shape
    assert differ(shown, truth) < JPEG_LEVELS
    header = read_header(taken.path / row["path"])
    if suffix in (".jpg", ".webp"):
        assert header[:2] == (pixels.shape[1], pixels.shape[0])
        assert header.orientation == row["orientation"] in (1, 3, 6, 8)
    strip = cv2.imread(str(taken.path / "strip.jpg"))[:96, :, ::-1]
    wide = round(96 * truth.shape[1] / truth.shape[0])
    assert differ(strip[:, :wide], cv2.resize(truth, (wide, 96))) < JPEG_LEVELS


def test_heading_of_a_turned_copy_is_in_its_file(tmp_path):
    for name, orientation in (("a", 1), ("b", 1), ("c", 6)):
        save_photograph(tmp_path / f"p/{name}.jpg", orientation)
    upright = np.rot90(corners(), 1)
    Image.fromarray(np.ascontiguousarray(upright)).save(tmp_path / "p/d.jpg", quality=95)
    taken = collect_photographs([tmp_path / "p"], tmp_path / "out")
    found = [read_header(taken.path / row["path"]).orientation for row in taken.figures["frames"]]
    assert found == [row["orientation"] for row in taken.figures["frames"]] == [1, 1, 6, 6]


@pytest.mark.parametrize("turns", range(4))
def test_png_that_is_tagged_is_shown_upright(tmp_path, turns):
    stored = np.ascontiguousarray(np.rot90(corners(), turns))
    write_png(tmp_path / "a.png", stored, turns)
    assert count_turns(read_header(tmp_path / "a.png").orientation) == turns
    np.testing.assert_array_equal(decode_image(tmp_path / "a.png")[0], stored)
    shown = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / "a.png")))
    np.testing.assert_array_equal(shown, corners())


@pytest.mark.parametrize("turns", range(-3, 4))
def test_turned_camera_sees_the_turned_picture(turns):
    pose, points = inward_pose(0.3), rng_of("turned").normal(size=(20, 3))
    lens = Camera("pinhole", [50, 50, WIDTH / 2, HEIGHT / 2], WIDTH, HEIGHT)
    width, height = turn_size(WIDTH, HEIGHT, turns)
    shown = Camera("pinhole", [50, 50, width / 2, height / 2], width, height)
    turned = turn_camera(pose, turns)
    there = lens.project(points @ pose[:3, :3].T + pose[:3, 3])[0]
    here = shown.project(points @ turned[:3, :3].T + turned[:3, 3])[0]
    expected = [turn_pixel(x, y, WIDTH, HEIGHT, turns) for x, y in there]
    np.testing.assert_array_equal(turn_camera(turned, -turns), pose)
    np.testing.assert_allclose(here, expected, rtol=1e-12)


@pytest.mark.parametrize("path", [make_tour_path, make_orbit_path, smooth_path])
def test_path_of_hand_held_cameras_is_level(path):
    rng = rng_of("level")
    keys = np.stack([
        gsut.exp_pose(np.array([*rng.normal(0, 0.15, 3), 0, 0, 0])) @ inward_pose(angle)
        for angle in np.linspace(0, 6, 20)
    ])  # fmt: skip
    up = np.array([0.0, 0.0, 1.0])
    made = path(keys, 50, up=up)
    assert np.abs(made[:, 0, :3] @ up).max() < LEVEL_HORIZON  # the picture's right is horizontal
    assert (-made[:, 1, :3] @ up).min() > 0.5


def test_path_straight_down_keeps_the_roll_of_its_photographs():
    down = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 5], [0, 0, 0, 1]])
    keys = np.stack([down, down])
    keys[1, 0, 3] = 2.0
    np.testing.assert_allclose(smooth_path(keys, 5, up=np.array([0, 1.0, 0]))[:, :3, :3],
                               np.tile(down[:3, :3], (5, 1, 1)), atol=1e-12)  # fmt: skip


def sideways_scene(folder, orientation):
    """Photographs of a phone held upright, as a dataset whose images say so."""
    lens = Camera("pinhole", [50, 50, WIDTH / 2, HEIGHT / 2], WIDTH, HEIGHT)
    turns, frames = count_turns(orientation), []
    for k in range(4):
        save_photograph(folder / f"images/{k}.jpg", orientation)
        pose = turn_camera(inward_pose(0.4 * k), -turns)
        frames.append(
            Frame(f"images/{k}.jpg", folder / f"images/{k}.jpg", lens, np.linalg.inv(pose))
        )
    write_transforms(folder / "transforms.json", frames, up=(0, 0, 1))
    return load_dataset(folder)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_viewer_shows_photographs_and_scene_upright(tmp_path, orientation):
    scene = sideways_scene(tmp_path / "data", orientation)
    turns = count_turns(orientation)
    assert [view.turns for view in scene.views] == [turns] * 4
    np.testing.assert_array_equal(find_up(scene), [0, 0, 1])
    mean = find_up(scene.replace(known_up=None))
    assert mean[2] > 0.9
    gaussians = gaussians_in_view(
        rng_of("upright"), scene.cameras[0], scene.views[1].camera_from_world, 50
    )
    session = Session(Stage("small", "run", gaussians, scene))
    told = session.describe_scene({}).content
    row = told["views"][1]
    assert told["lenses"][0]["turns"] == row["turns"] == turns
    values = {
        "pose": row["pose"].tolist(), "lens": 0, "turns": turns, "width": row["width"],
        "height": row["height"], "view": 1, "quality": None,
    }  # fmt: skip
    drawn = cv2.imdecode(np.frombuffer(session.draw_frame(values).content, np.uint8), 1)[..., ::-1]
    truth = gsut.render(gaussians, scene.cameras[0], scene.views[1].camera_from_world)
    expected = turn_picture(gsut.rendering.to_uint8(truth.image), turns)
    np.testing.assert_array_equal(drawn, expected)
    photo = session.send_photograph({"view": 1, "side": 60}).content
    shown = cv2.imdecode(np.frombuffer(photo, np.uint8), 1)[..., ::-1]
    assert differ(shown, turn_picture(scene.image(1), turns)) < JPEG_LEVELS
    y, x = np.unravel_index(np.argmax(turn_picture(truth.alpha, turns)), drawn.shape[:2])
    point = session.pick_point({"frame": values, "pixel": [x + 0.5, y + 0.5]}).content["point"]
    pose = np.reshape(row["pose"], (4, 4)) @ [*point, 1]
    at = 50 * pose[:2] / pose[2] + np.array([row["width"], row["height"]]) / 2
    np.testing.assert_allclose(at, [x + 0.5, y + 0.5], atol=1e-3)
    saved = session.save_cameras({**values, "poses": [values["pose"]]}).content
    assert (b'"turns"' in saved) == (turns > 0)
