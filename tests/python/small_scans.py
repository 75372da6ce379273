"""Writes what scanning apps export of the box room: pictures, poses, depths and confidences."""

import functools
import json
import struct
import zipfile
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import gsut
from box_room import BoxRoom, plan_walk

CAMERA = gsut.Camera("pinhole", [50.0, 50.5, 31.5, 24.2], 64, 48)
DEPTH_SIZE = (32, 24)
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@functools.cache
def poses() -> list[np.ndarray]:
    return plan_walk(8)


def measure_z(pose: np.ndarray) -> np.ndarray:
    """Measures z (24, 32) in metres along the camera's axis, as the sensor does."""
    small = CAMERA.resize(*DEPTH_SIZE)
    distances = BoxRoom().measure_distances(small, pose)
    rays = np.asarray(small.rays()[0])
    return distances * rays[..., 2] / np.linalg.norm(rays, axis=2)


@functools.cache
def _render(number: int) -> np.ndarray:
    return BoxRoom().render(CAMERA, poses()[number])[..., ::-1]


def _write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())


def _write_pictures(name, depth, confidence, levels) -> None:
    """Writes pictures, depths in millimetres and confidences; the first row has the least."""
    for i, pose in enumerate(poses()):
        _write(name(i), _render(i))
        _write(depth(i), np.round(1000 * measure_z(pose)).astype(np.uint16))
        sure = np.full(DEPTH_SIZE[::-1], levels[2], np.uint8)
        sure[0], sure[1] = levels[:2]
        _write(confidence(i), sure)


def write_polycam(folder: Path, corrected: bool) -> None:
    keys, kind = folder / "keyframes", "corrected_" if corrected else ""
    _write_pictures(
        lambda i: keys / f"images/{10**9 + i}.jpg", lambda i: keys / f"depth/{10**9 + i}.png",
        lambda i: keys / f"confidence/{10**9 + i}.png", (0, 54, 255),
    )  # fmt: skip
    for folder_name, off in (("cameras", 0.3 if corrected else 0.0), (f"{kind}cameras", 0.0)):
        for i, pose in enumerate(poses()):
            matrix = pose @ OPENGL_FROM_OPENCV
            values = {f"t_{r}{c}": matrix[r, c] for r in range(3) for c in range(4)}
            values["t_03"] += off
            values |= dict(zip(("fx", "fy", "cx", "cy"), CAMERA.params, strict=True))
            values |= {"width": 64, "height": 48, "blur_score": 99.0, "timestamp": 10**9 + i}
            file = keys / folder_name / f"{10**9 + i}.json"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(values))
    (folder / "mesh_info.json").write_text("{}")


