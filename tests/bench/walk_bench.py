"""`./run bench walk`: poses, lens and readout of films of known cameras, against truth."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gsut
from gsut._core import InputError
from gsut.capture.panorama import LENSES
from gsut.data.poses import invert_pose
from gsut.gaussians import find_rotation_vectors
from gsut.lens import Camera, find_lens
from gsut.sfm import compare_poses
from gsut.sfm.lens.candidates import make_lens
from tests.bench.commands import run_gsut
from tests.bench.harness import Benchmark, Column, Option, Row, Settings
from tests.bench.walk_film import Film, Path4, plan_walk, write_film

_WIDE = 480, 270  # size of a film that lies
_HALF_TURN = np.pi - 0.015  # of the second lens of a dual fisheye: not quite parallel


def _circle_lens(focal: float) -> Camera:
    """Makes a lens of 200 degrees whose circle fills most of its square."""
    params = [focal, focal, 192.7, 191.6, 0.02, -0.006, 0.0, 0.0]
    return Camera("kannala_brandt", params, 384, 384, valid_field_angle=np.radians(100))


# Of a phone's gyroscope: its samples a second, seconds that its clock is late, its turn against the
# picture, rad/s of bias and noise.
_HERTZ = 200.0
_LATE = 0.013
_ASKEW = np.array([0.02, -1.55, 0.03])
_BIAS = np.array([0.008, -0.005, 0.003])
_RATE_NOISE = 0.003


# Back to back 2.4 cm apart, as in 360-degree cameras.
_BACK_FROM_FRONT = np.eye(4)
_BACK_FROM_FRONT[:3, :3] = cv2.Rodrigues(np.array([0.01, _HALF_TURN, 0.008]))[0]
_BACK_FROM_FRONT[:3, 3] = [0.001, 0.0, 0.024]


def _film_by_database(name: str, path: Path4, seconds: float, **more: Any) -> Film:
    """Films through a lens of the database, read as fast and in the order that it states."""
    profile = find_lens(name)
    camera = profile.make_camera(*_WIDE)
    readout = (profile.readout_ms or 0.0) / 1000
    if more.get("sideways"):  # the sensor's top is at the right of the upright picture
        fx, fy, cx, cy, *rest = camera.params
        params = [fy, fx, camera.height - cy, cx, *rest]
        camera, readout = Camera(camera.model, params, *_WIDE[::-1]), -readout
    return Film(camera, path, seconds, readout=readout, **more)


# Each with another lens, motion, readout and hall, by the seconds that it lasts.
FILMS: dict[str, Callable[[float], Film]] = {
    "phone": lambda s: Film(
        make_lens(*_WIDE, 68, 1.0), plan_walk(s, seed=3), s, readout=0.022, seed=2
    ),
    "straight on": lambda s: Film(
        make_lens(*_WIDE, 84, 0.9),
        plan_walk(s, seed=6, forward=6.0 / s, looking=0.0, shake_degrees=0.3), s, seed=5,
    ),
    "wide and shaken": lambda s: Film(
        make_lens(*_WIDE, 122, 0.3), plan_walk(s, seed=5, shake_degrees=1.5), s,
        readout=0.012, seed=4,
    ),
    "pale walls": lambda s: Film(
        make_lens(*_WIDE, 75, 1.0), plan_walk(s, seed=11, around=0.25), s, seed=10, contrast=0.1
    ),
    "dual fisheye": lambda s: Film(
        _circle_lens(104.0), plan_walk(s, seed=9), s, readout=0.0, seed=8, back=_circle_lens(105.0),
        back_from_front=_BACK_FROM_FRONT,
    ),
    "action camera": lambda s: _film_by_database("GoPro HERO, Wide, NO-EIS", plan_walk(s), s),
    "read upwards": lambda s: _film_by_database(
        "Insta360 OneRS, 1inch, 60fps", plan_walk(s, seed=10), s, seed=9
    ),
    "phone upright": lambda s: _film_by_database(
        "Apple iPhone 14, 26mm, 30P", plan_walk(s, seed=4), s, seed=3, sideways=True
    ),
    "global shutter": lambda s: Film(
        make_lens(*_WIDE, 75, 1.0), plan_walk(s, seed=8), s, readout=0.0, seed=7
    ),
}  # fmt: skip


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists films."""
    for name in settings.films:
        if name not in FILMS:
            raise InputError(f"--films: no film {name!r}; there are {', '.join(FILMS)}")
        for gyroscope in settings.gyroscope:
            yield {"film": name, "gyroscope": gyroscope}


def measure(case: Row, settings: Settings) -> Row:
    """Films, runs `gsut poses` on the film and compares."""
    film = resize_film(FILMS[case["film"]](settings.seconds), settings)
    has_record = case["gyroscope"] == "yes"
    video = settings.folder / f"{case['film']}.mp4"
    if not video.is_file():
        write_film(film, video)
    if has_record:
        video = video.rename(video.with_stem(f"{case['film']} with gyroscope"))
        write_record(film, video.with_suffix(".gcsv"))
    out = video.with_suffix("")
    words = ["--frames", str(settings.frames)] if settings.frames else []
    took = run_gsut(["poses", str(video), *words], out)
    figures = json.loads((out / "poses.json").read_text())
    row = {
        "registered": figures["registered"],
        "images": figures["images"],
        "true_readout_ms": 1000 * film.readout,
        "cpu_seconds": took["cpu_seconds"],
        "cpu_per_image": took["cpu_seconds"] / figures["images"],
        "peak_mb": took["peak_mb"],
        "verdict": figures["verdict"]["level"],
    }
    found = (figures.get("readout") or {}).get("seconds")
    if found is not None:
        backwards = figures["shutter"] in ("bottom_to_top", "right_to_left")
        row["readout_ms"] = 1000 * (-found if backwards else found)
    return row | _compare(film, out)


