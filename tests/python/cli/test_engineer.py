"""A robotics engineer's way: EuRoC-like files, Kalibr chain, SLAM's body poses, LiDAR; to depth.

A room through a rig of two fisheyes, on a body with an IMU. All goes through files and
commands; what comes out is compared with the ray-cast truth in the trajectory's own frame.
"""

import functools
import json

import cv2
import numpy as np
import pytest

import gsut
import small_recordings as made
import tolerances
from box_room import (
    BoxRoom,
    find_whole_pixels,
    make_rig_of_two,
    place_right,
    plan_walk,
    sample_points,
)
from gsut.cli import main
from gsut.data.poses import invert_pose
from gsut.files import write_picture

FRAMES, SIZE = 14, 96
START, STEP = 1403636579763555584, 500_000_000  # nanoseconds
FINE = 1000  # poses of the path between two pictures: half a millisecond each
JITTER = 1  # of those: SLAM's poses are that much early or late, and say so
PLACE = np.array([452_000.0, 5_411_000.0, 310.0])  # the SLAM's world: UTM


def body_from_cameras() -> list[np.ndarray]:
    """The IMU's axes are x forward, y left, z up; both cameras look forward."""
    left = np.eye(4)
    left[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    left[:3, 3] = [0.12, 0.08, -0.03]
    return [left, left @ invert_pose(place_right())]


@functools.cache
def path() -> list[np.ndarray]:
    """A fifth of the walk."""
    return plan_walk((FRAMES + 2) * FINE, (1 + 2 / FRAMES) / 5)


def world_from_body(fine: int) -> np.ndarray:
    """The true path, in the SLAM's world."""
    pose = path()[fine + FINE] @ invert_pose(body_from_cameras()[0])
    pose[:3, 3] += PLACE
    return pose


def in_room(pose: np.ndarray) -> np.ndarray:
    moved = pose.copy()
    moved[:3, 3] -= PLACE
    return moved


def camchain(lenses: list[gsut.Camera]) -> str:
    """As `kalibr_calibrate_imu_camera` writes it."""
    text, before = "", None
    for name, lens, place in zip(made.CAMERAS, lenses, body_from_cameras(), strict=True):
        fx, fy, cx, cy, *k = (float(v) for v in lens.params)
        rows = {"T_cam_imu": invert_pose(place)}
        if before is not None:
            rows["T_cn_cnm1"] = invert_pose(place) @ before
        before = place
        text += f"{name}:\n  cam_overlaps: [{1 - int(name[-1])}]\n  camera_model: pinhole\n"
        text += f"  intrinsics: {[fx, fy, cx - 0.5, cy - 0.5]}\n  distortion_model: equidistant\n"
        text += f"  distortion_coeffs: {k}\n  resolution: [{SIZE}, {SIZE}]\n"
        text += f"  rostopic: /{name}/image_raw\n  timeshift_cam_imu: 0.0\n"
        for key, pose in rows.items():
            text += f"  {key}:\n" + "".join(f"  - {made.matrix_text(row)}\n" for row in pose)
    return text


def write_uncoloured(path, points: np.ndarray) -> None:
    """A LiDAR's cloud: x, y, z in double, and an intensity."""
    rows = np.empty(len(points), [("xyz", "<f8", 3), ("intensity", "<f4")])
    rows["xyz"], rows["intensity"] = points, 7.0
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    path.write_bytes((header + "property float intensity\nend_header\n").encode() + rows.tobytes())


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """The recording as it comes from the robot: DATA, and the room it was taken in."""
    data = tmp_path_factory.mktemp("robot") / "DATA"
    room, lenses = BoxRoom(), [lens for lens, *_ in make_rig_of_two(SIZE).values()]
    for name, lens, place in zip(made.CAMERAS, lenses, body_from_cameras(), strict=True):
        folder = data / "mav0" / name
        (folder / "data").mkdir(parents=True)
        poses = [in_room(world_from_body(i * FINE) @ place) for i in range(FRAMES)]
        for i, pose in enumerate(poses):
            image = room.render(lens, pose)
            write_picture(folder / "data" / f"{START + i * STEP}.png", image[..., ::-1])
        write_picture(folder / "mask.png", find_whole_pixels(lens).astype(np.uint8) * 255)
    (data / "camchain.yaml").write_text(camchain(lenses))
    random = np.random.default_rng(5)
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for i in range(-1, FRAMES + 1):
        early = int(random.integers(-JITTER, JITTER + 1))
        pose, time = world_from_body(i * FINE + early), START + i * STEP + early * STEP // FINE
        w, *xyz = cv_quaternion(pose[:3, :3])
        values = "".join(f" {v:.9f}" for v in (*pose[:3, 3], *xyz, w))
        rows.append(f"{time // 10**9}.{time % 10**9:09d}{values}")
    (data / "trajectory.txt").write_text("\n".join(rows) + "\n")
    left = [in_room(world_from_body(i * FINE) @ body_from_cameras()[0]) for i in range(FRAMES)]
    cloud, _ = sample_points(room, lenses[0], left)
    write_uncoloured(data / "points3D.ply", cloud + PLACE)
    return data, room, lenses


def cv_quaternion(rotation: np.ndarray) -> np.ndarray:
    """w, x, y, z."""
    vector = cv2.Rodrigues(rotation)[0].ravel()
    angle = float(np.linalg.norm(vector))
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * vector / max(angle, 1e-12)])