def format_exr(z: np.ndarray) -> bytes:
    """Formats one half-float channel R, not compressed."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    height, width = z.shape
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<ii", 20000630, 2)
    head += attribute("channels", "chlist", b"R\0" + struct.pack("<iB3xii", 1, 0, 1, 1) + b"\0")
    head += attribute("compression", "compression", b"\0")
    head += attribute("dataWindow", "box2i", box) + attribute("displayWindow", "box2i", box)
    head += attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    head += attribute("screenWindowCenter", "v2f", struct.pack("<ff", 0, 0))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    rows = [struct.pack("<ii", y, 2 * width) + row.astype("<f2").tobytes()
            for y, row in enumerate(z)]  # fmt: skip
    first = len(head) + 8 * height
    return head + struct.pack(f"<{height}Q", *(first + y * len(rows[0]) for y in range(height))) + \
        b"".join(rows)  # fmt: skip


def write_record3d(folder: Path) -> None:
    place = folder / "EXR_RGBD"
    _write_pictures(
        lambda i: place / f"rgb/{i}.jpg", lambda i: folder / f"unused/{i}.png",
        lambda i: folder / f"unused/conf{i}.png", (0, 1, 2),
    )  # fmt: skip
    (place / "depth").mkdir()
    rows = []
    for i, pose in enumerate(poses()):
        (place / f"depth/{i}.exr").write_bytes(format_exr(measure_z(pose)))
        quaternion = Rotation.from_matrix((pose @ OPENGL_FROM_OPENCV)[:3, :3]).as_quat()
        rows.append([*quaternion, *pose[:3, 3]])
    fx, fy, cx, cy = CAMERA.params
    values = {"w": 64, "h": 48, "dw": 32, "dh": 24, "fps": 60, "poses": rows,
              "K": [fx, 0, 0, 0, fy, 0, cx, cy, 1], "initPose": rows[0],
              "frameTimestamps": [i / 60 for i in range(len(rows))],
              "perFrameIntrinsicCoeffs": [list(CAMERA.params)] * len(rows)}  # fmt: skip
    (place / "metadata.json").write_text(json.dumps(values))


def write_record3d_archive(file: Path) -> None:
    import lzfse

    folder = file.with_suffix("")
    write_record3d(folder)
    sure = np.full(DEPTH_SIZE[::-1], 2, np.uint8)
    sure[0] = 0
    with zipfile.ZipFile(file, "w") as archive:
        archive.write(folder / "EXR_RGBD/metadata.json", "metadata")
        for i, pose in enumerate(poses()):
            archive.write(folder / f"EXR_RGBD/rgb/{i}.jpg", f"rgbd/{i}.jpg")
            z = measure_z(pose).astype("<f4").tobytes()
            archive.writestr(f"rgbd/{i}.depth", lzfse.compress(z))
            archive.writestr(f"rgbd/{i}.conf", lzfse.compress(sure.tobytes()))


def write_scanner(folder: Path) -> None:
    _write_pictures(
        lambda i: folder / f"frame_{i:05d}.jpg", lambda i: folder / f"depth_{i:05d}.png",
        lambda i: folder / f"conf_{i:05d}.png", (0, 1, 2),
    )  # fmt: skip
    fx, fy, cx, cy = CAMERA.params
    for i, pose in enumerate(poses()):
        values = {"cameraPoseARFrame": (pose @ OPENGL_FROM_OPENCV).ravel().tolist(),
                  "intrinsics": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "frame_index": i,
                  "time": 100.5 + i, "motionQuality": 1}  # fmt: skip
        (folder / f"frame_{i:05d}.json").write_text(json.dumps(values))
    (folder / "frame_00099.json").write_text("{}")  # frames without a picture are most
    (folder / "info.json").write_text("{}")


def write_stray(folder: Path) -> None:
    _write_pictures(
        lambda i: folder / f"rgb/{i:06d}.jpg", lambda i: folder / f"depth/{i:06d}.png",
        lambda i: folder / f"confidence/{i:06d}.png", (0, 1, 2),
    )  # fmt: skip
    fx, fy, cx, cy = CAMERA.params
    (folder / "camera_matrix.csv").write_text(f"{fx}, 0.0, {cx}\n0.0, {fy}, {cy}\n0.0, 0.0, 1.0\n")
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i, pose in enumerate(poses()):
        numbers = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
        lines.append(f"{200 + i / 60}, {i:06d}, " + ", ".join(map(repr, map(float, numbers))))
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")


def format_las(points, colors=None, version=2, kind=2, many=None) -> bytes:
    """Formats a LAS file of version 1.2 (formats 0, 2) or 1.4 (format 7)."""
    size, at = {0: (20, None), 2: (26, 20), 7: (36, 30), 0x82: (26, 20)}[kind]
    length = 375 if version == 4 else 227
    head = bytearray(length)
    head[:4], head[24:26] = b"LASF", bytes([1, version])
    struct.pack_into("<HI", head, 94, length, length)
    struct.pack_into("<BHI", head, 104, kind, size, 0 if version == 4 else len(points))
    offset = np.floor(points.min(axis=0))
    struct.pack_into("<6d", head, 131, 1e-3, 1e-3, 1e-3, *offset)
    if version == 4:
        struct.pack_into("<Q", head, 247, len(points))
    rows = np.zeros((len(points), size), np.uint8)
    steps = np.round((points - offset) / 1e-3).astype("<i4")
    rows[:, :12] = steps.view(np.uint8).reshape(-1, 12)
    if colors is not None:
        rows[:, at : at + 6] = colors.astype("<u2").view(np.uint8).reshape(-1, 6)
    return bytes(head) + rows.tobytes()
