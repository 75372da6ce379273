"""A made street: rooms like the demo's hall in a grid, with doors; ray-cast view by view."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut.data import Frame, write_transforms
from gsut.data.points import format_points_ply
from gsut.demo.dataset import whole_pixels
from gsut.demo.hall import HALF_X, HALF_Y, make_hall
from gsut.demo.shapes import Rays
from gsut.demo.texture import to_srgb
from gsut.demo.tracing import Tracer
from gsut.demo.views import camera_path, demo_camera
from gsut.files import whole_folder, write_picture

_SEEDS = 2  # of textures, that alternate
_STEP = (2 * HALF_X, 2 * HALF_Y)  # from room to room, metres
# Doors: where they are along the walls at +-x and at +-y, half their width and their height.
_DOOR_Y, DOOR_X, _HALF_WIDTH, _DOOR_HEIGHT = 1.05, 2.15, 0.42, 2.1
_MOST_DOORS = 8  # that a ray goes through
_SIDE = 2  # rays a pixel along a side
_POINTS = 4000  # a room


class Street:
    """Rooms on a grid.

    Args:
        rooms: how many; the grid is as square as it gets.
        across: rooms of a row, or None.
        seeds: of textures, that alternate.
    """

    def __init__(self, rooms: int, across: int | None = None, seeds: int = _SEEDS) -> None:
        self.rooms = rooms
        self._across = across or math.isqrt(rooms - 1) + 1
        self._tracers = [Tracer(make_hall(seed), 1) for seed in range(min(seeds, rooms))]

    def center(self, room: np.ndarray | int) -> np.ndarray:
        """(..., 3) of the floor of rooms."""
        x, y = np.asarray(room) % self._across, np.asarray(room) // self._across
        return np.stack([x * _STEP[0], y * _STEP[1], 0.0 * x], axis=-1)

    def trace(
        self, room: int | np.ndarray, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light (N, 3) and distance (N,) along unit directions (N, 3) from points of rooms."""
        count = len(directions)
        light, distance = np.zeros((count, 3), np.float32), np.zeros(count)
        rooms = np.broadcast_to(room, count).copy()
        starts, open_ = origins.copy(), np.arange(count)
        for _ in range(_MOST_DOORS + 1):
            on = []
            for each in np.unique(rooms[open_]):
                rows = open_[rooms[open_] == each]
                rays = starts, directions, rooms
                on.append(self._in_room(int(each), rows, *rays, light, distance))
            open_ = np.concatenate(on)
            if not len(open_):
                break
        return light, distance

    def _in_room(self, room, rows, starts, directions, rooms, light, distance) -> np.ndarray:
        """Ends rays in their room; the rows of those that go on through a door."""
        kind = (room % self._across + room // self._across) % len(self._tracers)
        tracer, middle = self._tracers[kind], self.center(room)
        ends = ((starts[rows] - middle).astype(np.float32), directions[rows].astype(np.float32))
        rays = Rays(*(tuple(np.ascontiguousarray(a.T)) for a in ends))
        about = ends[0].mean(axis=0)
        around = float(np.linalg.norm(ends[0] - about, axis=1).max())
        away, number = tracer._first_hit(rays, tracer._bounds.in_cone(about, ends[1], around))
        points = rays.at(away)
        distance[rows] += away
        following = np.where(number < 0, self._behind(room, points), -1)
        ended = np.flatnonzero(following < 0)
        normal, albedo, emission = tracer._surfaces(tuple(p[ended] for p in points), number[ended])
        lit = tracer._light(tuple(p[ended] for p in points), normal)
        glow = emission[:, None]
        light[rows[ended]] = np.where(glow > 0, glow * albedo, albedo * lit)
        on = rows[following >= 0]
        step = np.float32(1e-3)  # through the wall, which is thin
        starts[on] = (np.stack(points, axis=1) + middle)[following >= 0] + step * directions[on]
        rooms[on] = following[following >= 0]
        return on

    def _behind(self, room: int, points) -> np.ndarray:
        """(N,) the room behind a door at points of the walls, -1 where there is none."""
        x, y, z = points
        column, row = room % self._across, room // self._across
        out = np.full(len(x), -1)
        at_x = np.abs(x) > HALF_X - 1e-3
        in_x = at_x & (np.abs(y - _DOOR_Y) < _HALF_WIDTH) & (z < _DOOR_HEIGHT)
        at_y = ~at_x & (np.abs(y) > HALF_Y - 1e-3)
        in_y = at_y & (np.abs(x - DOOR_X) < _HALF_WIDTH) & (z < _DOOR_HEIGHT)
        for here, side, steps in ((in_x, x, (1, 0)), (in_y, y, (0, 1))):
            for sign in (-1, 1):
                new = column + sign * steps[0], row + sign * steps[1]
                other = new[0] + new[1] * self._across
                if 0 <= new[0] < self._across and new[1] >= 0 and other < self.rooms:
                    out[here & (sign * side > 0)] = other
        return out


class RoomsTracer:
    """Traces pixels, as `Tracer`, in rooms one behind the other, along y."""

    def __init__(self, rooms: int) -> None:
        self._street = Street(rooms, across=1, seeds=rooms)

    def colors(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(P, 3) sRGB in [0, 1] of rays (samples, P, 3) from points of the same shape."""
        rays = directions.reshape(-1, 3).astype(np.float64)
        starts = origin.reshape(-1, 3).astype(np.float64)
        room = np.floor(starts[:, 1] / _STEP[1] + 0.5).astype(int)
        light, _ = self._street.trace(room.clip(0, self._street.rooms - 1), starts, rays)
        return to_srgb((1 - np.exp(-light)).reshape(directions.shape).mean(axis=0))


def write_street(folder: Path, rooms: int, views: int, size: int) -> None:
    """Writes a dataset; one image is in memory at a time.

    Args:
        folder: is created; appears only when it is complete.
        rooms: see `Street`.
        views: a room, two of them held out.
        size: of the images, pixels.
    """
    street, camera = Street(rooms), demo_camera(size)
    with whole_folder(folder) as partial:
        (partial / "images").mkdir()
        mask = whole_pixels(camera)
        write_picture(partial / "mask.png", mask.astype(np.uint8) * 255)
        frames, test, points, colors = [], [], [], []
        for name, pose, image, seen in _views(street, camera, views, mask):
            write_picture(partial / "images" / name, image[..., ::-1])
            path = partial / "images" / name
            frames.append(Frame(name, path, camera, pose, mask_path=partial / "mask.png"))
            if name.startswith("test"):
                test.append(name)
            else:
                points.append(seen[0])
                colors.append(seen[1])
        found = format_points_ply(np.concatenate(points), np.concatenate(colors))
        (partial / "points3D.ply").write_bytes(found)
        write_transforms(partial / "transforms.json", frames, points_file="points3D.ply", test=test)


def _views(street: Street, camera, views: int, mask: np.ndarray) -> Iterator[tuple]:
    """Name, pose, image and some points with colours, of each view."""
    rays, share = _sample_rays(camera)
    inside = share > 0
    held_out = {views // 4, 3 * views // 4}
    for room in range(street.rooms):
        rng = np.random.default_rng([room, 7])
        for number, pose in enumerate(camera_path(views, room)):
            pose = pose.copy()
            pose[:3, 3] += street.center(room)
            directions = rays[:, inside] @ pose[:3, :3].T
            origins = np.broadcast_to(pose[:3, 3], directions.shape)
            light, distance = street.trace(room, origins.reshape(-1, 3), directions.reshape(-1, 3))
            shown = to_srgb((1 - np.exp(-light)).reshape(directions.shape).mean(axis=0))
            image = np.zeros((*inside.shape, 3), np.uint8)
            image[inside] = np.round(255 * np.clip(shown * share[inside][:, None], 0, 1))
            chosen = np.flatnonzero(mask[inside])
            chosen = rng.choice(chosen, min(len(chosen), -(-_POINTS // views)), replace=False)
            away = distance.reshape(directions.shape[:2])[0, chosen]
            points = pose[:3, 3] + away[:, None] * directions[0, chosen]
            kind = "test" if number in held_out else "train"
            yield (
                f"{kind}_{room:03d}_{number:03d}.png",
                pose,
                image,
                (points, image[inside][chosen]),
            )


def _sample_rays(camera) -> tuple[np.ndarray, np.ndarray]:
    """(S, H, W, 3) unit rays on a grid in each pixel, and (H, W) the share that has one."""
    steps = (np.arange(_SIDE) + 0.5) / _SIDE
    all_rays, all_valid = [], []
    for dy in steps:
        for dx in steps:
            x, y = np.meshgrid(np.arange(camera.width) + dx, np.arange(camera.height) + dy)
            found, valid = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
            all_rays.append(np.nan_to_num(found).reshape(camera.height, camera.width, 3))
            all_valid.append(valid.reshape(camera.height, camera.width))
    rays, valid = np.stack(all_rays), np.stack(all_valid)
    middle = (rays * valid[..., None]).sum(axis=0)
    rays = np.where(valid[..., None], rays, middle)  # which counts as black
    return rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-9), valid.mean(axis=0)
