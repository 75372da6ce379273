"""`gsut render`: images or a video of a trained scene, through any lens along any path."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError
from gsut.cli._flags import add_json, add_run, parsed_size, print_json

HELP = "images or a video through any lens along any path"
DESCRIPTION = "Renders a run's scene through any lens along a camera path."
_VIDEO_SUFFIX = ".mp4"


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file, or name (`gsut camera find`) [default: the dataset's first camera]",
    )
    parser.add_argument(
        "--size", metavar="WxH", help="size of the images in pixels; the lens is scaled to it"
    )
    parser.add_argument(
        "--low-pass",
        type=float,
        default=0.0,
        metavar="PIXELS",
        help="widen what is below a pixel of each image: standard deviation of a 3D filter; 0.3 "
        "against the aliasing of distant views and small images [default 0: none]",
    )
    parser.add_argument(
        "--path",
        default="orbit",
        metavar="{orbit,test,train,FILE}",
        help="orbit: once around the scene; train: smoothly through the training poses; test: "
        "exactly the held-out poses; FILE: JSON with camera_from_world (4x4 matrices, OpenCV axes) "
        "or a nerfstudio camera path or transforms.json [default orbit]",
    )
    parser.add_argument(
        "--frames",
        type=int,
        default=120,
        metavar="N",
        help="number of images of orbit and train [default 120]",
    )
    parser.add_argument(
        "--fps",
        type=float,
        default=30.0,
        metavar="X",
        help="images a second of a video [default 30]",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER|FILE.mp4",
        help="new folder of PNG images, or video [default: RUN/orbit and so on]",
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    import gsut
    from gsut.gaussians import pack_harmonics
    from gsut.render import to_uint8, write_png
    from gsut.run import Progress, RunFolder
    from gsut.training import read_trained

    if arguments.frames < 1 or not arguments.fps > 0:
        raise InputError("--frames must be >= 1 and --fps > 0")
    size = parsed_size(arguments.size) if arguments.size else None
    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = read_trained(run, arguments.data)
    if not arguments.low_pass:
        gaussians = pack_harmonics(gaussians)
    poses, names, cameras = _frames(arguments, scene)
    if size:
        resized = {id(camera): camera.resized(*size) for camera in cameras}
        cameras = [resized[id(camera)] for camera in cameras]
    label = arguments.path if arguments.path in ("orbit", "train", "test") else "path"
    out = Path(arguments.out) if arguments.out else run.path / label
    with Progress(sys.stderr.isatty()) as bars:

        def images() -> Iterator[np.ndarray]:
            for done, (pose, camera) in enumerate(zip(poses, cameras, strict=True), 1):
                drawn = _low_passed(gaussians, camera, pose, arguments.low_pass)
                result = gsut.render(drawn, camera, pose, background=options.background)
                yield to_uint8(result.image)
                bars.show("images", done, len(poses))

        if out.suffix.lower() == _VIDEO_SUFFIX:
            _write_video(out, images(), cameras, arguments.fps)
        else:
            new_folder(out)
            for name, image in zip(names, images(), strict=True):
                write_png(out / f"{name}.png", image)
    if arguments.json:
        print_json({"images": len(poses), "out": str(out)})
    else:
        print(f"{len(poses)} images: {out}")
    return 0


def new_folder(path: Path) -> Path:
    """Makes a folder, which may exist if it is empty."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"{path} is not empty; give another folder (nothing was overwritten)")
    except OSError as error:
        raise InputError(f"cannot make the folder {path}: {error.strerror or error}") from None
    return path


def _low_passed(
    gaussians: Any, camera: Any, place: np.ndarray | CameraMotion, pixels: float
) -> Any:
    from gsut.gaussians import filter_radii, low_pass
    from gsut.render import place_about

    if not pixels:
        return gaussians
    place = place_about(place, gaussians.origin)
    poses = [place.start, place.end] if isinstance(place, CameraMotion) else [place]
    radii = filter_radii(gaussians.means, [camera] * len(poses), np.stack(poses), pixels)
    return low_pass(gaussians, radii)


def _frames(
    arguments: argparse.Namespace, scene: Any
) -> tuple[list[np.ndarray | CameraMotion], list[str], list[Any]]:
    """Places, names and cameras of the images to render.

    A held-out view keeps its rolling shutter; along a path the camera stands still for each image.
    """
    from gsut.data import read_path
    from gsut.lens import load_lens
    from gsut.render import orbit_path, picture_stems, smooth_path

    lens = load_lens(arguments.camera) if arguments.camera else None
    if arguments.path == "test":
        views = [scene.views[index] for index in scene.test_indices]
        if not views:
            raise InputError(f"{scene.path} has no held-out views; choose another --path")
        cameras = [lens or scene.camera(index) for index in scene.test_indices]
        return [view.motion for view in views], picture_stems([v.name for v in views]), cameras
    keys = np.stack([scene.views[index].camera_from_world for index in scene.train_indices or [0]])
    if arguments.path == "orbit":
        poses = orbit_path(keys, arguments.frames)
    elif arguments.path == "train":
        poses = smooth_path(keys, arguments.frames)
    else:
        poses = read_path(arguments.path, scene.world_offset)
    camera = lens or scene.camera((scene.train_indices or [0])[0])
    return list(poses), [f"{number:05d}" for number in range(len(poses))], [camera] * len(poses)


def _write_video(
    path: Path, images: Iterator[np.ndarray], cameras: list[Any], frames_per_second: float
) -> None:
    from gsut.render import write_video

    if path.exists():
        raise InputError(f"{path} exists; give another name (nothing was overwritten)")
    if len({(camera.width, camera.height) for camera in cameras}) > 1:
        raise InputError("the images of a video must have one size; give --size")
    write_video(path, images, frames_per_second)
