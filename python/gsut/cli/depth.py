"""`gsut depth`: depth maps of photographs from their poses and lenses, without training."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gsut.cli._flags import add_force, add_json, add_quiet, check_first, print_result
from gsut.files import check_name, refuse_existing, whole_folder, write_npy, write_picture

if TYPE_CHECKING:
    from gsut.data import Frame, Scene
    from gsut.surface import DepthMap

HELP = "depth maps of photographs with poses, without training"
DESCRIPTION = (
    "Compares the photographs through their lenses and shutters and writes what each shows: "
    "DEPTH/depth/NAME.npy, distances along the rays in the dataset's unit, NaN where unknown; "
    "DEPTH/confidence/NAME.npy, from 0 to 1; DEPTH/normals/NAME.png, (n + 1) / 2 in the camera's "
    "axes; DEPTH/points.ply; and DEPTH/transforms.json, a dataset of the same photographs with "
    "these depths and points."
)

_POINTS = "points.ply"


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", metavar="DATA", help="the dataset")
    parser.add_argument("-o", "--out", metavar="DEPTH", required=True, help="new folder")
    add_force(parser)
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    import gsut
    from gsut.data import write_transforms
    from gsut.render import name_pictures
    from gsut.run import Progress
    from gsut.surface import points_from_depth, save_mesh
    from gsut.surface.stereo import find_depth_maps

    out = Path(arguments.out)
    check_name(out)
    if not out.is_dir() or any(out.iterdir()):
        refuse_existing(out, " with -o")
    scene = gsut.load_dataset(arguments.data, test_every=0)
    check_first(scene, arguments.force, arguments.quiet)
    with Progress(not arguments.quiet) as bars:
        maps = find_depth_maps(
            scene,
            on_view=lambda done, total: bars.show("sweeps", done, total),
        )
    with whole_folder(out) as folder:
        names = name_pictures([view.name for view in scene.views])
        frames = [
            _write_view(scene, view, found, folder, names[view]) for view, found in enumerate(maps)
        ]
        points = points_from_depth(maps)
        save_mesh(folder / _POINTS, points)
        test = [scene.views[view].name for view in scene.test_indices]
        write_transforms(folder / "transforms.json", frames, points_file=_POINTS, test=test or None)
    known = float(np.mean([np.isfinite(m.depth[scene.mask(i)]).mean() for i, m in enumerate(maps)]))
    figures = {"photographs": len(maps), "known": known, "points": len(points.vertices), "out": out}
    line = f"depths of {known:.0%} of the pixels of {len(maps)} photographs, "
    return print_result(arguments, figures, [line + f"{len(points.vertices):,} points: {out}"])


def _write_view(scene: Scene, view: int, found: DepthMap, folder: Path, name: str) -> Frame:
    """Writes depth, confidence and normals of a view by this name; returns its frame."""
    from gsut._core import CameraMotion
    from gsut.data import Frame
    from gsut.data.poses import invert_pose

    of = scene.views[view]
    files = {what: folder / what / f"{name}.npy" for what in ("depth", "confidence")}
    for file, values in zip(files.values(), (found.depth, found.weight), strict=True):
        file.parent.mkdir(exist_ok=True)
        write_npy(file, np.asarray(values))
    normals = folder / "normals" / f"{name}.png"
    normals.parent.mkdir(exist_ok=True)
    write_picture(normals, _encode_normals(np.asarray(found.normals)))
    ends: dict[str, Any] = {}
    if isinstance(of.motion, CameraMotion):
        ends = {
            "world_from_camera_start": invert_pose(of.motion.at(0.0)),
            "world_from_camera_end": invert_pose(of.motion.at(1.0)),
            "shutter": of.shutter,
        }
    return Frame(
        of.name, of.image_path, scene.file_cameras[of.camera_index],
        invert_pose(of.camera_from_world), mask_path=of.mask_path, depth_path=files["depth"],
        **ends,
    )  # fmt: skip


def _encode_normals(normals: np.ndarray) -> np.ndarray:
    """Returns normals as a picture (H, W, 3) uint8, blue first: (n + 1) / 2 of 255."""
    return np.rint((normals[..., ::-1] + 1) * (255 / 2)).astype(np.uint8)
