"""`lab/run bench primitives`: each primitive at equal bytes, and at equal processor seconds."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

import gsut
from gsut.lens import measure_pixel_angle
from gsut.lifting.back_projection import resize_mask
from gsut.surface import Mesh, MeshOptions, fuse_depth, render_depth_maps
from gsut.surface.mesh_files import load_mesh
from gsut.surface.rays import cast_world_rays
from gsut.surface.worth import build_tree, judge_mesh
from tests.bench.harness import HALL, Benchmark, Column, Option, Row, Settings

# Numbers of one beside its harmonics: centre 3, rotation 4, scales 3, opacity 1.
_GAUSSIAN = 11
# What others have in place of them.
_NUMBERS = {"atom": 5, "surfel": 10}
_BYTES = 4  # a number
_MESH = "mesh"  # in place of a primitive: the surface of Gaussians
_OF_VERTEX, _OF_FACE = 15, 12  # bytes: three floats and a colour, three indices
_F_AT = 0.02  # the distance of the F-score, in the units of the truth
_DRAWS = 3  # of each test view; the least time counts

# CPU-s of the Gaussians, by the case without primitive: what "seconds" is equal to.
_seconds: dict[tuple[str, str], float] = {}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists the primitives of each dataset; Gaussians come first, whose cost the others get."""
    for data in settings.sets or (HALL,):
        for primitive in dict.fromkeys(("gaussian", *settings.primitives)):
            alone = primitive in ("gaussian", _MESH)
            for equal in ("bytes",) if alone else ("bytes", "seconds"):
                yield {"data": data, "primitive": primitive, "equal": equal}


def measure(case: Row, settings: Settings) -> Row:
    """Trains at as many bytes as the Gaussians; for "seconds" with steps by what that took."""
    scene = gsut.load_dataset(settings.path(case["data"]))
    if case["primitive"] == _MESH:
        return _measure_mesh(case, settings, scene)
    harmonics = 3 * (settings.sh_degree + 1) ** 2
    numbers = _NUMBERS.get(case["primitive"], _GAUSSIAN) + harmonics
    count = settings.max_gaussians * (_GAUSSIAN + harmonics) // numbers
    steps, key = settings.steps, (case["data"], case["primitive"])
    if case["equal"] == "seconds":
        steps = round(steps * _seconds[case["data"], "gaussian"] / _seconds[key])
    options = gsut.TrainOptions(
        steps=steps, max_gaussians=count, primitive=case["primitive"],
        sh_degree=settings.sh_degree, scale=1.0 if case["data"] == HALL else settings.scale,
    )  # fmt: skip
    began = time.process_time()
    result = gsut.train(scene, options, progress=False)
    seconds = time.process_time() - began
    if case["equal"] == "bytes":
        _seconds[key] = seconds
    return {
        "gaussians": len(result.gaussians), "steps": steps, "cpu_seconds": seconds,
        "bytes": _BYTES * numbers * len(result.gaussians) / 1e6,
        "psnr": result.metrics["psnr"], "ssim": result.metrics["ssim"],
        **_draw_views(result.gaussians, scene, options.scale),
    }  # fmt: skip


def _measure_mesh(case: Row, settings: Settings, scene: gsut.Scene) -> Row:
    """Measures the surface of Gaussians, closed, in the colours of the photographs."""
    scale = 1.0 if case["data"] == HALL else settings.scale
    began = time.process_time()
    options = gsut.TrainOptions(
        steps=settings.steps, max_gaussians=settings.max_gaussians, surface=True, scale=scale,
        sh_degree=settings.sh_degree,
    )  # fmt: skip
    trained = gsut.train(scene, options, progress=False).gaussians
    camera = scene.camera(0)
    how = MeshOptions(
        max_side=round(scale * max(camera.width, camera.height)),
        photographs=True,
        support=1,
        holes=settings.holes,
    )
    maps = render_depth_maps(trained, scene, how)
    widths = [
        np.median(m.depth[np.isfinite(m.depth)]) * measure_pixel_angle(m.camera) for m in maps
    ]
    mesh = fuse_depth(maps, dataclasses.replace(how, voxel=settings.voxel * np.median(widths)))
    return {
        "gaussians": len(mesh), "steps": settings.steps, "cpu_seconds": time.process_time() - began,
        "bytes": (_OF_VERTEX * len(mesh.vertices) + _OF_FACE * len(mesh)) / 1e6,
        **_judge_opaque(mesh, scene, scale, settings.path(case["data"])),
    }  # fmt: skip


