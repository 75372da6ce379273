"""Camera paths: rigid, smooth, through the keys, around the scene; files in three forms."""

import json
import math

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError
from gsut.data.poses import read_path, read_path_lens
from gsut.render.paths import make_orbit_path, smooth_path
from small_run import inward_pose

KEYS = np.stack([inward_pose(angle) for angle in np.linspace(0, 4, 9)])


def centers_of(poses: np.ndarray) -> np.ndarray:
    return np.linalg.inv(poses)[:, :3, 3]


def assert_rigid(poses: np.ndarray) -> None:
    rotation = poses[:, :3, :3]
    identity = np.swapaxes(rotation, 1, 2) @ rotation
    np.testing.assert_allclose(
        identity, np.broadcast_to(np.eye(3), identity.shape), atol=tolerances.RIGID_POSE
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=tolerances.RIGID_POSE)
    assert np.array_equal(poses[:, 3], np.tile([0.0, 0, 0, 1], (len(poses), 1)))


def test_smooth_path_with_even_keys_passes_through_each():
    path = smooth_path(KEYS, 8 * 5 + 1)
    assert_rigid(path)
    np.testing.assert_allclose(path[::5], KEYS, atol=tolerances.RIGID_POSE)


def test_smooth_path_along_a_circle_stays_on_it_and_looks_inward():
    path = smooth_path(KEYS, 200)
    centers = centers_of(path)
    np.testing.assert_allclose(
        np.linalg.norm(centers[:, :2], axis=1), 3.0, atol=tolerances.PATH_OFF_THE_CIRCLE
    )
    forward = path[:, 2, :3]
    inward = -centers / np.linalg.norm(centers, axis=1, keepdims=True)
    assert np.min(np.sum(forward * inward, axis=1)) > math.cos(math.radians(2))


def test_smooth_path_has_no_jumps_in_speed():
    uneven = KEYS[[0, 1, 3, 4, 8]]
    centers = centers_of(smooth_path(uneven, 2000))
    velocity = np.diff(centers, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    assert change.max() < tolerances.PATH_CHANGE_OF_SPEED * speed.mean()


def test_smooth_path_closed_comes_back_to_its_first_key():
    keys = np.stack([inward_pose(i * math.pi / 8) for i in range(16)])
    path = smooth_path(keys, 80, closed=True)
    assert len(path) == 80
    np.testing.assert_allclose(path[0], keys[0], atol=tolerances.RIGID_POSE)
    step = np.linalg.norm(np.diff(centers_of(np.concatenate([path, path[:1]])), axis=0), axis=1)
    assert step.max() < 1.1 * step.min()


@pytest.mark.parametrize("keys", [KEYS[:1], np.repeat(KEYS[:1], 4, axis=0), KEYS[:2]])
def test_smooth_path_of_few_or_equal_keys_is_finite_and_rigid(keys):
    for frames in (1, 2, 7):
        path = smooth_path(keys, frames)
        assert path.shape == (frames, 4, 4)
        assert_rigid(path)
    np.testing.assert_allclose(path[0], keys[0], atol=tolerances.RIGID_POSE)


def test_orbit_of_cameras_on_a_circle_is_that_circle():
    keys = np.stack([inward_pose(i * math.pi / 6) for i in range(12)])
    path = make_orbit_path(keys, 36)
    assert_rigid(path)
    centers = centers_of(path)
    np.testing.assert_allclose(np.linalg.norm(centers[:, :2], axis=1), 3.0, rtol=1e-9)
    np.testing.assert_allclose(centers[:, 2], 1.0, rtol=1e-9)
    origin_in_camera = path[:, :3, 3]
    np.testing.assert_allclose(origin_in_camera[:, :2], 0, atol=tolerances.RIGID_POSE)
    np.testing.assert_allclose(path[0], keys[0], atol=tolerances.RIGID_POSE)


def test_orbit_of_cameras_that_look_outward_turns_on_the_spot():
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    keys = np.stack([turned @ inward_pose(i * math.pi / 6, height=0.0) for i in range(12)])
    path = make_orbit_path(keys, 24)
    assert_rigid(path)
    assert np.linalg.norm(centers_of(path), axis=1).max() < 1.0
    np.testing.assert_allclose(path[:, 2, :3].mean(axis=0), 0, atol=tolerances.RIGID_POSE)


def test_orbit_of_one_camera_or_of_parallel_ones_is_rigid():
    shifted = np.tile(np.eye(4), (3, 1, 1))
    shifted[:, 0, 3] = [0, 1, 2]
    assert_rigid(make_orbit_path(KEYS[:1], 5))
    assert_rigid(make_orbit_path(shifted, 5))


@pytest.mark.parametrize("form", ["camera_from_world", "camera_path", "frames"])
def test_read_path_in_each_form_gives_the_scenes_poses(tmp_path, form):
    offset = np.array([100.0, -50.0, 7.0])
    camera_from_dataset = KEYS.copy()
    camera_from_dataset[:, :3, 3] -= KEYS[:, :3, :3] @ offset
    opengl = np.linalg.inv(camera_from_dataset) @ np.diag([1.0, -1, -1, 1])
    content = {
        "camera_from_world": camera_from_dataset.tolist(),
        "camera_path": [{"camera_to_world": m.ravel().tolist()} for m in opengl],
        "frames": [{"transform_matrix": m.tolist()} for m in opengl],
    }
    path = tmp_path / "path.json"
    path.write_text(json.dumps({form: content[form]}))
    np.testing.assert_allclose(read_path(path, offset), KEYS, atol=tolerances.POSE_FAR_AWAY)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "cannot be opened"),
        ("{", "not valid JSON"),
        ("[]", "not a camera path"),
        ('{"frames": [{}]}', "not a camera path"),
        ('{"frames": []}', "holds no pose"),
        ('{"camera_from_world": [[[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]]}', "pose 0"),
    ],
)
def test_read_path_of_a_bad_file_says_what_is_wrong(tmp_path, text, said):
    path = tmp_path / "path.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_path(path)


def write_nerfstudio_path(file, fov=(40.0, 40.0), **keys):
    poses = [{"camera_to_world": np.eye(4).ravel().tolist(), "fov": angle} for angle in fov]
    file.write_text(
        json.dumps({"camera_path": poses, "render_width": 96, "render_height": 64} | keys)
    )
    return file


def test_nerfstudio_path_brings_its_size_and_field_of_view(tmp_path):
    values = read_path_lens(write_nerfstudio_path(tmp_path / "path.json"))
    camera = gsut.Camera(values["model"], values["params"], values["width"], values["height"])
    assert (camera.width, camera.height) == (96, 64)
    rays, valid = camera.unproject([[48.0, 0.0], [48.0, 64.0]])
    assert valid.all()
    angle = np.degrees(np.arccos(rays[0] @ rays[1] / np.prod(np.linalg.norm(rays, axis=1))))
    assert angle == pytest.approx(40.0)
    wide = write_nerfstudio_path(tmp_path / "wide.json", camera_type="equirectangular")
    assert read_path_lens(wide)["model"] == "equirectangular"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"fov": (40.0, 50.0)}, "fields of view of 40 to 50 degrees"),
        ({"camera_type": "fisheye"}, "camera_type 'fisheye'"),
        ({"render_width": None}, "are not all numbers"),
        ({"fov": (float("nan"),) * 2}, "fields of view of nan"),
    ],
)
def test_nerfstudio_path_of_another_lens_is_refused_with_what_to_give(keys, said, tmp_path):
    with pytest.raises(gsut.InputError, match=f"{said}.* --camera"):
        read_path_lens(write_nerfstudio_path(tmp_path / "path.json", **keys))
