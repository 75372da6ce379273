"""Ray-traces a textured room with pillars, exactly: any lens, any path, depth of every ray."""

from __future__ import annotations

import functools
import json
import math
from pathlib import Path

import cv2
import numpy as np

import gsut
from gsut.data import Frame, write_transforms
from gsut.data.points import format_points_ply

# Corners (low, high) in metres: the room, seen from within, then what stands in it.
ROOM = ((-4.0, -3.0, 0.0), (4.0, 3.0, 3.5))
_THINGS = (
    ((-0.9, -0.5, 0.0), (0.9, 0.5, 0.8)),  # a table in the middle of the walk
    ((-3.6, -2.7, 0.0), (-3.1, -2.2, 3.5)),
    ((3.2, 2.0, 0.0), (3.7, 2.5, 3.5)),
    ((3.3, -2.6, 0.0), (3.9, -1.4, 1.1)),
    ((-3.9, 1.5, 0.0), (-3.3, 2.8, 1.6)),
    ((-0.4, 2.6, 0.0), (1.0, 2.95, 2.2)),
)
_TEXELS = 1024  # of the texture's side, which is repeated
_TEXEL = 0.012  # metres
_SAMPLES = 3  # a side of a pixel


@functools.cache
def _draw_textures(seed: int, boxes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws a texture, and of each side of each box its tint and place in the texture."""
    rng = np.random.default_rng(seed)
    noise = np.zeros((_TEXELS, _TEXELS, 3))
    for cells in (12, 32, 80, 160):
        coarse = rng.uniform(-1, 1, (cells, cells, 3)).astype(np.float32)
        noise += cv2.resize(coarse, (_TEXELS, _TEXELS), interpolation=cv2.INTER_CUBIC)
    tints = rng.uniform(0.25, 0.75, (boxes, 6, 3))
    return noise / 2.5, tints, rng.integers(0, _TEXELS, (boxes, 6, 2))


class BoxRoom:
    """The room with textures drawn from a seed."""

    def __init__(self, seed: int = 0) -> None:
        self._boxes = np.array([ROOM, *_THINGS])
        self._texture, self._tints, self._shifts = _draw_textures(seed, len(self._boxes))

    def trace(self, origins: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Finds distances (N,) in metres and colours (N, 3) in 0 to 1 along unit rays (N, 3)."""
        starts = np.broadcast_to(origins, rays.shape).T
        ways = np.ascontiguousarray(rays.T)
        distance, box = np.full(len(rays), np.inf), np.zeros(len(rays), int)
        with np.errstate(divide="ignore", invalid="ignore"):
            for number, (low, high) in enumerate(self._boxes):
                near, far = np.full(len(rays), -np.inf), np.full(len(rays), np.inf)
                for begin, end, start, way in zip(low, high, starts, ways, strict=True):
                    enter, leave = (begin - start) / way, (end - start) / way
                    np.maximum(near, np.fmin(enter, leave), out=near)
                    np.minimum(far, np.fmax(enter, leave), out=far)
                hit = far if number == 0 else np.where((near < far) & (near > 0), near, np.inf)
                box[hit < distance] = number
                distance = np.minimum(distance, hit)
        points = (starts + distance * ways).T
        side, least = np.zeros(len(rays), int), np.full(len(rays), np.inf)
        for number in range(6):  # low, then high along each axis
            edge = self._boxes[:, number // 3, number % 3]
            off = np.abs(points[:, number % 3] - edge[box])
            side[off < least] = number
            np.minimum(least, off, out=least)
        axis = side % 3
        across = np.stack([np.where(axis == 0, points[:, 1], points[:, 0]),
                           np.where(axis == 2, points[:, 1], points[:, 2])], axis=1)  # fmt: skip
        u, v = ((across / _TEXEL).astype(int) + self._shifts[box, side]).T % _TEXELS
        return distance, np.clip(self._tints[box, side] + 0.3 * self._texture[v, u], 0, 1)

    def measure_distances(self, camera: gsut.Camera, pose: np.ndarray) -> np.ndarray:
        """Measures (H, W) metres along the rays of a camera; NaN where it has none."""
        rays, valid = camera.rays()
        found = np.full(valid.shape, np.nan)
        turn = pose[:3, :3].T
        origins = pose[:3, 3] + camera.origins()[valid] @ turn
        found[valid] = self.trace(origins, rays[valid] @ turn)[0]
        return found

    def render(self, camera: gsut.Camera, pose: np.ndarray) -> np.ndarray:
        """Renders (H, W, 3) uint8 RGB at a world-from-camera pose; black where there is no ray."""
        steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        total = np.zeros((camera.height * camera.width, 3))
        row, column = np.indices((camera.height, camera.width)).reshape(2, -1)
        for dy in steps:
            for dx in steps:
                pixels = np.stack([column + dx, row + dy], axis=1)
                rays, valid = camera.unproject(pixels)
                turn = pose[:3, :3].T
                origins = pose[:3, 3] + camera.ray_origins(pixels)[0][valid] @ turn
                total[valid] += self.trace(origins, rays[valid] @ turn)[1]
        image = np.round(255 * total / _SAMPLES**2).astype(np.uint8)
        return image.reshape(camera.height, camera.width, 3)


def make_fisheye(size: int) -> gsut.Camera:
    """Makes a 190-degree fisheye for square images of `size` pixels a side."""
    params = [size * value for value in (0.2782, 0.2786, 0.5031, 0.4974)]
    params += [0.03, -0.01, 0.003, -0.0005]
    return gsut.Camera(
        "kannala_brandt", params, size, size, valid_field_angle=math.radians(95.0)
    )  # fmt: skip


def make_rig_of_two(size: int) -> dict[str, tuple[gsut.Camera, np.ndarray, str]]:
    """Makes two fisheyes 24 cm beside each other, as `write_box_rig` takes them."""
    params = [0.3315, 0.3309, 0.4952, 0.5041]
    right = gsut.Camera(
        "kannala_brandt", [*(size * p for p in params), -0.012, 0.004, -0.002, 0.0003], size, size,
        valid_field_angle=math.radians(80.0),
    )  # fmt: skip
    return {
        "left": (make_fisheye(size), np.eye(4), "left.yaml"),
        "right": (right, place_right(), "right.yaml"),
    }


def place_right() -> np.ndarray:
    """Returns the pose (4, 4) of the right camera of two from the left one, in metres."""
    pose = gsut.exp_pose([0.0, 0.0, 0.0, 0.03, 0.12, -0.02])
    pose[:3, 3] = -pose[:3, :3] @ [0.24, 0.01, -0.02]
    return pose


def plan_walk(count: int, share: float = 1.0) -> list[np.ndarray]:
    """Plans world-from-camera poses (4, 4) on the first `share` of two rounds of the table."""
    poses = []
    for turn in 2 * math.pi * share * np.arange(count) / count:
        reach = 1.0 + 0.2 * math.sin(3 * turn + 1)
        x, y = 2.1 * reach * math.cos(2 * turn), 1.6 * reach * math.sin(2 * turn)
        z = 1.5 + 0.35 * math.sin(5 * turn + 2)
        yaw = 2 * turn + math.pi / 2 + 1.4 * math.sin(7 * turn + 3)
        pitch = -0.1 + 0.3 * math.sin(4 * turn)
        forward = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch),
                            math.sin(pitch)])  # fmt: skip
        right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = x, y, z
        poses.append(pose)
    return poses


