"""`gsut render`: images, a film, depths or points of a trained scene, by any lens and path."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import CameraMotion, InputError
from gsut.cli._flags import (
    add_json,
    add_moved_data,
    degrees,
    parse_image_size,
    print_result,
    whole,
)
from gsut.files import refuse_existing, whole_folder
from gsut.terminal import say

HELP = "images, depths or a film through any lens along any path"
DESCRIPTION = (
    "Renders a scene through any lens along a camera path: images or a film. Where images of a run "
    "are coarser than its photographs, Gaussians are widened to their pixels, against aliasing. "
    "Depths go to the folder depth/ beside the images, and transforms.json makes of all a dataset."
)
_PATHS = ("auto", "orbit", "train", "test")
_FRAMES = 120  # images along a path, unless given
_FILM_FRAMES = 300  # of a film, unless given: ten seconds
_MOST_FRAMES = 100_000  # an hour of film
_FPS = 30  # of a film
_FILM_SIZE = (1920, 1080)
_SIZES = {".gif": (640, 360)}
_WIDEST = 90.0  # degrees of a plain lens: beyond, what is at the edge is drawn out


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "folder", metavar="RUN|FILE", help="folder of the run, or a file of Gaussians"
    )
    add_moved_data(parser)
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file, or name (`gsut camera find`) [default: of images, the dataset's first "
        "camera; of a film, a plain lens that sees what that sees, up to 90 degrees]",
    )
    parser.add_argument(
        "--size",
        metavar="WxH",
        help="size of the images in pixels; the lens is scaled to it [default: the lens' own; of a "
        "film without --camera 1920x1080, of a GIF 640x360]",
    )
    parser.add_argument(
        "--fov",
        type=degrees,
        metavar="DEGREES",
        help="field of view across the image: the lens' focal lengths are scaled to it",
    )
    parser.add_argument(
        "--path",
        default="auto",
        metavar="{auto,orbit,test,train,FILE}",
        help="auto: a tour that stays where photographs were taken and looks where they looked; "
        "orbit: once around the scene; train: smoothly through the training poses; test: exactly "
        "the held-out poses; FILE: JSON with camera_from_world (4x4 matrices, OpenCV axes), as the "
        "viewer saves it, or a nerfstudio camera path or transforms.json [default auto]",
    )
    parser.add_argument(
        "--frames",
        type=whole,
        metavar="N",
        help="number of images of auto, orbit and train [default 120; of a film 300]; with FILE: "
        "smoothly through its poses [default these alone]",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="FOLDER|FILE.mp4",
        help="new folder of PNG images, or film: .mp4 (H.264), .webm (VP9) or .gif [default: "
        "RUN/auto and so on]",
    )
    _add_more_than_images(parser)
    add_json(parser)


def _add_more_than_images(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--depth",
        choices=("ray", "z"),
        help="also depths, where half of the light is gone: depth/NAME.npy (float32, the "
        "dataset's units, NaN: nothing) and depth/NAME.png (16 bits, 0: nothing); ray: along each "
        "pixel's ray; z: along the camera's axis, for lenses below 90 degrees from it",
    )
    parser.add_argument(
        "--lifted",
        metavar="FILE.npz",
        help="also what `gsut lift` put onto the Gaussians: lifted/NAME.npy, or of labels "
        "lifted/NAME.png (16 bits, 65535: none)",
    )
    parser.add_argument(
        "--cloud",
        metavar="FILE.ply",
        help="also the coloured points that the images see, in the dataset's coordinates",
    )
    parser.add_argument(
        "--confidence",
        action="store_true",
        help="also how sure each pixel is: confidence/NAME.npz (color_sigma, depth_sigma, "
        "seen_views; NaN and 0: never seen) and .png; the first time, the run is compared with its "
        "photographs, and RUN/confidence.npz keeps that",
    )


def run(arguments: argparse.Namespace) -> int:
    import gsut
    from gsut.cli._render_confidence import ConfidenceOutput
    from gsut.cli._render_depth import DepthOutput
    from gsut.cli._render_lifted import LiftedOutput
    from gsut.orientation import turn_picture
    from gsut.render import Light, is_film, to_uint8, write_png
    from gsut.run import Progress

    frames = _FRAMES if arguments.frames is None else arguments.frames
    if not 1 <= frames <= _MOST_FRAMES:
        raise InputError(f"--frames must be from 1 to {_MOST_FRAMES}, found {frames}")
    label = arguments.path if arguments.path in _PATHS else "path"
    out = Path(arguments.out or Path(arguments.folder) / label)
    film = is_film(out)
    depths = DepthOutput.from_flags(arguments, film)
    lifted = LiftedOutput.from_flags(arguments, film)
    stage = _stage(arguments)
    sure = ConfidenceOutput.from_flags(arguments, film)
    more: dict[str, Any] = {}
    if sure is not None:
        stage.gaussians, more = sure.gaussians, {"confidence": sure.confidence}
    outputs: list[Any] = [each for each in (depths, lifted, sure) if each is not None]
    if outputs:
        stage.gaussians = stage.gaussians.order_by_centers()  # no other order has them
    shots = _list_shots(arguments, stage, out if film else None)
    pixels = _make_pixel_filter(stage)
    if depths is not None:
        depths.check([shot.camera for shot in shots])
    pictures = contextlib.nullcontext() if film else whole_folder(out)
    with Progress() as bars, pictures as folder:

        def render_images() -> Iterator[np.ndarray]:
            for done, shot in enumerate(shots, 1):
                camera, place = shot.camera, shot.place
                drawn = stage.gaussians if pixels is None else pixels.widen(camera, place)
                result = gsut.render(drawn, camera, place, background=stage.background, **more)
                image = to_uint8(result.image)
                for output in outputs:
                    output.add(folder, shot, result, image)
                yield image
                bars.show("images", done, len(shots))

        if folder is None:
            upright = (
                turn_picture(image, shot.turns)
                for shot, image in zip(shots, render_images(), strict=True)
            )
            _write_video(out, upright, shots, _FPS)
        else:  # the pixels are the lens'
            for shot, image in zip(shots, render_images(), strict=True):
                write_png(folder / f"{shot.name}.png", image, shot.turns)
        figures: dict[str, Any] = {"images": len(shots), "out": str(out)}
        for output in outputs:
            figures |= output.finish()
    lines = [f"{len(shots)} images: {out}"]
    if stage.light is not None:
        lines.append(Light.SHOWN)
    if sure is not None:
        lines.append(figures["confidence"])
        lines.append(f"never seen: {100 * figures['never_seen']:.1f} % of the pixels")
    if arguments.cloud:
        lines.append(f"{figures['points']:,} points: {arguments.cloud}")
    return print_result(arguments, figures, lines)


def _stage(arguments: argparse.Namespace) -> Any:
    """Loads Gaussians, photographs and background of a run or of a file."""
    from gsut.run import RunFolder
    from gsut.view import open_stage

    place = Path(arguments.folder)
    if place.is_file():
        if arguments.out is None:
            raise InputError("a file has no folder for its images: say where to, with -o")
        stage = open_stage(place, arguments.data)
        if stage.kind == "data":
            raise InputError(f"{place} is of a dataset, which has no Gaussians; `gsut train` it")
        return stage
    if not place.exists():
        raise InputError(
            f"{place}: no such file or folder; give the folder of a run or a file of Gaussians"
        )
    return open_stage(RunFolder.open(place).path, arguments.data)


def _make_pixel_filter(stage: Any) -> Any:
    """Makes the filter for images coarser than a run's photographs; None without photographs."""
    from gsut.render import PixelFilter

    scene = stage.scene
    if scene is None or stage.kind != "run":
        return None
    return PixelFilter.from_scene(stage.gaussians, scene)


