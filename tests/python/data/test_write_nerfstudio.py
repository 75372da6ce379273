"""transforms.json as it is written is read back as it was."""

import cv2
import numpy as np
import pytest

import gsut
from gsut._core import Shutter
from gsut.data.assemble import Frame
from gsut.data.write_nerfstudio import format_transforms, points_ply


def frames_in(folder, rng, shutter=None, lenses=1):
    cameras = [
        gsut.Camera("kannala_brandt", [40 + i, 41, 32, 24, 0.02, -0.01, 0.002, 0], 64, 48)
        for i in range(lenses)
    ]
    (folder / "images").mkdir()
    out = []
    for i in range(4):
        path = folder / "images" / f"{i}.png"
        cv2.imwrite(str(path), rng.integers(0, 255, (48, 64, 3), np.uint8))
        poses = [gsut._core.exp_pose(rng.normal(size=6)) for _ in range(3)]
        ends = poses[1:] if shutter else (None, None)
        out.append(Frame(path.name, path, cameras[i % lenses], poses[0], *ends, shutter=shutter))
    return out


@pytest.mark.parametrize("lenses", [1, 2])
@pytest.mark.parametrize("shutter", [None, Shutter("top_to_bottom")])
def test_frames_come_back(tmp_path, rng, shutter, lenses):
    frames = frames_in(tmp_path, rng, shutter, lenses)
    points = rng.normal(size=(5, 3))
    colors = rng.integers(0, 255, (5, 3), np.uint8)
    (tmp_path / "p.ply").write_bytes(points_ply(points, colors))
    text = format_transforms(frames, tmp_path, points_file="p.ply", test=["1.png"])
    (tmp_path / "transforms.json").write_text(text)
    scene = gsut.load_dataset(tmp_path)
    assert scene.test_indices == [1] and scene.train_indices == [0, 2, 3]
    np.testing.assert_allclose(scene.points + scene.world_offset, points, atol=1e-14)
    np.testing.assert_array_equal(scene.point_colors, colors)
    for index, frame in enumerate(frames):
        view = scene.views[index]
        assert scene.camera(index) == frame.camera
        read = np.linalg.inv(scene.in_dataset(view.camera_from_world))
        np.testing.assert_allclose(read, frame.world_from_camera, atol=1e-12)
        np.testing.assert_allclose(
            scene.from_dataset(scene.in_dataset(view.camera_from_world)),
            view.camera_from_world, atol=1e-15,
        )  # fmt: skip
        assert (view.shutter is None) == (shutter is None)
        if shutter is not None:
            start = np.linalg.inv(scene.in_dataset(view.camera_from_world_start))
            np.testing.assert_allclose(start, frame.world_from_camera_start, atol=1e-12)


def test_two_shutters_have_no_room(tmp_path, rng):
    frames = frames_in(tmp_path, rng, Shutter("top_to_bottom"))
    frames[0].shutter = Shutter("left_to_right")
    with pytest.raises(gsut.InputError, match="room for one shutter"):
        format_transforms(frames, tmp_path)
