"""--readout-time on a made video: a swaying camera whose every line has its own, known pose."""

import json

import cv2
import numpy as np
import pytest

import gsut
import small_datasets as small
import tolerances
from gsut import TrainOptions
from gsut.cli import main
from gsut.data.scene import with_shutter
from gsut.render import PixelFilter
from gsut.render.pictures import to_uint8

WIDTH, HEIGHT, FOCAL = 96, 72, 90.0
FRAMES = 32
PERIOD = 16.0  # frames of one sway: the same places are seen at opposite velocities
READOUT = 0.8  # of the time between two frames


def world_from_camera(time):
    """(..., 4, 4) of a camera 3 above the plane z = 0 that sways sideways and turns."""
    phase = 2 * np.pi * np.asarray(time, np.float64) / PERIOD
    yaw = 0.08 * np.sin(phase + 1.0)
    zero, one = np.zeros_like(phase), np.ones_like(phase)
    # x right, y down, z forward: the camera looks down; yaw is about its own y.
    rows = [
        [np.cos(yaw), zero, np.sin(yaw), 0.8 * np.sin(phase)],
        [zero, -one, zero, 0.5 * np.sin(2 * phase)],
        [np.sin(yaw), zero, -np.cos(yaw), 3.0 + 0.2 * np.cos(phase)],
        [zero, zero, zero, one],
    ]
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)


def photograph(frame):
    """(H, W, 3) of the plane, each line by the ray of its own time; 2 x 2 rays a pixel."""
    y, x = (np.mgrid[: 2 * HEIGHT, : 2 * WIDTH] + 0.5) / 2
    line = (np.floor(y) + 0.5) / HEIGHT - 0.5
    pose = world_from_camera(frame + READOUT * line)
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], axis=-1)
    rays = np.einsum("...ij,...j->...i", pose[..., :3, :3], rays)
    center = pose[..., :3, 3]
    hit = (center - rays * (center[..., 2:] / rays[..., 2:]))[..., :2]
    colors = small.texture(4 * hit).astype(np.float64)
    colors = colors.reshape(HEIGHT, 2, WIDTH, 2, 3).mean(axis=(1, 3))
    return np.round(colors).astype(np.uint8)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A transforms.json with one pose a frame, that of its middle line."""
    folder = tmp_path_factory.mktemp("video")
    frames = []
    for frame in range(FRAMES):
        name = f"images/{frame:04d}.png"
        small.write_png(folder / name, photograph(frame))
        pose = world_from_camera(frame) @ small.OPENGL_FROM_OPENCV
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    x, y = np.meshgrid(np.linspace(-2.5, 2.5, 40), np.linspace(-2, 2, 32))
    plane = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    small.write_ply(folder / "points3D.ply", plane, small.texture(4 * plane[:, :2]))
    values = {
        "camera_model": "PINHOLE", "w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL,
        "cx": WIDTH / 2, "cy": HEIGHT / 2, "ply_file_path": "points3D.ply", "frames": frames,
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(values))
    return folder


def test_readout_time_start_and_end_poses_are_near_the_truth(video):
    scene = gsut.load_dataset(video)
    moving = with_shutter(scene, readout_time=READOUT)
    errors, ways = [], []
    for frame, view in enumerate(moving.views):
        if frame in (0, FRAMES - 1):  # the velocity of one side only
            continue
        for found, side in ((view.motion.start, -0.5), (view.motion.end, 0.5)):
            truth = world_from_camera(frame + side * READOUT)
            truth[:3, 3] -= scene.world_offset
            away = found @ truth  # identity where they agree
            errors.append(np.linalg.norm(away[:3, 3]) + np.linalg.norm(away[:3, :3] - np.eye(3)))
            still = view.camera_from_world @ truth
            ways.append(np.linalg.norm(still[:3, 3]) + np.linalg.norm(still[:3, :3] - np.eye(3)))
    assert len(errors) == 2 * (FRAMES - 2)
    # Central differences: (2 pi / 16)^2 / 6 = 2.6 % of the velocity of the slow sway, four times
    # that of the fast one, and the curve of the way within a frame.
    assert np.mean(errors) < tolerances.READOUT_POSE_SHARE * np.mean(ways)


def test_train_with_readout_time_beats_a_global_shutter(video):
    psnr = {}
    for readout_time in (READOUT, None):
        options = TrainOptions(
            steps=300, max_gaussians=2500, sh_degree=0, readout_time=readout_time
        )
        scene = gsut.load_dataset(video)
        psnr[readout_time] = gsut.train(scene, options, progress=False).metrics["psnr"]
    print(psnr)
    assert psnr[READOUT] > psnr[None] + tolerances.SHUTTER_LEAST_GAIN


def test_render_of_held_out_views_keeps_the_rolling_shutter(video, tmp_path):
    run, out = tmp_path / "run", tmp_path / "out"
    words = ["--steps", "60", "--max-gaussians", "1500", "--sh-degree", "0", "--quiet"]
    assert main(["train", str(video), "-o", str(run), "--readout-time", "0.8", *words]) == 0
    assert main(["render", str(run), "--path", "test", "-o", str(out)]) == 0
    scene = with_shutter(gsut.load_dataset(video), readout_time=READOUT)
    gaussians = gsut.formats.load_ply(run / "scene.ply")
    train = scene.train_indices
    lenses = [scene.camera(index) for index in train]
    pixels = PixelFilter(gaussians, lenses, scene.poses(train))
    checked = 0
    for index in scene.test_indices:
        view, camera = scene.views[index], scene.camera(index)
        name = view.name.replace("/", "_")
        found = cv2.imread(str(out / name))[..., ::-1]
        rolling, still = (
            to_uint8(gsut.render(pixels.widen(camera, place), camera, place, background=None).image)
            for place in (view.motion, view.camera_from_world)
        )
        assert np.array_equal(found, rolling)
        assert not np.array_equal(found, still)
        checked += 1
    assert checked == FRAMES // 8
