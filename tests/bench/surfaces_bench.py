"""`./run bench surfaces`: meshes of exact depths, how fast they fuse, what `--surface` is worth."""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut import _core
from gsut.demo import make_demo_scene
from gsut.surface import geometry_figures
from tests.bench.report_rows import add_files, print_and_write

_RADIUS, _CENTER = 1.0, np.array([0.03, 0.02, 0.01])
_TWIST = np.array([0.06, -0.05, 0.04, 0.03, 0.05, -0.06])  # of a camera during its exposure
_FREE_WEIGHT = 0.1  # as in gsut mesh
COLUMNS = (
    ("what", "what", ""),
    ("PSNR [dB]", "psnr", ".2f"),
    ("AbsRel, expected [%]", "expected", ".2f"),
    ("median", "median", ".2f"),
    ("to 30 degrees", "ring0", ".2f"),
    ("30 to 60", "ring1", ".2f"),
    ("60 to 80", "ring2", ".2f"),
    ("from 80", "ring3", ".2f"),
    ("F at 2 cm", "fscore", ".2f"),
    ("farthest vertex [voxels]", "voxels_off", ".3f"),
    ("voxels across", "across", ".0f"),
    ("blocks", "blocks", ".0f"),
    ("CPU-s", "cpu_seconds", ".1f"),
    ("s", "seconds", ".1f"),
    ("most memory [MB]", "megabytes", ".0f"),
)
TRAININGS = (
    ("plain", False, "gaussian"),
    ("--surface", True, "gaussian"),
    ("surfels, --surface", True, "surfel"),
    ("surfels, as long", False, "surfel"),
    ("plain, as long", False, "gaussian"),
)
HELP = "meshes of exact depths through any lens, fusion's speed, depth with and without --surface"


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, help="a dataset with depth files, trained too")
    parser.add_argument("--steps", type=int, default=1000, help="of each training; 0: none [1000]")
    parser.add_argument("--views", type=int, default=60, help="that are fused for speed [60]")
    parser.add_argument("--size", type=int, default=480, help="of their images, pixels [480]")
    parser.add_argument(
        "--across", type=int, nargs="*", default=[250, 500, 1000],
        help="voxels across the ball that is fused for speed [250 500 1000]",
    )  # fmt: skip
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    rows = [ball_row(name, *lens) for name, lens in lenses().items()]
    for across in arguments.across:
        rows.append(fusion_row(across, arguments.views, arguments.size))
    if arguments.steps:
        with tempfile.TemporaryDirectory() as folder:
            hall = Path(folder) / "hall"
            make_demo_scene(hall)
            for data, truth in ((hall, hall / "truth.ply"), (arguments.data, None)):
                if data is not None:
                    rows += training_rows(data, truth, arguments.steps)
    print_and_write(rows, COLUMNS, arguments)
    return 0


def lenses() -> dict[str, tuple[Any, bool]]:
    """Name -> camera, and whether it moves during its exposure."""
    size = 220
    focal = size / np.radians(190.0)
    wide = gsut.Camera(
        "kannala_brandt", [focal, focal, size / 2, size / 2], size, size,
        valid_field_angle=np.radians(95.0),
    )  # fmt: skip
    splined = _example("splined_stereographic", 200)
    return {
        "ball, Kannala-Brandt of 190 degrees": (wide, False),
        "ball, splined": (splined, False),
        "ball, rolling shutter": (wide, True),
    }


def _example(model: str, width: int) -> Any:
    _, params, full_width, full_height = _core.camera_examples(model)[0]
    return gsut.Camera(model, params, full_width, full_height).resized(
        width, max(1, round(full_height * width / full_width))
    )


