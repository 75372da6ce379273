"""Writes the demo's data set: fisheye images, lens, poses, points, labels, and truth."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from gsut._core import InputError, num_threads
from gsut.data import Frame, write_transforms
from gsut.data.points import format_points_ply
from gsut.files import whole_folder, write_picture
from gsut.lens import Camera
from gsut.run import Progress
from gsut.surface import save_mesh
from lab.demo_tracer.hall import Hall, make_hall
from lab.demo_tracer.hall_mesh import build_hall_mesh
from lab.demo_tracer.tracing import Tracer
from lab.demo_tracer.views import make_camera, plan_walk

SAMPLES_PER_SIDE = 4  # rays a pixel: a grid of 4 x 4
_BLOCK = 32  # pixels; rays of a block are traced together
_POINTS = 4000  # what structure from motion finds in such a scene
_POINTS_FILE = "points3D.ply"
_TRUTH_FILE = "truth.ply"  # the exact mesh
_POINT_NOISE = 0.01  # metres, standard deviation: as good as structure from motion gets
MILLIMETRES = 1000.0  # to a metre
NO_LABEL = 255  # of pixels outside the image circle


def make_demo_scene(
    folder: str | os.PathLike[str],
    views: int = 30,
    test_views: int = 5,
    size: int = 200,
    seed: int = 0,
    progress: bool = True,
    camera: Camera | None = None,
) -> Path:
    """Makes a small data set with exact truth: a furnished hall through a 190-degree fisheye.

    Writes a nerfstudio data set: transforms.json (OPENCV_FISHEYE, camera-to-world with OpenGL
    axes, metres, pixel centre 0.5), images/*.png, mask.png (255 where a pixel lies wholly inside
    the image circle), points3D.ply (4000 surface points that cameras see, off by 1 cm), depth/*.png
    of the test views (distance along the ray in mm, 16 bit, 0 outside the circle), labels/*.png of
    all views (8 bit: the number of the surface, 255 outside the circle; for `gsut lift`), truth.ply
    (the hall's surfaces as a mesh, for `gsut eval --geometry`).

    Args:
        folder: is created; appears only when it is complete.
        views: number of training images.
        test_views: number of held-out images, spread along the same path.
        size: width and height of the images, pixels.
        seed: of textures, camera path and points; the same seed gives the same bytes.
        progress: show a progress bar on stderr.
        camera: another lens, such as equirectangular; `size` then does not count.

    Returns:
        The folder.

    Raises:
        InputError: the folder exists or cannot be created, or a number is out of range.
    """
    folder = Path(folder)
    for name, value, least in (("views", views, 1), ("test_views", test_views, 0),
                               ("size", size, 16), ("seed", seed, 0)):  # fmt: skip
        if value < least:
            raise InputError(f"{name} is {value}; give at least {least}")
    with whole_folder(folder) as partial:
        _write_dataset(partial, views, test_views, camera or make_camera(size), seed, progress)
    return folder


def _write_dataset(
    folder: Path, views: int, test_views: int, camera: Camera, seed: int, progress: bool
) -> None:
    for name in ("images", "depth", "labels"):
        (folder / name).mkdir()
    hall = make_hall(seed)
    poses = plan_walk(views + test_views, seed)
    is_test = _mark_test_views(views, test_views)
    names = [f"{'test' if test else 'train'}_{i:03d}.png" for i, test in enumerate(is_test)]
    mask = find_whole_pixels(camera)
    (rays, inside), origins = camera.rays(), camera.origins()
    images = []
    for number, image in enumerate(render_views(hall, camera, poses, progress)):
        images.append(image)
        write_picture(folder / "images" / names[number], image[..., ::-1])
        labels = np.full(inside.shape, NO_LABEL, np.uint8)
        labels[inside] = find_labels(hall, poses[number], rays[inside], origins[inside])
        write_picture(folder / "labels" / names[number], labels)
        if is_test[number]:
            depth = np.zeros(inside.shape)
            depth[inside] = measure_distances(hall, poses[number], rays[inside], origins[inside])
            millimetres = np.round(depth * MILLIMETRES).astype(np.uint16)
            write_picture(folder / "depth" / names[number], millimetres)
    write_picture(folder / "mask.png", mask.astype(np.uint8) * 255)
    train = [i for i, test in enumerate(is_test) if not test]
    points, colors = sample_surfaces(
        hall, camera, mask, [poses[i] for i in train], [images[i] for i in train], seed
    )
    (folder / _POINTS_FILE).write_bytes(format_points_ply(points, colors))
    save_mesh(folder / _TRUTH_FILE, build_hall_mesh(hall))
    frames = [
        Frame(
            name, folder / "images" / name, camera, pose, mask_path=folder / "mask.png",
            depth_path=folder / "depth" / name if test else None,
        )
        for name, pose, test in zip(names, poses, is_test, strict=True)
    ]  # fmt: skip
    test_names = [name for name, test in zip(names, is_test, strict=True) if test]
    write_transforms(folder / "transforms.json", frames, points_file=_POINTS_FILE, test=test_names)


def measure_distances(
    hall: Hall, pose: np.ndarray, rays: np.ndarray, origins: np.ndarray | float = 0.0
) -> np.ndarray:
    """Measures exact distances (N,) in metres along unit rays of a camera at a pose (4, 4).

    Args:
        rays, origins: (N, 3) in the camera frame; origins 0 where all rays meet.
    """
    return Tracer(hall, 1).trace_depths(*_to_world(pose, rays, origins)).astype(np.float64)


def find_labels(
    hall: Hall, pose: np.ndarray, rays: np.ndarray, origins: np.ndarray | float = 0.0
) -> np.ndarray:
    """Finds the number (N,) of the surface that rays meet; arguments as of `measure_distances`."""
    return Tracer(hall, 1).trace_labels(*_to_world(pose, rays, origins))


def _to_world(
    pose: np.ndarray, rays: np.ndarray, origins: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    starts = np.broadcast_to(origins, rays.shape) @ pose[:3, :3].T + pose[:3, 3]
    return starts, rays @ pose[:3, :3].T


def _mark_test_views(views: int, test_views: int) -> list[bool]:
    """Marks the images of the path that are held out: evenly spread ones."""
    count = views + test_views
    is_test = [False] * count
    for i in range(test_views):
        is_test[int((i + 0.5) * count / test_views)] = True
    return is_test


def find_whole_pixels(camera: Camera) -> np.ndarray:
    """Finds pixels (H, W) whose four corners lie inside the image circle."""
    x, y = np.meshgrid(np.arange(camera.width + 1.0), np.arange(camera.height + 1.0))
    valid = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))[1].reshape(x.shape)
    return valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]


def _sample_rays(
    camera: Camera, samples_per_side: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples float32 rays (S, H, W, 3) and origins on a grid in each pixel; (S, H, W) validity."""
    steps = (np.arange(samples_per_side) + 0.5) / samples_per_side
    shape = (-1, camera.height, camera.width)
    samples = []
    for dy, dx in itertools.product(steps, steps):
        x, y = np.meshgrid(np.arange(camera.width) + dx, np.arange(camera.height) + dy)
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        samples.append((*camera.unproject(pixels), *camera.ray_origins(pixels)))
    rays, valid, origins, _ = map(np.stack, zip(*samples, strict=True))
    numbers = (np.nan_to_num(a).astype(np.float32).reshape(*shape, 3) for a in (rays, origins))
    return (*numbers, valid.reshape(shape))


def render_views(
    hall: Hall, camera: Camera, poses: list[np.ndarray], progress: bool,
    samples_per_side: int = SAMPLES_PER_SIDE,
) -> Iterator[np.ndarray]:  # fmt: skip
    """Renders uint8 RGB images (H, W, 3), one for each pose, black outside the image circle."""
    rays, origins, valid = _sample_rays(camera, samples_per_side)
    share = valid.mean(axis=0)
    tracer = Tracer(hall, samples_per_side**2)
    blocks = [
        (slice(y, y + _BLOCK), slice(x, x + _BLOCK))
        for y in range(0, camera.height, _BLOCK)
        for x in range(0, camera.width, _BLOCK)
    ]

    def trace_block(pose: np.ndarray, block: tuple[slice, slice]) -> np.ndarray:
        colors = np.zeros((*share[block].shape, 3))
        seen = share[block] > 0
        if seen.any():
            # A sample without a ray takes the middle of the others, and counts as black.
            known = valid[:, block[0], block[1]][:, seen][..., None]
            directions, starts = (a[:, block[0], block[1]][:, seen] for a in (rays, origins))
            directions = np.where(known, directions, directions.sum(axis=0))
            directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
            turn, place = pose[:3, :3].T.astype(np.float32), pose[:3, 3]
            if not camera.is_central:
                middle = starts.sum(axis=0) / known.sum(axis=0)
                place = place + np.where(known, starts, middle) @ turn
            seen_colors = tracer.trace_colors(place, directions @ turn)
            colors[seen] = seen_colors * share[block][seen][:, None]
        return np.round(np.clip(colors, 0, 1) * 255).astype(np.uint8)

    with ThreadPoolExecutor(num_threads()) as pool:
        for pose in Progress(progress).iterate("ray-casting the demo scene", poses):
            image = np.zeros((camera.height, camera.width, 3), dtype=np.uint8)
            results = pool.map(trace_block, itertools.repeat(pose), blocks)
            for block, colors in zip(blocks, results, strict=True):
                image[block] = colors
            yield image


def sample_surfaces(
    hall: Hall,
    camera: Camera,
    mask: np.ndarray,
    poses: list[np.ndarray],
    images: list[np.ndarray],
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Samples world points (N, 3) on surfaces that the training views see, and colours (N, 3)."""
    rng = np.random.default_rng([seed, 2])
    rays, origins = camera.rays()[0], camera.origins()
    pixels = np.argwhere(mask)
    points, colors = [], []
    for i, (pose, image) in enumerate(zip(poses, images, strict=True)):
        count = _POINTS // len(poses) + (i < _POINTS % len(poses))
        row, column = pixels[rng.integers(0, len(pixels), count)].T
        ray, start = rays[row, column], origins[row, column]
        away = measure_distances(hall, pose, ray, start)
        turn = pose[:3, :3].T
        points.append(pose[:3, 3] + start @ turn + away[:, None] * (ray @ turn))
        colors.append(image[row, column])
    exact = np.concatenate(points)
    return exact + _POINT_NOISE * rng.standard_normal(exact.shape), np.concatenate(colors)