def _judge_opaque(mesh: Mesh, scene: gsut.Scene, scale: float, data: Path) -> Row:
    """Judges a mesh by PSNR with the nearest hit a pixel and by the true surface."""
    truth, row = data / "truth.ply", Row()
    if truth.is_file():
        row["fscore"] = judge_mesh(mesh, load_mesh(truth), scene, at=(_F_AT,))["fscores"][0][
            "fscore"
        ]
    tree, found = build_tree(mesh), []
    for index in scene.test_indices:
        camera, view = scene.camera(index), scene.views[index]
        size = round(scale * camera.height), round(scale * camera.width)
        camera = camera.resize(*size[::-1])
        origins, rays = (
            np.ascontiguousarray(a.reshape(-1, 3)) for a in cast_world_rays(camera, view.motion)
        )
        faces = tree.cast(origins, rays)[1]
        # Rays that meet nothing stay black; the last face stands in for theirs.
        shown = np.where(faces[:, None] >= 0, _draw_faces(mesh, faces, origins, rays), 0.0)
        photograph = cv2.resize(scene.image(index), size[::-1], interpolation=cv2.INTER_AREA) / 255
        mask = resize_mask(scene.mask(index), *size)
        found.append(gsut.psnr(np.clip(shown, 0, 1).reshape(*size, 3), photograph, mask))
    return {**row, "opaque": float(np.mean(found))}


def _draw_faces(mesh: Mesh, faces: np.ndarray, origins: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Draws the colours (N, 3) of the faces (N,) that rays meet."""
    corners = mesh.vertices[mesh.faces[faces]] - origins[:, None]
    turned = np.cross(corners[:, (1, 2, 0)], corners[:, (2, 0, 1)])
    weights = np.einsum("ni,nki->nk", rays, turned)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("nk,nkc->nc", weights, np.asarray(mesh.colors)[mesh.faces[faces]])


def _draw_views(gaussians: gsut.Gaussians, scene: gsut.Scene, scale: float) -> Row:
    """Measures processor milliseconds and blended pairs a pixel, means over the test views."""
    times, pairs = [], []
    for index in scene.test_indices:
        camera, pose = scene.camera(index), scene.views[index].motion
        size = round(scale * camera.width), round(scale * camera.height)
        camera = camera.resize(*size)
        found = []
        for _ in range(_DRAWS):
            began = time.process_time()
            drawn = gsut.render(gaussians, camera, pose)
            found.append(1e3 * (time.process_time() - began))
        times.append(min(found))
        pairs.append(drawn.get_statistics()["num_pairs"] / (camera.width * camera.height))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.ply"
        gsut.save_gaussians(path, gaussians)
        same = gsut.load_gaussians(path).primitive == gaussians.primitive
    if not same:
        return {"wrong": "the file forgets the primitive"}
    return {"ms": float(np.mean(times)), "pairs": float(np.mean(pairs))}


BENCHMARK = Benchmark(
    help="each primitive at the bytes, and at the processor seconds, of Gaussians",
    columns=(
        Column("data"),
        Column("primitive"),
        Column("equal"),
        Column("gaussians", "number, faces of the mesh", "", "d"),
        Column("steps", "steps", "", "d"),
        Column("bytes", "size", "MB", ".2f"),
        Column("cpu_seconds", "training", "CPU-s", ".1f"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("ssim", "SSIM", "", ".4f"),
        Column("ms", "a view", "CPU-ms", ".1f"),
        Column("pairs", "tile pairs a pixel", "", ".3f"),
        Column("opaque", "as an opaque mesh", "dB", ".2f"),
        Column("fscore", "F of it at 2 cm", "", ".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option(
            "primitives",
            ("surfel", "atom", "triangle", _MESH),
            "beside Gaussians; mesh: their surface",
        ),
        Option("steps", 500, "of each training at equal bytes"),
        Option("max_gaussians", 20_000, "Gaussians"),
        Option("voxel", 2.0, "of the mesh, widths of a pixel at the median depth"),
        Option("holes", 1000, "edges of the longest hole of it that is closed"),
        Option("sh_degree", 1, "of each training"),
        Option("scale", 0.25, "of the images of datasets"),
    ),
)