def test_the_recording_is_read_with_the_poses_of_its_pictures(walk):
    data, _, lenses = walk
    scene = gsut.load_dataset(data)
    assert len(scene) == 2 * FRAMES and len(scene.points) > 3000
    for view in scene.views:
        camera = int("cam1" in view.name)
        row = (int(view.image_path.stem) - START) // STEP
        truth = world_from_body(row * FINE) @ body_from_cameras()[camera]
        error = view.camera_center - truth[:3, 3]
        assert np.linalg.norm(error) < tolerances.ENGINEER_CENTRE
        turn = view.camera_from_world[:3, :3] @ truth[:3, :3]
        angle = np.degrees(np.linalg.norm(cv2.Rodrigues(turn)[0]))
        assert angle < tolerances.ENGINEER_DEGREES
        np.testing.assert_allclose(
            scene.cameras[view.camera_index].params, lenses[camera].params,
            rtol=tolerances.LAYOUT_POSE,
        )  # fmt: skip


def test_from_files_through_the_commands_to_depth_in_the_right_frame(walk, capsys):
    data, room, lenses = walk
    run = data.parent / "RUN"
    assert main(["doctor", str(data)]) == 0, capsys.readouterr().out
    capsys.readouterr()
    words = ["train", str(data), "-o", str(run), "--preset", "fast", "--steps", "300"]
    assert main([*words, "--seed", "0", "--quiet", "--json"]) == 0
    out = capsys.readouterr().out
    assert json.loads(out)["psnr"] > tolerances.ENGINEER_PSNR
    # A place where no picture was taken, through the right lens, in the SLAM's own coordinates.
    pose = world_from_body(5 * FINE + FINE // 2) @ body_from_cameras()[1]
    gaussians = gsut.formats.load_ply(run / "scene.ply")
    rendered = gsut.render(gaussians, lenses[1], invert_pose(pose))
    inside = lenses[1].rays()[1]
    truth = room.measure_distances(lenses[1], in_room(pose))[inside]
    covered = rendered.alpha[inside] > 0.5
    found = rendered.depth[inside][covered] / rendered.alpha[inside][covered]
    errors = np.abs(found - truth[covered]) / truth[covered]
    assert covered.mean() > tolerances.ENGINEER_COVERED
    assert np.median(errors) < tolerances.ENGINEER_DEPTH
