"""What each command of the command line does, step by step (see cli.py for the arguments)."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import shlex
import sys
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut._core import InputError
from gsut.data import read_path
from gsut.evaluate import evaluate as evaluate_scene
from gsut.evaluate import ring_text
from gsut.gaussians import lighter
from gsut.render import orbit_path, picture_stems, smooth_path, to_uint8, write_png, write_video
from gsut.run import METRICS, OPTIONS, REPORT, RunFolder, TrainOptions, given_options
from gsut.training import read_trained

_VIDEO_SUFFIX = ".mp4"


def train(arguments: argparse.Namespace) -> int:
    """`gsut train DATA -o RUN`."""
    run = RunFolder(arguments.out)
    given = given_options(TrainOptions, arguments)
    if arguments.resume and (run.path / OPTIONS).is_file():
        options = dataclasses.replace(run.read_options(), **given)
    else:
        options = TrainOptions(**given)
        if not arguments.resume:
            run.refuse_run()  # before the data is read: that may take a while
    metrics = _train(arguments.data, run, options, arguments.resume, arguments.quiet)
    if arguments.json:
        print(json.dumps(metrics, indent=2))
    elif not arguments.quiet:
        _print_figures(metrics)
        print(f"report: {run.path / REPORT}")
    return 0


def evaluate(arguments: argparse.Namespace) -> int:
    """`gsut eval RUN`."""
    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = read_trained(run, arguments.data)
    indices = {
        "test": scene.test_indices,
        "train": scene.train_indices,
        "all": list(range(len(scene.views))),
    }[arguments.split]
    if not indices:
        raise InputError(
            f"{scene.path} has no {arguments.split} views with these options; try --split all"
        )
    out = _new_folder(Path(arguments.out)) if arguments.out else None
    with _bar(len(indices), "view") as advance:
        figures = evaluate_scene(
            gaussians,
            scene,
            indices,
            background=options.background,
            render_folder=out,
            on_view=lambda done, total: advance(),
        )
    figures["num_gaussians"] = len(gaussians)
    if options.refine_poses:
        print("gsut: note: poses as the run refined them, held-out views aligned", file=sys.stderr)
    if out is not None:
        RunFolder(out).write_json(METRICS, figures)
    if arguments.json:
        print(json.dumps(figures, indent=2))
    else:
        for row in figures["views"]:
            print(f"{row['psnr']:7.2f} dB  SSIM {row['ssim']:.4f}  {row['name']}")
        _print_figures(figures)
    return 0


def render(arguments: argparse.Namespace) -> int:
    """`gsut render RUN`."""
    if arguments.frames < 1 or not arguments.fps > 0:
        raise InputError("--frames must be >= 1 and --fps > 0")
    size = _parsed_size(arguments.size) if arguments.size else None
    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = read_trained(run, arguments.data)
    if not arguments.low_pass:
        gaussians = lighter(gaussians)
    poses, names, cameras = _frames(arguments, scene)
    if size:
        resized = {id(camera): camera.resized(*size) for camera in cameras}
        cameras = [resized[id(camera)] for camera in cameras]
    label = arguments.path if arguments.path in ("orbit", "train", "test") else "path"
    out = Path(arguments.out) if arguments.out else run.path / label
    with _bar(len(poses), "image") as advance:

        def images() -> Iterator[np.ndarray]:
            for pose, camera in zip(poses, cameras, strict=True):
                drawn = _low_passed(gaussians, camera, pose, arguments.low_pass)
                result = gsut.render(drawn, camera, pose, background=options.background)
                yield to_uint8(result.image)
                advance()

        if out.suffix.lower() == _VIDEO_SUFFIX:
            _write_video(out, images(), cameras, arguments.fps)
        else:
            _new_folder(out)
            for name, image in zip(names, images(), strict=True):
                write_png(out / f"{name}.png", image)
    print(f"{len(poses)} images: {out}")
    return 0


def _low_passed(
    gaussians: gsut.Gaussians,
    camera: gsut.Camera,
    place: np.ndarray | gsut.CameraMotion,
    pixels: float,
) -> gsut.Gaussians:
    if not pixels:
        return gaussians
    poses = [place.start, place.end] if isinstance(place, gsut.CameraMotion) else [place]
    radii = gsut.filter_radii(gaussians.means, [camera] * len(poses), np.stack(poses), pixels)
    return gsut.low_pass(gaussians, radii)


def demo(arguments: argparse.Namespace) -> int:
    """`gsut demo`."""
    from gsut.demo import make_demo_scene

    options = TrainOptions(preset="fast", steps=arguments.steps)
    folder = Path(arguments.out)
    if arguments.rig:
        data = _demo_rig_poses(folder)
    else:
        data = folder / "fisheye_hall"
        if not data.is_dir():
            print(f"making a fisheye scene in {data}", file=sys.stderr)
            make_demo_scene(data)
    run, resume = _demo_run(folder, options, "rig_run" if arguments.rig else "run")
    metrics = _train(str(data), run, options, resume, quiet=False)
    _print_figures(metrics)
    report = run.path / REPORT
    print(f"report: {report}")
    if not arguments.no_open and _has_display():
        webbrowser.open(report.resolve().as_uri())
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """`gsut doctor DATA`; the exit status is 2 where training cannot start."""
    from gsut.data import diagnose, findings_text

    findings = diagnose(arguments.data)
    print(findings_text(findings))
    return 2 if any(finding.severity == "error" for finding in findings) else 0


def _train(
    data: str, run: RunFolder, options: TrainOptions, resume: bool, quiet: bool
) -> dict[str, Any]:
    """Loads, trains, and returns the content of metrics.json."""
    scene = gsut.load_dataset(data, test_every=options.test_every, test_names=options.test_names)
    if not quiet:
        for note in scene.notes:
            print(f"gsut: note: {note}", file=sys.stderr)
    try:
        gsut.train(scene, options, out=run.path, resume=resume, progress=not quiet)
    except KeyboardInterrupt:
        again = shlex.join(["gsut", "train", data, "-o", str(run.path), "--resume"])
        raise KeyboardInterrupt(
            f"stopped; this goes on from the last checkpoint: {again}"
        ) from None
    return run.read_json(METRICS)


def _frames(
    arguments: argparse.Namespace, scene: Any
) -> tuple[list[np.ndarray | gsut.CameraMotion], list[str], list[Any]]:
    """Places, names and cameras of the images to render.

    A held-out view keeps its rolling shutter; along a path the camera stands still for each image.
    """
    lens = gsut.load_camera(arguments.camera) if arguments.camera else None
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
    if path.exists():
        raise InputError(f"{path} exists; give another name (nothing was overwritten)")
    if len({(camera.width, camera.height) for camera in cameras}) > 1:
        raise InputError("the images of a video must have one size; give --size")
    write_video(path, images, frames_per_second)


def _new_folder(path: Path) -> Path:
    """Makes a folder, which may exist if it is empty."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"{path} is not empty; give another folder (nothing was overwritten)")
    except OSError as error:
        raise InputError(f"cannot make the folder {path}: {error.strerror or error}") from None
    return path