def find_whole_pixels(camera: gsut.Camera) -> np.ndarray:
    """Finds pixels (H, W) whose four corners have rays."""
    y, x = np.mgrid[: camera.height + 1, : camera.width + 1].astype(float)
    valid = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))[1].reshape(x.shape)
    return valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]


def sample_points(
    room: BoxRoom, camera: gsut.Camera, poses: list[np.ndarray], count: int = 4000
) -> tuple[np.ndarray, np.ndarray]:
    """Samples points (N, 3) that cameras see, off by 1 cm, and their colours (N, 3) uint8."""
    rng = np.random.default_rng(2)
    rays, valid = camera.rays()
    pixels, points, colors = np.argwhere(valid), [], []
    for pose in poses:
        row, column = pixels[rng.integers(0, len(pixels), count // len(poses))].T
        directions = rays[row, column] @ pose[:3, :3].T
        origins = pose[:3, 3] + camera.origins()[row, column] @ pose[:3, :3].T
        away, color = room.trace(origins, directions)
        points.append(origins + away[:, None] * directions)
        colors.append(np.round(255 * color).astype(np.uint8))
    exact = np.concatenate(points)
    return exact + 0.01 * rng.standard_normal(exact.shape), np.concatenate(colors)


def write_box_room(
    folder: Path, camera: gsut.Camera, poses: list[np.ndarray], test: tuple[int, ...] = ()
) -> Path:
    """Writes a nerfstudio data set of the room: images, a mask, points; `test` is held out."""
    (folder / "images").mkdir(parents=True)
    room, frames = BoxRoom(), []
    cv2.imwrite(str(folder / "mask.png"), 255 * find_whole_pixels(camera).astype(np.uint8))
    for number, pose in enumerate(poses):
        file = folder / "images" / f"{number:03d}.png"
        cv2.imwrite(str(file), room.render(camera, pose)[..., ::-1])
        frames.append(Frame(file.name, file, camera, pose, mask_path=folder / "mask.png"))
    train = [pose for number, pose in enumerate(poses) if number not in test]
    points = sample_points(room, camera, train)
    (folder / "points3D.ply").write_bytes(format_points_ply(*points))
    names = [frames[number].name for number in test]
    write_transforms(folder / "transforms.json", frames, points_file="points3D.ply", test=names)
    return folder


def write_box_rig(
    folder: Path, rig: dict[str, tuple[gsut.Camera, np.ndarray, str]], poses: list[np.ndarray]
) -> Path:
    """Writes what cameras on one body see of the room, with rig.json, lens files and truth.

    Args:
        folder: is created.
        rig: by camera name its lens, camera_from_reference (4, 4), and the name of its lens file.
        poses: of the body's reference camera.
    """
    room, frames, cameras = BoxRoom(), [], {}
    for name, (lens, camera_from_reference, lens_file) in rig.items():
        for kind in ("images", "depth"):
            (folder / kind / name).mkdir(parents=True)
        (folder / lens_file).parent.mkdir(exist_ok=True)
        gsut.save_camera(lens, folder / lens_file)
        mask = folder / "images" / name / "mask.png"
        cv2.imwrite(str(mask), 255 * find_whole_pixels(lens).astype(np.uint8))
        cameras[name] = {
            "file": lens_file, "camera_from_reference": camera_from_reference.tolist()
        }  # fmt: skip
        for number, body in enumerate(poses):
            pose = body @ np.linalg.inv(camera_from_reference)
            image, depth = (folder / kind / name / f"{number:03d}.png" for kind in
                            ("images", "depth"))  # fmt: skip
            cv2.imwrite(str(image), room.render(lens, pose)[..., ::-1])
            millimetres = np.nan_to_num(1000 * room.measure_distances(lens, pose))
            cv2.imwrite(str(depth), np.round(millimetres).astype(np.uint16))
            frames.append(
                Frame(f"{name}/{number:03d}", image, lens, pose, mask_path=mask,
                                depth_path=depth)
            )  # fmt: skip
    (folder / "rig.json").write_text(json.dumps({"cameras": cameras}))
    write_transforms(folder / "transforms.json", frames)
    return folder
