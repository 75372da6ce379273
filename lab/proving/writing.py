"""Renders a capture and writes it: exact truth, and beside it what gsut is given."""

from __future__ import annotations

import dataclasses
import fractions
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gsut_proving_tracer
import numpy as np

from gsut._core import Shutter
from gsut.data import Frame, write_transforms
from gsut.data.points import format_points_ply
from gsut.files import whole_folder, write_picture
from gsut.lens import save_camera
from lab.mistakes import MISTAKES, copy_of, write
from lab.proving.capture import VERSION, Capture
from lab.proving.exposure import encode_picture, measure_exposure
from lab.proving.world import MOVER
from tests.bench.walk_film import spread_rays

TRUTH = "truth"  # an ordinary dataset: exact poses, lens, points, masks of the circle
GIVEN = "given"  # what gsut is given: a dataset, a folder of photographs, or film.mp4
FACTS = "capture.json"
_TURNED = "turned"  # photographs on their side, as a camera that is held upright writes them
_ORDERS = ("top_to_bottom", "bottom_to_top")  # of lines along the rows
_POINTS = 1500
_POINT_NOISE = 3e-3  # of the distance, as of structure from motion in small pictures
_DEPTH_LEVELS = 60_000  # of the 16-bit depth pictures: level 0 is the sky


class Picture(NamedTuple):
    """One picture before it is encoded, and its truth."""

    image: np.ndarray  # (H, W, 3) uint8, as the camera makes it
    clean: np.ndarray  # the same without noise and compression
    distance: np.ndarray  # (H, W) metres along the ray, infinite: sky; NaN: outside the circle
    body: np.ndarray  # (H, W): -1 sky, 0 what stands still, MOVER


def find_cache() -> Path:
    """Returns the folder of made captures, outside the repository."""
    default = Path.home() / ".cache" / "gsut-proving"
    return Path(os.environ.get("GSUT_PROVING_CACHE", default)) / f"version-{VERSION}"


def find_line_poses(capture: Capture, time: float, share: np.ndarray) -> np.ndarray:
    """Returns world-from-camera of lines: `share` from 0, the first, to 1, the last."""
    return capture.path(time + (np.asarray(share) - 0.5) * capture.readout)


def find_shares(capture: Capture, pixels: np.ndarray) -> np.ndarray:
    """Returns (N,) the shares of the lines that pixels (N, 2) lie on, see `find_line_poses`."""
    camera = capture.lens.camera
    if capture.is_upright:
        return np.asarray(pixels)[:, 0] / camera.width
    return np.asarray(pixels)[:, 1] / camera.height


class _Grid(NamedTuple):
    """The rays of a lens."""

    samples: np.ndarray  # (samples, H, W, 3), all over each pixel
    middle: np.ndarray  # (H, W, 3) of the pixels' centres, 0 outside the circle
    inside: np.ndarray  # (H, W) bool
    spread: float  # radians between neighbours


