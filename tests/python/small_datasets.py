"""Writes a small dataset of a textured plane in each format; tests then break it in one place."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 48, 36
FX, FY, CX, CY = 40.0, 41.0, 24.5, 17.5
VIEWS = 10
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def names() -> list[str]:
    return [f"images/{i:03d}.png" for i in range(VIEWS)]


def world_from_cameras() -> list[np.ndarray]:
    """Ten OpenCV camera-to-world poses on an arc, looking down on the plane z = 0."""
    poses = []
    for i in range(VIEWS):
        angle = 2 * np.pi * i / VIEWS
        center = np.array([np.cos(angle), np.sin(angle), 3 + 0.1 * i])
        forward = np.array([0.1 * np.cos(2 * angle), 0.05 * np.sin(angle), 0.0]) - center
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 1.0, 0.1])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = center
        poses.append(pose)
    return poses


def texture(xy: np.ndarray) -> np.ndarray:
    """(..., 2) positions on the plane -> (..., 3) uint8 colours."""
    x, y = xy[..., 0], xy[..., 1]
    waves = np.stack([np.sin(2 * x + y), np.sin(x - 2 * y + 1), np.cos(1.5 * x + 0.7)], axis=-1)
    return np.round(127 + 100 * waves).astype(np.uint8)


def render(world_from_camera: np.ndarray) -> np.ndarray:
    """(H, W, 3) RGB picture of the plane through a pinhole."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = np.stack([(x - CX) / FX, (y - CY) / FY, np.ones_like(x)], axis=-1)
    rays = rays @ world_from_camera[:3, :3].T
    center = world_from_camera[:3, 3]
    return texture((center - rays * (center[2] / rays[..., 2:]))[..., :2])


def points() -> tuple[np.ndarray, np.ndarray]:
    """400 points of the plane and their colours."""
    xy = np.stack(np.meshgrid(np.linspace(-1.5, 1.5, 20), np.linspace(-1.5, 1.5, 20)), axis=-1)
    xy = xy.reshape(-1, 2)
    return np.concatenate([xy, np.zeros((len(xy), 1))], axis=1), texture(xy)


def write_images(path: Path) -> None:
    for name, pose in zip(names(), world_from_cameras(), strict=True):
        write_png(path / name, render(pose))


def write_png(path: Path, rgb: np.ndarray) -> None:
    """Writes RGB, grey or (as given) 4-channel pixels in the format of the suffix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if rgb.ndim == 3 and rgb.shape[2] == 3:
        rgb = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    path.write_bytes(cv2.imencode(path.suffix, rgb)[1].tobytes())


def write_ply(path: Path, xyz: np.ndarray, rgb: np.ndarray) -> None:
    rows = np.empty(len(xyz), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"], rows["rgb"] = xyz, rgb
    header = "ply\nformat binary_little_endian 1.0\n" + f"element vertex {len(xyz)}\n"
    header += "".join(f"property float {c}\n" for c in "xyz")
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + "end_header\n"
    path.write_bytes(header.encode() + rows.tobytes())


def transforms() -> dict:
    """The content of a good transforms.json."""
    return {
        "camera_model": "PINHOLE", "w": WIDTH, "h": HEIGHT, "fl_x": FX, "fl_y": FY,
        "cx": CX, "cy": CY, "ply_file_path": "points3D.ply",
        "frames": [
            {"file_path": name, "transform_matrix": (pose @ OPENGL_FROM_OPENCV).tolist()}
            for name, pose in zip(names(), world_from_cameras(), strict=True)
        ],
    }  # fmt: skip


def write_nerfstudio(path: Path, values: dict | None = None, **changes) -> Path:
    """Writes a transforms.json, by default a good one, with these keys changed or added."""
    write_images(path)
    write_ply(path / "points3D.ply", *points())
    (path / "transforms.json").write_text(json.dumps((values or transforms()) | changes))
    return path


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """w, x, y, z of a rotation matrix, through OpenCV's rotation vector."""
    vector = cv2.Rodrigues(rotation)[0].ravel()
    angle = np.linalg.norm(vector)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * vector / max(angle, 1e-12)])


def colmap_images() -> list[tuple[int, np.ndarray, np.ndarray, str]]:
    """id, quaternion, translation (camera-from-world), name without the folder 'images'."""
    rows = []
    for i, (name, pose) in enumerate(zip(names(), world_from_cameras(), strict=True)):
        rotation = pose[:3, :3].T
        rows.append((i + 1, quaternion(rotation), -rotation @ pose[:3, 3], Path(name).name))
    return rows


def write_colmap_text(path: Path) -> Path:
    write_images(path)
    model = path / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(
        f"# cameras\n7 PINHOLE {WIDTH} {HEIGHT} {FX} {FY} {CX} {CY}\n"
    )
    lines = ["# images"]
    for number, quat, translation, name in colmap_images():
        pose = " ".join(f"{value:.17g}" for value in [*quat, *translation])
        lines += [f"{number} {pose} 7 {name}", "" if number % 2 else "1.5 2.5 -1 3.5 4.5 12"]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [
        f"{i} {x:.17g} {y:.17g} {z:.17g} {r} {g} {b} 0.5 1 0 2 0"
        for i, ((x, y, z), (r, g, b)) in enumerate(zip(*points(), strict=True))
    ]
    (model / "points3D.txt").write_text("# points\n" + "\n".join(rows) + "\n")
    return path


def write_colmap_binary(path: Path, model_number: int = 1) -> Path:
    write_images(path)
    model = path / "sparse" / "0"
    model.mkdir(parents=True)
    camera = struct.pack("<QIiQQ4d", 1, 7, model_number, WIDTH, HEIGHT, FX, FY, CX, CY)
    (model / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", VIEWS)
    for number, quat, translation, name in colmap_images():
        images += struct.pack("<I7dI", number, *quat, *translation, 7) + name.encode() + b"\0"
        seen = number % 3
        images += struct.pack("<Q", seen) + struct.pack("<ddq", 1.5, 2.5, -1) * seen
    (model / "images.bin").write_bytes(images)
    xyz, rgb = points()
    cloud = struct.pack("<Q", len(xyz))
    for i, (p, c) in enumerate(zip(xyz, rgb, strict=True)):
        track = i % 4
        cloud += struct.pack("<Q3d3BdQ", i, *p, *c.tolist(), 0.5, track)
        cloud += struct.pack("<II", 1, 0) * track
    (model / "points3D.bin").write_bytes(cloud)
    return path


def write_folder(path: Path) -> Path:
    write_images(path)
    write_ply(path / "points3D.ply", *points())
    (path / "cameras.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} {FX} {FY} {CX} {CY}\n")
    lines = ["# name tx ty tz qx qy qz qw"]
    for name, pose in zip(names(), world_from_cameras(), strict=True):
        w, x, y, z = quaternion(pose[:3, :3])
        numbers = " ".join(f"{value:.17g}" for value in [*pose[:3, 3], x, y, z, w])
        lines.append(f"{Path(name).name} {numbers}")
    (path / "poses.txt").write_text("\n".join(lines) + "\n")
    return path