def _demo_rig_poses(folder: Path) -> Path:
    """Makes the demo's rig, finds its poses and tells their errors; returns the new dataset."""
    from gsut.bench.poses_bench import errors_against
    from gsut.cli.poses_command import estimate_with_bars
    from gsut.demo import make_demo_rig
    from gsut.sfm import is_finished

    truth, found = folder / "rig_hall", folder / "rig_poses"
    if not truth.is_dir():
        print(f"making a scene of two fisheyes on one body in {truth}", file=sys.stderr)
        make_demo_rig(truth)
    if not is_finished(found):
        estimate_with_bars(truth / "images", found, rig=truth / "rig.json")
    errors = errors_against(truth, found)
    print(
        f"poses of {errors.images} images against the truth: lengths off by "
        f"{errors.scale_error_percent:+.2f} %, centres by {errors.metric_ate:.4f} m of "
        f"{errors.extent:.1f} m (rms), turns by {np.median(errors.rotation_degrees):.3f} degrees "
        f"(median); report: {found / REPORT}"
    )
    return found


def _demo_run(folder: Path, options: TrainOptions, name: str = "run") -> tuple[RunFolder, bool]:
    """The first of NAME, NAME-2, NAME-3 ... that is free, or unfinished with the same options."""
    number = 1
    while True:
        run = RunFolder(folder / (name if number == 1 else f"{name}-{number}"))
        if not run.holds_run():
            return run, False
        unfinished = not (run.path / REPORT).is_file() and (run.path / OPTIONS).is_file()
        if unfinished and run.read_options() == options.resolved():
            return run, True
        number += 1


def _parsed_size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise InputError(f"--size must be like 1280x720, found {text!r}")
    return int(width), int(height)


def _print_figures(figures: dict[str, Any]) -> None:
    """The headline figures and the rings, for people."""
    if figures.get("psnr") is None:
        print("no held-out view, hence no PSNR")
    else:
        print(
            f"PSNR {figures['psnr']:.2f} dB (worst {figures['psnr_min']:.2f} dB, "
            f"{figures['worst_view']}; colour-corrected {figures['psnr_color_corrected']:.2f} dB), "
            f"SSIM {figures['ssim']:.4f}"
        )
        rings = [
            f"{ring_text(ring)} {ring['psnr']:.2f}"
            for ring in figures["rings"]
            if ring["psnr"] is not None
        ]
        print(f"PSNR by field angle: {', '.join(rings)} dB")
    text = f"{figures['num_gaussians']:,} Gaussians"
    if figures.get("train_seconds") is not None:
        text += f", {figures['steps']} steps in {figures['train_seconds']:.1f} s"
    if figures.get("render_ms") is not None:
        text += f", {figures['render_ms']:.1f} ms a view"
    print(text)


@contextlib.contextmanager
def _bar(total: int, unit: str):
    """A progress bar on standard error; gives the function that advances it by one."""
    from tqdm import tqdm

    with tqdm(total=total, unit=unit, disable=not sys.stderr.isatty(), dynamic_ncols=True) as bar:
        yield lambda: bar.update(1)


def _has_display() -> bool:
    """Whether a browser could be seen."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
