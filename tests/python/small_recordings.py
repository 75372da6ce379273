"""Writes recordings of a two-camera body in the layouts of robotics: EuRoC, TUM-VI, TUM, KITTI."""

from pathlib import Path

import numpy as np

import small_datasets as small
import tolerances
from gsut.data.poses import invert_pose

START = 1403636579763555584  # of EuRoC's first picture: float64 would round it by 128 ns
STEP = 100_000_001  # nanoseconds between pictures
CAMERAS = ("cam0", "cam1")
LENS = (small.FX, small.FY, small.CX - 0.5, small.CY - 0.5)  # (0, 0) is the first pixel's centre


def body_from_cameras() -> list[np.ndarray]:
    """The cameras' places on the body: x forward, y left, z up."""
    poses = []
    for y in (0.05, -0.06):
        pose = np.eye(4)
        pose[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
        pose[:3, 3] = [0.1, y, 0.02]
        poses.append(pose)
    return poses


def times() -> list[int]:
    return [START + i * STEP for i in range(small.VIEWS)]


def world_from_body(time: float | int) -> np.ndarray:
    """At an exact time: uniform motion between the small dataset's ten poses."""
    at = (int(time) - START) / STEP
    first = small.world_from_cameras()[0] @ invert_pose(body_from_cameras()[0])
    pose = np.eye(4)
    angle = 0.02 * at
    turn = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    pose[:3, :3] = np.array(turn) @ first[:3, :3]
    pose[:3, 3] = first[:3, 3] + np.array([0.1, 0.02, 0.01]) * at
    return pose


def world_from_camera(camera: int, time: int) -> np.ndarray:
    return world_from_body(time) @ body_from_cameras()[camera]


def assert_pose(view, camera: int, time: int) -> None:
    """A view has the pose of this camera at this time."""
    expected = invert_pose(world_from_camera(camera, time))
    np.testing.assert_allclose(
        view.camera_from_world, expected, rtol=0, atol=tolerances.LAYOUT_POSE
    )


def matrix_text(matrix: np.ndarray) -> str:
    return "[" + ", ".join(f"{v:.17g}" for v in np.ravel(matrix)) + "]"


def write_pictures(folder: Path, camera: int, name=lambda time: f"{time}.png") -> None:
    for time in times():
        small.write_png(folder / name(time), small.render(world_from_camera(camera, time)))


def write_sensor(path: Path, camera: int) -> None:
    path.write_text(
        "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
        f"  data: {matrix_text(body_from_cameras()[camera])}\nrate_hz: 10\n"
        f"resolution: [{small.WIDTH}, {small.HEIGHT}]\ncamera_model: pinhole\n"
        f"intrinsics: {list(LENS)}\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
    )


def camchain(with_imu: bool = True, shift: float = 0.0) -> str:
    text, before = "", None
    for name, place in zip(CAMERAS, body_from_cameras(), strict=True):
        camera_from_body = invert_pose(place)
        rows = {"T_cam_imu": camera_from_body} if with_imu else {}
        if before is not None:
            rows["T_cn_cnm1"] = camera_from_body @ before
        before = place
        text += f"{name}:\n  camera_model: pinhole\n  intrinsics: {list(LENS)}\n"
        text += "  distortion_model: none\n  distortion_coeffs: []\n"
        text += f"  resolution: [{small.WIDTH}, {small.HEIGHT}]\n  timeshift_cam_imu: {shift}\n"
        for key, pose in rows.items():
            text += f"  {key}:\n" + "".join(f"  - {matrix_text(row)}\n" for row in pose)
    return text


def body_rows(at: list[int]) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Time, position and quaternion (w first) of the body."""
    return [
        (time, world_from_body(time)[:3, 3], small.quaternion(world_from_body(time)[:3, :3]))
        for time in at
    ]


def write_states(path: Path, at: list[int]) -> None:
    """EuRoC's table of ground truth."""
    rows = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [],"
            " q_RS_z [], v_RS_R_x [m s^-1]"]  # fmt: skip
    for time, position, quat in body_rows(at):
        rows.append(f"{time}," + ",".join(f"{v:.17g}" for v in (*position, *quat, 0.0)))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(rows) + "\n")


def trajectory(at: list[int], label=lambda ns: f"{ns // 10**9}.{ns % 10**9:09d}") -> str:
    """The body's poses as a TUM trajectory."""
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for time, position, (w, *xyz) in body_rows(at):
        rows.append(label(time) + "".join(f" {v:.17g}" for v in (*position, *xyz, w)))
    return "\n".join(rows) + "\n"


def write_euroc(path: Path) -> Path:
    """Two cameras with a sensor.yaml each, and states at twice their rate."""
    for number, name in enumerate(CAMERAS):
        folder = path / "mav0" / name
        write_pictures(folder / "data", number)
        rows = ["#timestamp [ns],filename", *(f"{t},{t}.png" for t in times())]
        (folder / "data.csv").write_text("\n".join(rows) + "\n")
        write_sensor(folder / "sensor.yaml", number)
    at = [START + i * STEP // 2 for i in range(-1, 2 * small.VIEWS)]
    write_states(path / "mav0/state_groundtruth_estimate0/data.csv", at)
    return path


def write_tumvi(path: Path) -> Path:
    """As TUM-VI's: no sensor.yaml, dso/camchain.yaml and mocap0."""
    for number, name in enumerate(CAMERAS):
        write_pictures(path / "mav0" / name / "data", number)
    (path / "dso").mkdir()
    (path / "dso/camchain.yaml").write_text(camchain())
    write_states(path / "mav0/mocap0/data.csv", times())
    return path