def _places(count: int, away: float) -> list[np.ndarray]:
    """Poses around the ball that look at it."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - z * z)
    poses = []
    for way in np.stack([across * np.cos(turn), across * np.sin(turn), z], 1):
        right = np.cross(way, [0.3, 0.5, 0.8])
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(-way, right), -way])
        pose[:3, 3] = -pose[:3, :3] @ (_CENTER + away * way)
        poses.append(pose)
    return poses


def _depth_of_ball(camera: Any, motion: Any) -> np.ndarray:
    """(H, W) exact distances; infinity: missed, NaN: no ray."""
    rays, valid = camera.rays()
    origins, lines = camera.origins(), camera.height
    times = (np.arange(lines) + 0.5) / lines
    depth = np.full(rays.shape[:2], np.nan)
    for row in range(lines):
        pose = motion.at(times[row]) if isinstance(motion, _core.CameraMotion) else motion
        offset = (origins[row] - pose[:3, 3]) @ pose[:3, :3] - _CENTER
        ray = rays[row] @ pose[:3, :3]
        b = np.sum(offset * ray, -1)
        root = b * b - np.sum(offset * offset, -1) + _RADIUS**2
        near = -b - np.sqrt(np.maximum(root, 0))
        depth[row] = np.where((root > 0) & (near > 0), near, np.inf)
    return np.where(valid, depth, np.nan).astype(np.float32)


def _fused(camera: Any, motions: list[Any], voxel: float) -> dict[str, float]:
    views = _core.DepthViews(list(_CENTER))
    for motion in motions:
        views.add(camera, motion, _depth_of_ball(camera, motion), None, None)
    wall, processor = time.perf_counter(), time.process_time()
    field = views.fuse(voxel, float("inf"), 4.0, _FREE_WEIGHT, 0)
    vertices, _ = field.mesh()
    off = np.abs(np.linalg.norm(vertices - _CENTER, axis=1) - _RADIUS) / voxel
    return {
        "voxels_off": float(off.max()),
        "across": 2 * _RADIUS / voxel,
        "blocks": len(field),
        "cpu_seconds": time.process_time() - processor,
        "seconds": time.perf_counter() - wall,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def ball_row(name: str, camera: Any, moves: bool) -> dict[str, Any]:
    """A ball seen by 24 cameras, 33 voxels across."""
    motions: list[Any] = _places(24, 1.6)
    if moves:
        how = gsut.Shutter("top_to_bottom")
        motions = [_core.CameraMotion(p, gsut.exp_pose(_TWIST) @ p, how) for p in motions]
    return _row(what=name, **_fused(camera, motions, 0.06))


def fusion_row(across: int, views: int, size: int) -> dict[str, Any]:
    """Time of fusing a ball that fills the images of a 90-degree fisheye, and its memory."""
    focal = size / np.radians(90.0)
    camera = gsut.Camera("kannala_brandt", [focal, focal, size / 2, size / 2], size, size)
    figures = _fused(camera, _places(views, 1.6), 2 * _RADIUS / across)
    return _row(what=f"fusion of {views} views of {size} x {size}", **figures)


def training_rows(data: Path, truth: Path | None, steps: int) -> list[dict[str, Any]]:
    """Trained plainly, with --surface, as surfels; without it for as many CPU-seconds as with."""
    scene = gsut.load_dataset(data)
    common = {"preset": "fast", "max_gaussians": 50_000}
    rows: list[dict[str, Any]] = []
    for name, surface, primitive in TRAININGS:
        steps_here = steps
        if "as long" in name:
            steps_here = round(steps * rows[1]["cpu_seconds"] / rows[0]["cpu_seconds"])
        options = gsut.TrainOptions(
            **common, steps=steps_here, surface=surface, primitive=primitive
        )
        processor = time.process_time()
        result = gsut.train(scene, options, progress=sys.stderr.isatty())
        taken = time.process_time() - processor
        found = geometry_figures(
            result.gaussians, result.scene, list(result.scene.test_indices), truth,
            background=options.background,
        )  # fmt: skip
        median = found["depth"]["median"]
        rings = [ring["abs_rel_median"] for ring in median["rings"]]
        scores = {s["distance"]: s["fscore"] for s in found.get("mesh", {}).get("fscores", [])}
        rows.append(
            _row(
                what=f"{data.name}, {name}, {steps_here} steps", psnr=result.metrics["psnr"],
                expected=100 * found["depth"]["expected"]["abs_rel_median"],
                median=100 * median["abs_rel_median"], fscore=scores.get(0.02),
                cpu_seconds=taken,
                **{f"ring{k}": None if r is None else 100 * r for k, r in enumerate(rings)},
            )
        )  # fmt: skip
    return rows


def _row(**known: Any) -> dict[str, Any]:
    return {key: known.get(key) for _, key, _ in COLUMNS}