def write_record(film: Film, target: Path) -> None:
    """Writes a film's turns as Gyroflow logs them, by a sensor as phones have it.

    It is late, mounted askew, and has noise and a bias.
    """
    rng = np.random.default_rng(film.seed)
    times = np.arange(0, film.seconds, 1 / _HERTZ)
    rotations = film.path(np.append(times, times[-1] + 1 / _HERTZ) - _LATE)[:, :3, :3]
    rates = find_rotation_vectors(rotations[1:].transpose(0, 2, 1) @ rotations[:-1]) * _HERTZ
    rates = -rates @ cv2.Rodrigues(_ASKEW)[0] + _BIAS
    rates += _RATE_NOISE * rng.standard_normal(rates.shape)
    rows = [",".join(f"{x:.6f}" for x in row) for row in np.column_stack([times, rates])]
    head = "GYROFLOW IMU LOG\nversion,1.3\norientation,XYZ\ntscale,1\ngscale,1\nt,gx,gy,gz\n"
    target.write_text(head + "\n".join(rows) + "\n")


def resize_film(film: Film, settings: Any) -> Film:
    """Changes the film's frame rate, size and number of samples to those of the settings."""
    camera = film.camera
    width, height = (2 * round(settings.scale * n / 2) for n in (camera.width, camera.height))
    return dataclasses.replace(
        film, frame_rate=settings.frame_rate, samples=settings.samples,
        camera=camera.resize(width, height),
        back=None if film.back is None else film.back.resize(width, height),
    )  # fmt: skip


def _compare(film: Film, data: Path) -> Row:
    """Compares poses and lenses with those of the film."""
    scene = gsut.load_dataset(data, test_every=0)
    frames = json.loads((data / "transforms.json").read_text())["frames"]
    times = {Path(row["file_path"]).name: row["timestamp"] for row in frames}
    truth = film.path(np.array([times[view.image_path.name] for view in scene.views]))
    lens_of = [int(view.image_path.parent.name == LENSES[1]) for view in scene.views]
    truth = truth @ np.array([film.lenses[number][1] for number in lens_of])
    found = np.array([view.camera_from_world for view in scene.views])
    errors = compare_poses(found, np.array([invert_pose(pose) for pose in truth]))
    pairs = []
    for number in set(lens_of):
        lens = scene.cameras[scene.views[lens_of.index(number)].camera_index]
        pairs.append((lens, _crop_lens(film.lenses[number][0], lens)))
    focal = [float(np.mean(lens.params[:2] / true.params[:2])) - 1 for lens, true in pairs]
    return {
        "centers_percent": errors.ate_percent,
        "rotation_degrees": float(np.median(errors.rotation_degrees)),
        "focal_percent": 100 * max(focal, key=abs),
        "lens_px": max(measure_lens_difference(lens, true) for lens, true in pairs),
    }


def _crop_lens(camera: Camera, like: Camera) -> Camera:
    """Crops a film's camera to the square about its middle that the circle was cut to."""
    if (camera.width, camera.height) == (like.width, like.height):
        return camera
    params = camera.params.copy()
    params[2] -= (camera.width - like.width) / 2
    params[3] -= (camera.height - like.height) / 2
    return Camera(camera.model, params, like.width, like.height)


def measure_lens_difference(lens: Camera, truth: Camera) -> float:
    """Returns the median distance in pixels of what both lenses see in one direction.

    The turn of one against the other that fits best is taken out: poses take it up.
    """
    x, y = np.meshgrid(np.linspace(0, truth.width, 25), np.linspace(0, truth.height, 25))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    ours, valid = lens.unproject(pixels)
    theirs, also = truth.unproject(pixels)
    good = valid & also
    left, _, right = np.linalg.svd(theirs[good].T @ ours[good])
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    there, _ = truth.project(ours[good] @ turn.T)
    return float(np.nanmedian(np.linalg.norm(there - pixels[good], axis=1)))


BENCHMARK = Benchmark(
    help="films of known cameras in the demo's hall: poses, lens and readout against the truth",
    columns=(
        Column("film"),
        Column("gyroscope"),
        Column("registered", form="d"),
        Column("images", form="d"),
        Column("centers_percent", "centres", "% of extent", ".3f"),
        Column("rotation_degrees", "rotation", "degrees", ".3f"),
        Column("focal_percent", "focal length", "%", "+.2f"),
        Column("lens_px", "lens off", "px", ".2f"),
        Column("readout_ms", "readout found", form=".1f"),
        Column("true_readout_ms", "true, ms", form=".1f"),
        Column("cpu_seconds", "poses", "CPU-s", ".0f"),
        Column("cpu_per_image", "an image", "CPU-s", ".2f"),
        Column("peak_mb", "memory", "MB", ".0f"),
        Column("verdict", form="s"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("films", tuple(FILMS)[:4], ", ".join(FILMS)),
        Option("gyroscope", ("no", "yes"), "whether the camera recorded its turns"),
        Option("seconds", 6.0, "length of each film"),
        Option("frame_rate", 24.0, "frames per second"),
        Option("scale", 0.834, "size of the film's pictures"),
        Option("samples", 2, "rays per pixel, each at its moment of the exposure"),
        Option("frames", 0, "to choose of each film; 0: as gsut does"),
    ),
)
