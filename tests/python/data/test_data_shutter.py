"""Rolling shutters from datasets: start and end poses, readout times, and training with them."""

import json

import cv2
import numpy as np
import pytest

import gsut
import small_datasets as small
import tolerances
from gsut import InputError, TrainOptions
from gsut.cli import main
from gsut.data.scene import with_shutter
from gsut.render import PixelFilter
from gsut.render.pictures import to_uint8


def rolling_transforms(direction=None):
    values = small.transforms()
    for frame in values["frames"]:
        middle = np.array(frame["transform_matrix"])
        for key, shift in (("_start", -0.02), ("_end", 0.02)):
            pose = middle.copy()
            pose[:3, 3] += shift * middle[:3, 0]
            frame["transform_matrix" + key] = pose.tolist()
    if direction is not None:
        values["rolling_shutter"] = direction
    return values


@pytest.mark.parametrize(
    ("entry", "direction"),
    [
        (None, "top_to_bottom"),
        ({"direction": "LEFT_TO_RIGHT"}, "left_to_right"),
        ("bottom_to_top", "bottom_to_top"),
        ({"row_time": "..."}, "top_to_bottom"),
    ],
)
def test_load_rolling_poses_give_each_view_a_motion(tmp_path, entry, direction):
    scene = gsut.load_dataset(small.write_nerfstudio(tmp_path, rolling_transforms(entry)))
    for view in scene.views:
        assert isinstance(view.motion, gsut.CameraMotion)
        assert view.motion.shutter.direction == direction
        assert np.abs(view.motion.at(0.5) - view.camera_from_world).max() < 1e-12
    assert len(scene) == small.VIEWS


def test_load_unknown_shutter_direction_is_refused(tmp_path):
    values = rolling_transforms({"direction": "SIDEWAYS"})
    with pytest.raises(InputError, match=r"rolling_shutter.*left_to_right"):
        gsut.load_dataset(small.write_nerfstudio(tmp_path, values))


def test_with_shutter_global_keeps_one_pose_a_view(tmp_path):
    scene = gsut.load_dataset(small.write_nerfstudio(tmp_path, rolling_transforms()))
    still = with_shutter(scene, "global")
    for view, moving in zip(still.views, scene.views, strict=True):
        assert np.array_equal(view.motion, moving.camera_from_world)
    assert with_shutter(scene, "auto") is scene and with_shutter(scene, "rolling") is scene


def video(tmp_path, numbers, readout_time, **options):
    """Frames of a camera that moves and turns evenly, with one pose each."""
    values = small.transforms()
    start = np.array(values["frames"][0]["transform_matrix"])
    values["frames"] = values["frames"][: len(numbers)]
    poses = {}
    for number, frame in zip(numbers, values["frames"], strict=True):
        pose = start.copy()
        pose[:3, :3] = gsut.exp_pose([0, 0, 0, 0, 0.05 * number, 0])[:3, :3] @ start[:3, :3]
        pose[:3, 3] += number * np.array([0.1, 0.02, 0.0])
        frame["transform_matrix"] = pose.tolist()
        poses[number] = pose
    small.write_nerfstudio(tmp_path, values)
    renamed = json.loads((tmp_path / "transforms.json").read_text())
    for number, frame in zip(numbers, renamed["frames"], strict=True):
        new = f"images/f{number:04d}.png"
        (tmp_path / frame["file_path"]).rename(tmp_path / new)
        frame["file_path"] = new
    (tmp_path / "transforms.json").write_text(json.dumps(renamed))
    scene = gsut.load_dataset(tmp_path)
    return scene, with_shutter(scene, "auto", readout_time, **options)


def test_with_shutter_readout_time_takes_the_velocity_from_neighbours(tmp_path):
    # An even motion: each frame's start and end are the true poses of a line's time before and
    # after; also where frames are missing.
    numbers = [0, 5, 10, 20, 25]
    scene, moving = video(tmp_path, numbers, 0.8, direction="bottom_to_top")
    checked = 0
    for view in moving.views:
        motion = view.motion
        assert motion.shutter.direction == "bottom_to_top"
        assert np.abs(motion.at(0.5) - view.camera_from_world).max() < 2e-4
        center = [-p[:3, :3].T @ p[:3, 3] for p in (motion.start, motion.end)]
        assert center[1] - center[0] == pytest.approx([0.08, 0.016, 0.0], abs=1e-12)
        turn = motion.end[:3, :3] @ motion.start[:3, :3].T
        angle = np.arccos((np.trace(turn) - 1) / 2)
        assert angle == pytest.approx(0.8 * 0.05, abs=1e-8)
        checked += 1
    assert checked == 5 and scene.views[0].shutter is None


def test_with_shutter_contradictions_say_what_to_do(tmp_path):
    scene = gsut.load_dataset(small.write_nerfstudio(tmp_path))
    with pytest.raises(InputError, match="--readout-time"):
        with_shutter(scene, "rolling")
    with pytest.raises(InputError, match="contradict"):
        with_shutter(scene, "global", 0.5)
    with pytest.raises(InputError, match="--readout-time"):
        TrainOptions(readout_time=1.5)
    with pytest.raises(InputError, match="--shutter"):
        TrainOptions(shutter="sideways")


@pytest.mark.slow
def test_train_rolling_scene_beats_treating_it_as_global(shared):
    scene = gsut.load_dataset(shared / "data" / "helmet_distorted_rs")
    psnr = {}
    for shutter in ("auto", "global"):
        options = TrainOptions(steps=250, max_gaussians=12_000, scale=0.5, shutter=shutter)
        psnr[shutter] = gsut.train(scene, options, progress=False).metrics["psnr"]
    print(psnr)
    assert psnr["auto"] > psnr["global"] + tolerances.SHUTTER_LEAST_GAIN


def test_render_of_held_out_views_keeps_the_rolling_shutter(tmp_path):
    data, run, out = (tmp_path / name for name in ("data", "run", "out"))
    small.write_nerfstudio(data)
    words = ["--steps", "60", "--max-gaussians", "600", "--sh-degree", "0", "--quiet"]
    assert main(["train", str(data), "-o", str(run), "--readout-time", "0.8", *words]) == 0
    assert main(["render", str(run), "--path", "test", "-o", str(out)]) == 0
    scene = with_shutter(gsut.load_dataset(data), readout_time=0.8)
    gaussians = gsut.formats.load_ply(run / "scene.ply")
    train = scene.train_indices
    pixels = PixelFilter(gaussians, [scene.camera(i) for i in train], scene.poses(train))
    for index in scene.test_indices:
        view, camera = scene.views[index], scene.camera(index)
        found = cv2.imread(str(out / view.name.replace("/", "_")))[..., ::-1]
        rolling, still = (
            to_uint8(gsut.render(pixels.widen(camera, place), camera, place, background=None).image)
            for place in (view.motion, view.camera_from_world)
        )
        assert np.array_equal(found, rolling)
        assert not np.array_equal(found, still)
    assert len(scene.test_indices) == 2