@dataclasses.dataclass(frozen=True)
class _Shot:
    """One image to render, and the quarter turns clockwise that show it upright."""

    name: str
    place: np.ndarray | CameraMotion
    camera: Any
    turns: int = 0


def _list_shots(arguments: argparse.Namespace, stage: Any, film: Path | None) -> list[_Shot]:
    """Lists the images to render.

    A held-out view keeps its rolling shutter; along a path the camera stands still for each image.
    """
    from gsut.orientation import turn_camera
    from gsut.render import name_pictures

    scene = stage.scene
    if arguments.path != "test":
        lens, turns = _choose_lens(arguments, stage, film), _count_turns(arguments, stage, film)
        poses = _list_poses(arguments, stage, film)
        if arguments.path in _PATHS:
            poses = turn_camera(poses, -turns)
        return [_Shot(f"{number:05d}", pose, lens, turns) for number, pose in enumerate(poses)]
    if scene is None or not scene.test_indices:
        raise InputError(f"{stage.name} has no held-out views; choose another --path")
    views = [scene.views[index] for index in scene.test_indices]
    own = [_reshape_lens(arguments, camera) for camera in scene.cameras]
    if arguments.camera:
        own = [_choose_lens(arguments, stage, film)] * len(own)
    names = name_pictures([view.name for view in views])
    return [
        _Shot(name, view.motion, own[view.camera_index], view.turns)
        for name, view in zip(names, views, strict=True)
    ]