def _spread_grid(capture: Capture) -> _Grid:
    camera = capture.lens.camera
    height, width = camera.height, camera.width
    rays = spread_rays(camera, capture.samples)
    centre = rays[0, height // 2, width // 2 : width // 2 + 2].astype(np.float64)
    middle = np.nan_to_num(camera.rays()[0]).astype(np.float32).reshape(height, width, 3)
    inside = middle.any(axis=2) & rays.any(axis=3).all(axis=0)
    return _Grid(rays, middle, inside, float(np.linalg.norm(centre[1] - centre[0])))


def _trace_lines(
    tracer: gsut_proving_tracer.Tracer,
    poses: np.ndarray,
    rays: np.ndarray,
    grid: _Grid,
    seed: int,
    with_light: bool = True,
) -> list[np.ndarray]:
    """Traces rays (S, H, W, 3) inside the circle: light, distance and body, each (S, M, ...).

    Args:
        tracer: of the stage.
        poses: (S, H or 1, W or 1, 4, 4) world-from-camera of each pixel.
        rays: in the camera's axes.
        grid: the lens.
        seed: of what is drawn.
        with_light: False: the light is black, in less time.
    """
    poses, inside = poses.astype(np.float32), grid.inside
    directions = np.einsum("slcij,slcj->slci", np.broadcast_to(
        poses[..., :3, :3], (*rays.shape[:3], 3, 3)), rays)[:, inside]  # fmt: skip
    origins = np.broadcast_to(poses[..., :3, 3], rays.shape)[:, inside]
    flat = origins.reshape(-1, 3), directions.reshape(-1, 3)
    found = tracer.trace(*flat, grid.spread, seed, len(rays), with_light)
    return [part.reshape(len(rays), -1, *part.shape[1:]) for part in found]


def trace_pictures(capture: Capture) -> Iterator[Picture]:
    """Yields the pictures of a capture."""
    sensor, samples, grid = capture.sensor, capture.samples, _spread_grid(capture)
    rays, middle, inside = grid.samples, grid.middle, grid.inside
    height, width = inside.shape
    gains = sensor.find_gains(capture.motion.frames, capture.seed)
    falloff = sensor.spread_falloff(height, width)
    count, shape = (width, (1, width)) if capture.is_upright else (height, (height, 1))
    lines = (np.arange(count) + 0.5) / count
    order = np.argsort(np.arange(samples) * 0.618 % 1.0)  # neighbouring samples far apart in time
    moments = ((order + 0.5) / samples - 0.5) * capture.exposure
    still = None if capture.stage.movers else capture.stage.mesh.make_tracer(capture.stage.sky)
    exposure = 0.0
    for number, time in enumerate(capture.times):
        tracer = still or capture.stage.mesh.combine(capture.stage.movers(time)).make_tracer(
            capture.stage.sky
        )
        seed = capture.seed * 1000 + number

        def trace(rays, moments, with_light, tracer=tracer, time=time, seed=seed):
            poses = np.stack([find_line_poses(capture, time + m, lines) for m in moments])
            poses = poses.reshape(len(moments), *shape, 4, 4)
            return _trace_lines(tracer, poses, rays, grid, seed, with_light)

        light = np.zeros((height, width, 3))
        light[inside] = trace(rays, moments, True)[0].mean(axis=0)
        _, away, of = trace(middle[None], np.zeros(1), False)
        distance, body = np.full((height, width), np.nan), np.full((height, width), -1, np.int32)
        distance[inside], body[inside] = away[0], of[0]
        exposure = exposure or measure_exposure(light[inside])
        light *= exposure * gains[number] * falloff
        noise = np.random.default_rng([capture.seed, 31, number])
        image, clean = (sensor.develop(light, rng) * inside[..., None] for rng in (noise, None))
        yield Picture(image.astype(np.uint8), clean.astype(np.uint8), distance, body)


def trace_views(
    capture: Capture, world_from_camera: Sequence[np.ndarray]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields what the camera would see elsewhere, were it perfect and all at rest.

    Args:
        capture: with the lens and the stage, whose movers are left out.
        world_from_camera: (4, 4) of each view.

    Yields:
        (H, W, 3) uint8 and (H, W) bool, inside the circle of the lens.
    """
    grid = _spread_grid(capture)
    tracer = capture.stage.mesh.make_tracer(capture.stage.sky)
    for number, pose in enumerate(world_from_camera):
        poses = np.broadcast_to(pose, (capture.samples, 1, 1, 4, 4))
        light = np.zeros((*grid.inside.shape, 3))
        light[grid.inside] = _trace_lines(tracer, poses, grid.samples, grid, number)[0].mean(axis=0)
        light *= measure_exposure(light[grid.inside])
        yield capture.sensor.develop(light, None) * grid.inside[..., None], grid.inside


def write_capture(capture: Capture, folder: Path) -> Path:
    """Renders a capture into a folder that appears only when it is complete."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with whole_folder(folder) as partial:
        frames = _write_truth(capture, partial / TRUTH)
        _write_given(capture, partial, frames)
        facts = capture.list_factors() | {"told": dataclasses.asdict(capture.told)}
        (partial / FACTS).write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return folder


def make_capture(capture: Capture, cache: Path | None = None) -> Path:
    """Returns the folder of a capture in the cache, rendered if it is not there."""
    folder = (cache or find_cache()) / f"{capture.seed:07d}"
    return folder if folder.is_dir() else write_capture(capture, folder)


def _write_truth(capture: Capture, folder: Path) -> list[Frame]:
    is_film = capture.kind == "film"
    for name in ("images", "clean", "depth", "bodies"):
        (folder / name).mkdir(parents=True)
    shutter = _describe_shutter(capture)
    exif = None
    if capture.told.focal_35mm is not None:
        exif = {"make": "Maker", "model": "Model", "focal_35mm": capture.told.focal_35mm}
    suffix = "png" if is_film or capture.sensor.quality == 0 else "jpg"
    frames, seen, colors, exposed = [], [], [], []
    stated = _state_places(capture)
    for number, picture in enumerate(trace_pictures(capture)):
        path = folder / "images" / f"{number:03d}.{suffix}"
        quality = 0 if is_film else capture.sensor.quality
        path.write_bytes(encode_picture(picture.image, quality, exif, stated[number]))
        if capture.told.turned and quality:
            aside = folder.parent / _TURNED / path.name
            aside.parent.mkdir(exist_ok=True)
            aside.write_bytes(encode_picture(picture.image, quality, exif, stated[number], True))
        exposed.append(picture.image)
        write_picture(folder / "clean" / f"{number:03d}.png", picture.clean[..., ::-1])
        _write_truth_maps(folder, number, picture)
        time = float(capture.times[number])
        # First and last in time, which is upwards where the readout is negative.
        ends = np.array([0.0, 0.5, 1.0]) if capture.readout >= 0 else np.array([1.0, 0.5, 0.0])
        start, middle, end = find_line_poses(capture, time, ends)
        frames.append(
            Frame(
                f"{number:03d}", path, capture.lens.camera, middle,
                start if shutter else None, end if shutter else None, shutter=shutter, time=time,
            )
        )  # fmt: skip
        points, paint = _pick_points(capture, number, time, picture)
        seen.append(points)
        colors.append(paint)
    if np.isnan(picture.distance).any():
        mask = np.isfinite(picture.distance) | np.isinf(picture.distance)
        write_picture(folder / "mask.png", mask.astype(np.uint8) * 255)
        frames = [dataclasses.replace(frame, mask_path=folder / "mask.png") for frame in frames]
    xyz, rgb = np.concatenate(seen), np.concatenate(colors)
    (folder / "points3D.ply").write_bytes(format_points_ply(xyz, rgb))
    write_transforms(folder / "transforms.json", frames, points_file="points3D.ply")
    if is_film:
        _write_film(folder.parent / "film.mp4", exposed, capture)
    return frames


def _state_places(capture: Capture) -> list[np.ndarray | None]:
    """States the place of each picture with noise, or None."""
    error, count = capture.told.place_error, capture.motion.frames
    if error is None:
        return [None] * count
    off = error * np.random.default_rng([capture.seed, 63]).standard_normal((count, 3))
    return list(capture.path(capture.times)[:, :3, 3] + off)


def _describe_shutter(capture: Capture) -> Shutter | None:
    if capture.readout == 0:
        return None
    orders = ("left_to_right", "right_to_left") if capture.is_upright else _ORDERS
    return Shutter(orders[int(capture.readout < 0)])


def _write_truth_maps(folder: Path, number: int, picture: Picture) -> None:
    finite = np.isfinite(picture.distance)
    farthest = float(picture.distance[finite].max()) if finite.any() else 1.0
    depth = np.zeros(finite.shape, np.uint16)
    depth[finite] = np.maximum(1, np.round(picture.distance[finite] / farthest * _DEPTH_LEVELS))
    write_picture(folder / "depth" / f"{number:03d}.png", depth)
    (folder / "depth" / f"{number:03d}.txt").write_text(f"{farthest!r}\n", encoding="utf-8")
    write_picture(folder / "bodies" / f"{number:03d}.png", (picture.body + 1).astype(np.uint8) * 60)


def _pick_points(
    capture: Capture, number: int, time: float, picture: Picture
) -> tuple[np.ndarray, np.ndarray]:
    """Picks points on surfaces that stand still, off by noise, with their colours."""
    rng = np.random.default_rng([capture.seed, 41, number])
    good = np.isfinite(picture.distance) & (picture.body >= 0) & (picture.body != MOVER)
    rows, columns = np.nonzero(good)
    if len(rows) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    chosen = rng.choice(len(rows), min(len(rows), _POINTS // capture.motion.frames), replace=False)
    rows, columns = rows[chosen], columns[chosen]
    pixels = np.stack([columns, rows], axis=1) + 0.5
    rays, _ = capture.lens.camera.unproject(pixels)
    away = picture.distance[rows, columns] * (1 + _POINT_NOISE * rng.standard_normal(len(rows)))
    poses = find_line_poses(capture, time, find_shares(capture, pixels))
    xyz = np.einsum("nij,nj->ni", poses[:, :3, :3], rays * away[:, None]) + poses[:, :3, 3]
    return xyz, picture.image[rows, columns]


def _write_film(target: Path, pictures: list[np.ndarray], capture: Capture) -> None:
    import av

    height, width = pictures[0].shape[:2]
    with av.open(str(target), "w") as out:
        rate = fractions.Fraction(1 / capture.motion.interval).limit_denominator(1001)
        # By one thread: several make other bits each time.
        options = {"crf": str(capture.sensor.crf), "threads": "1"}
        stream = out.add_stream("libx264", rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = width // 2 * 2, height // 2 * 2, "yuv420p"
        lost = np.random.default_rng([capture.seed, 64]).random(len(pictures))
        lost[[0, -1]] = 1.0  # the film keeps its length
        for number in np.flatnonzero(lost >= capture.told.dropped).tolist():
            cut = np.ascontiguousarray(pictures[number][: height // 2 * 2, : width // 2 * 2])
            frame = av.VideoFrame.from_ndarray(cut, format="rgb24")
            frame.pts, frame.time_base = number, 1 / rate
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))


def _write_given(capture: Capture, folder: Path, frames: list[Frame]) -> None:
    truth, given = folder / TRUTH, folder / GIVEN
    if capture.told.lens == "file":
        save_camera(capture.lens.camera, folder / "given.lens.json")
    if capture.kind == "dataset":
        values: dict[str, Any] = copy_of(truth, given)
        mistake = None if capture.told.mistake is None else MISTAKES[capture.told.mistake]
        possible = mistake is None or mistake.make(values, given) is not False
        write(values, given, capture.told.points or (mistake is not None and mistake.needs_points))
        (given / "mistake.txt").write_text(
            (mistake.name if mistake and possible else "none") + "\n", encoding="utf-8"
        )
        _relink(given, truth)
        return
    if capture.kind == "film":
        return
    given.mkdir()
    turned = folder / _TURNED
    for frame in frames:
        aside = turned / frame.image_path.name
        os.link(aside if aside.is_file() else frame.image_path, given / frame.image_path.name)
    if (truth / "mask.png").is_file():
        os.link(truth / "mask.png", given / "mask.png")


def _relink(given: Path, truth: Path) -> None:
    """Makes links relative, so that the folder may be moved into its place."""
    for each in given.iterdir():
        if each.is_symlink():
            name = each.name
            each.unlink()
            each.symlink_to(Path("..") / truth.name / name)
