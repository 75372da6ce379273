"""`lab/run bench surfaces`: meshes of exact depths, stereo by ring, what `--surface` is worth."""

from __future__ import annotations

import dataclasses
import itertools
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut import _core
from gsut.data import Scene
from gsut.metrics import RING_EDGES_DEGREES
from gsut.render import compute_field_angles
from gsut.surface import MeshOptions, extract_mesh, judge_geometry, save_mesh
from gsut.surface.rays import cast_world_rays
from gsut.surface.worth import judge_depth
from lab.demo_tracer import make_demo_scene
from lab.demo_tracer.hall import make_hall
from lab.demo_tracer.hall_mesh import build_hall_mesh
from lab.demo_tracer.tracing import Tracer
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings
from tests.bench.walk_film import Film, plan_walk, trace_frames

_RADIUS = 1.0  # of the ball
_CENTER = np.array([0.03, 0.02, 0.01])  # of the ball: no corner of a voxel
_TWIST = np.array([0.06, -0.05, 0.04, 0.03, 0.05, -0.06])  # of a camera during its exposure
_FREE_WEIGHT = 0.1  # of space seen as empty, as in gsut mesh
_BALL_VOXEL = 0.06  # 33 voxels across the ball
_BALL_VIEWS = 24
_FRAME_RATE = 2.5  # frames a second that stereo compares
_AROUND = 0.4  # rounds about the hall's table in a film that stereo compares
_TRAIN_AROUND = 0.9  # in one that is trained on
_TRAIN_FRAMES = 34  # of it; every eighth is held out
_READOUT = 0.03  # seconds, of a rolling shutter
_MOST_GAUSSIANS = 50_000
_FISHEYE, _LARGER = "fisheye", "fisheye of 400 pixels"  # of the demo
_PLAIN = "plain"
_TRUTH = "truth.ply"
# Name -> --surface, primitive.
TRAININGS = {
    _PLAIN: (False, "gaussian"),
    "--surface": (True, "gaussian"),
    "--surface --primitive surfel": (True, "surfel"),
}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists balls and films by lens, fusions by number of voxels, and trainings."""
    for name in ("ball", *["stereo"] * bool(settings.frames)) if not settings.sets else ():
        for lens in list_lenses():
            yield {"what": f"{name}, {lens}", "_measure": name, "_lens": lens}
    for across in settings.across if not settings.sets else ():
        yield {"what": f"fusion, {across} voxels across", "_measure": "fusion", "_across": across}
    for data in (settings.sets or (HALL,)) if settings.steps else ():
        for lens in settings.lenses if data == HALL else ("",):
            names = list(TRAININGS)[: None if lens in ("", _FISHEYE) else 2]
            for name, seed in itertools.product(names, settings.seeds):
                yield {"what": name, "data": data, "lens": lens, "seed": str(seed),
                       "_measure": "training", "_seed": seed}  # fmt: skip


def measure(case: Row, settings: Settings) -> Row:
    """Measures a ball, a film, a fusion or a training."""
    if case["_measure"] == "ball":
        return _fuse_ball(*list_lenses()[case["_lens"]])
    if case["_measure"] == "stereo":
        return _compare_film(*list_lenses()[case["_lens"]], settings.frames)
    if case["_measure"] == "fusion":
        return _fuse_large_ball(case["_across"], settings.views, settings.size)
    return _train(case, settings)


def list_lenses() -> dict[str, tuple[Any, bool]]:
    """Name -> camera, and whether it moves during its exposure."""
    size = 220
    focal = size / np.radians(190.0)
    wide = gsut.Camera(
        "kannala_brandt", [focal, focal, size / 2, size / 2], size, size,
        valid_field_angle=np.radians(95.0),
    )  # fmt: skip
    splined = _resize_example("splined_stereographic", 200)
    return {
        "Kannala-Brandt of 190 degrees": (wide, False),
        "splined": (splined, False),
        "rolling shutter": (wide, True),
    }


def _resize_example(model: str, width: int) -> Any:
    _, params, full_width, full_height = _core.camera_examples(model)[0]
    return gsut.Camera(model, params, full_width, full_height).resize(
        width, max(1, round(full_height * width / full_width))
    )


def _look_at_ball(count: int, away: float) -> list[np.ndarray]:
    """Places cameras around the ball that look at it."""
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


def _trace_ball(camera: Any, motion: Any) -> np.ndarray:
    """Traces (H, W) exact distances; infinity: missed, NaN: no ray."""
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


def _fuse(camera: Any, motions: list[Any], voxel: float) -> Row:
    views = _core.DepthViews(list(_CENTER))
    for motion in motions:
        views.add(camera, motion, _trace_ball(camera, motion), None, None)
    processor = time.process_time()
    field = views.fuse(voxel, float("inf"), 4.0, _FREE_WEIGHT, 0)
    vertices, _ = field.mesh()
    off = np.abs(np.linalg.norm(vertices - _CENTER, axis=1) - _RADIUS) / voxel
    return {
        "voxels_off": float(off.max()),
        "blocks": len(field),
        "cpu_seconds": time.process_time() - processor,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _fuse_ball(camera: Any, moves: bool) -> Row:
    """Fuses a ball seen by cameras around it."""
    motions: list[Any] = _look_at_ball(_BALL_VIEWS, 1.6)
    if moves:
        how = gsut.Shutter("top_to_bottom")
        motions = [_core.CameraMotion(p, gsut.exp_pose(_TWIST) @ p, how) for p in motions]
    return _fuse(camera, motions, _BALL_VOXEL)


def _fuse_large_ball(across: int, views: int, size: int) -> Row:
    """Fuses a ball that fills the images of a 90-degree fisheye."""
    focal = size / np.radians(90.0)
    camera = gsut.Camera("kannala_brandt", [focal, focal, size / 2, size / 2], size, size)
    return _fuse(camera, _look_at_ball(views, 1.6), 2 * _RADIUS / across)


def _compare_film(camera: Any, moves: bool, frames: int) -> Row:
    """Films a walk through the hall and judges the depth that stereo finds, by ring."""
    film, scene = _film_hall(camera, moves, frames, around=_AROUND, test_every=0)
    began = time.process_time()
    maps = gsut.poses.find_depth_maps(scene)
    taken = time.process_time() - began
    tracer, depths, truths = Tracer(make_hall(film.seed), 1), [], []
    for view, found in enumerate(maps):
        starts, rays = cast_world_rays(found.camera, found.motion)
        inside = scene.mask(view)
        truth = np.full(inside.shape, np.nan)
        truth[inside] = tracer.trace_depths(starts[inside], rays[inside])
        depths.append(found.depth)
        truths.append(truth)
    angles = np.tile(np.degrees(compute_field_angles(camera)), (frames, 1))
    judged = judge_depth(np.concatenate(depths), np.concatenate(truths), angles)
    rings = {f"off_{ring['from_degrees']:.0f}": ring for ring in judged["rings"]}
    return {
        **{key: 100 * ring["abs_rel_median"] for key, ring in rings.items() if ring["pixels"]},
        **{key.replace("off", "known"): 100 * ring["coverage"] for key, ring in rings.items()
           if ring["coverage"] is not None},
        "cpu_seconds": taken,
    }  # fmt: skip


def _film_hall(
    camera: Any, moves: bool, frames: int, *, around: float, test_every: int
) -> tuple[Film, Scene]:
    """Films a walk through the hall; a rolling shutter if the camera moves."""
    film = Film(
        camera, plan_walk(frames / _FRAME_RATE, around=around), frames / _FRAME_RATE,
        _FRAME_RATE, readout=_READOUT if moves else 0.0, exposure=0.0,
    )  # fmt: skip
    poses = [
        np.linalg.inv(film.path(film.times + share * film.readout)) for share in (0.0, -0.5, 0.5)
    ]
    images = list(trace_frames(film))
    scene = gsut.scene_from_arrays(images, camera, poses[0], test_every=test_every)
    if not moves:
        return film, scene
    how = gsut.Shutter("top_to_bottom")
    return film, scene.replace(views=[
        dataclasses.replace(
            view, shutter=how, camera_from_world_start=start, camera_from_world_end=end
        ) for view, start, end in zip(scene.views, *poses[1:], strict=True)
    ])  # fmt: skip


def _load(data: str, lens: str, settings: Settings) -> tuple[Scene, Path | None]:
    """Loads a dataset, or the hall as a lens sees it, and the file of its true mesh."""
    if lens in list_lenses():
        film, scene = _film_hall(
            *list_lenses()[lens], _TRAIN_FRAMES, around=_TRAIN_AROUND, test_every=8
        )

        def write(folder: Path) -> None:
            folder.mkdir()
            save_mesh(folder / _TRUTH, build_hall_mesh(make_hall(film.seed)))

        return scene, settings.make(f"truth_{film.seed}", write) / _TRUTH
    path = settings.path(data)
    if lens == _LARGER:
        path = settings.make("hall_400", lambda to: make_demo_scene(to, size=400, progress=False))
    truth = path / _TRUTH
    return gsut.load_dataset(path), truth if truth.is_file() else None


def _train(case: Row, settings: Settings) -> Row:
    """Trains, and compares depths and meshes with the truth."""
    scene, truth = _load(case["data"], case["lens"], settings)
    surface, primitive = TRAININGS[case["what"]]
    options = gsut.TrainOptions(
        preset="fast", max_gaussians=_MOST_GAUSSIANS, steps=settings.steps, surface=surface,
        primitive=primitive, seed=case["_seed"],
    )  # fmt: skip
    began = time.process_time()
    result = gsut.train(scene, options, progress=False)
    taken = time.process_time() - began
    row: Row = {"psnr": result.metrics["psnr"], "cpu_seconds": taken}
    indices = list(result.scene.test_indices)
    for prefix, refine in (("", False), ("refined_", True)):
        began = time.process_time()
        mesh = extract_mesh(
            result.gaussians, result.scene, MeshOptions(refine=refine),
            background=options.background,
        )  # fmt: skip
        row[f"{prefix}mesh_seconds"] = time.process_time() - began
        found = judge_geometry(
            result.gaussians, result.scene, indices, truth, mesh=mesh,
            background=options.background,
        )  # fmt: skip
        row |= {kind: 100 * found["depth"][kind]["abs_rel_median"]
                for kind in ("expected", "median")}  # fmt: skip
        if "mesh" in found:
            row |= {f"{prefix}f{100 * score['distance']:.0f}": score["fscore"]
                    for score in found["mesh"]["fscores"]}  # fmt: skip
            row[f"{prefix}normals"] = found["mesh"]["normal_consistency"]
    return row


BENCHMARK = Benchmark(
    help="meshes of exact depths, fusion, stereo by ring, depths and meshes of trainings",
    columns=(
        Column("data"),
        Column("lens"),
        Column("what"),
        Column("seed"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("expected", "expected depth off", "%", ".2f"),
        Column("median", "median depth off", "%", ".2f"),
        *(
            Column(f"{prefix}{key}", name + after, unit, form)
            for prefix, after in (("", ""), ("refined_", ", refine"))
            for key, name, unit, form in (
                *((f"f{size}", f"F at {size} cm", "", ".3f") for size in (1, 2, 5)),
                ("normals", "normals agree", "", ".3f"),
                ("mesh_seconds", "mesh", "CPU-s", ".1f"),
            )
        ),
        *(
            Column(f"{key}_{low:.0f}", f"{name}, {low:.0f} to {high:.0f} degrees", "%", form)
            for key, name, form in (("off", "depth off", ".2f"), ("known", "known", ".0f"))
            for low, high in itertools.pairwise(RING_EDGES_DEGREES)
        ),
        Column("voxels_off", "farthest vertex", "voxels", ".3f"),
        Column("blocks", form=",d"),
        Column("cpu_seconds", "time", "CPU-s", ".1f"),
        Column("megabytes", "peak memory", "MB", ",.0f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("steps", 1000, "of each training; 0: none"),
        Option("seeds", (0, 1), "of trainings"),
        Option(
            "lenses",
            (_FISHEYE, _LARGER, "splined", "rolling shutter"),
            "through which trainings see the hall",
        ),
        Option("views", 60, "that are fused for speed"),
        Option("size", 480, "of their images, pixels"),
        Option("frames", 12, "of each film that stereo compares; 0: none"),
        Option("across", (250, 500, 1000), "voxels across the ball that is fused for speed"),
    ),
)