def _count_turns(arguments: argparse.Namespace, stage: Any, film: Path | None) -> int:
    """Counts the quarter turns that show images along a path upright, as most of their lens."""
    from gsut.data.poses import read_path_turns
    from gsut.data.scene import count_lens_turns

    if arguments.path not in _PATHS:
        return read_path_turns(arguments.path)
    if arguments.camera or film is not None or stage.scene is None:
        return 0
    return count_lens_turns(stage.scene, 0)


def _list_poses(arguments: argparse.Namespace, stage: Any, film: Path | None) -> np.ndarray:
    from gsut.data.poses import read_path
    from gsut.data.scene import find_up, find_upright_poses
    from gsut.render import make_orbit_path, make_tour_path, smooth_path, turn_path

    scene, count = stage.scene, arguments.frames or (_FRAMES if film is None else _FILM_FRAMES)
    if arguments.path not in _PATHS:
        keys = read_path(arguments.path, None if scene is None else scene.world_offset)
        return keys if arguments.frames is None else smooth_path(keys, arguments.frames)
    if scene is None:  # from where the viewer looks first, once around
        place = stage.place()
        return turn_path(place["pose"], place["center"], place["up"], count)
    rows = scene.train_indices or range(len(scene))
    keys = find_upright_poses(scene, rows)
    if arguments.path == "train":
        return smooth_path(keys, count)
    make_path = make_tour_path if arguments.path == "auto" else make_orbit_path
    return make_path(keys, count, find_up(scene))


def _choose_lens(arguments: argparse.Namespace, stage: Any, film: Path | None) -> Any:
    """Chooses the lens of all images along a path."""
    from gsut.data.poses import read_path_lens
    from gsut.lens import Camera, load_lens, measure_field_of_view, with_field_of_view
    from gsut.lens.files import camera_from_values

    if arguments.camera:
        return _reshape_lens(arguments, load_lens(arguments.camera))
    if arguments.path not in _PATHS and (saved := read_path_lens(arguments.path)):
        return _reshape_lens(arguments, camera_from_values(saved, arguments.path))
    first = stage.cameras[0]
    if film is None:
        return _reshape_lens(arguments, first)
    width, height = _SIZES.get(film.suffix.lower(), _FILM_SIZE)
    if arguments.size:
        width, height = parse_image_size(arguments.size)
    plain = Camera("pinhole", [width, width, width / 2, height / 2], width, height)
    seen = measure_field_of_view(first) or _WIDEST
    return with_field_of_view(plain, arguments.fov or min(seen, _WIDEST))


def _reshape_lens(arguments: argparse.Namespace, lens: Any) -> Any:
    """Gives a lens the size and the field of view that the flags request."""
    from gsut.lens import with_field_of_view

    if arguments.size:
        width, height = parse_image_size(arguments.size)
        stretch = width / lens.width / (height / lens.height)
        if abs(stretch - 1) > 1 / min(width, height):
            say(
                f"note: {width} x {height} is of another shape than the lens' {lens.width} x "
                f"{lens.height}: pixels are drawn {1 / stretch:.3g} times as wide as high"
            )
        lens = lens.resize(width, height)
    return lens if arguments.fov is None else with_field_of_view(lens, arguments.fov)


def _write_video(
    path: Path, images: Iterator[np.ndarray], shots: list[_Shot], frames_per_second: float
) -> None:
    from gsut.render import write_video

    refuse_existing(path)
    sizes = {(shot.camera.width, shot.camera.height, shot.turns % 2) for shot in shots}
    if len(sizes) > 1:
        raise InputError("the images of a film must have one size; give --size or --camera")
    write_video(path, images, frames_per_second)
