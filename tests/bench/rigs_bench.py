"""`./run bench rigs`: two fisheyes on one body that read line by line, from poses to a scene."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.poses import invert_pose
from gsut.files import write_picture
from gsut.lens import save_camera
from gsut.sfm import compare_poses
from tests.bench.commands import run_gsut, train
from tests.bench.harness import Benchmark, Column, Option, Row, Settings
from tests.bench.walk_bench import FILMS, LENSES, resize_film
from tests.bench.walk_film import Film, trace_frames, write_film

_READOUT = 0.02  # seconds, of an action camera
# How the back lens reads its lines where the front one reads downwards: seconds, below 0 upwards.
_BACK = {"both down": _READOUT, "down and up": -_READOUT}
_GIVEN = ("rig and shutters", "rig, global shutters", "nothing: a film")


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists rigs with what is said of them."""
    for name in settings.rigs:
        for given in _GIVEN:
            yield {"rig": name, "given": given}


def measure(case: Row, settings: Settings) -> Row:
    """Films, runs `gsut poses` and `gsut train`, and compares with the truth."""
    film = dataclasses.replace(
        resize_film(FILMS["dual fisheye"](settings.seconds), settings), readout=_READOUT,
        back_readout=_BACK[case["rig"]],
    )  # fmt: skip
    folder = settings.folder / f"{case['rig']}, {case['given']}".replace(" ", "-")
    folder.mkdir(exist_ok=True)
    if case["given"] == _GIVEN[2]:
        write_film(film, folder / "film.mp4")
        words = [str(folder / "film.mp4"), "--frames", str(len(film.times))]
    else:
        write_rig(film, folder)
        words = [str(folder / "images"), "--rig", str(folder / "rig.json")]
        words += ["--shutter", "global"] if case["given"] == _GIVEN[1] else []
    try:
        took = run_gsut(["poses", *words], folder / "poses")
    except InputError:
        return {"verdict": "refused"}
    figures = json.loads((folder / "poses" / "poses.json").read_text())
    found = (figures.get("readout") or {}).get("seconds")
    metrics = train(folder / "poses", folder / "run", ["--preset", "fast"])
    errors = compare_with_film(film, folder / "poses")
    if case["given"] == _GIVEN[2]:
        errors["scale_percent"] = None  # a film has no unit
    return errors | {
        "registered": figures["registered"], "images": figures["images"],
        "readout_ms": None if found is None else 1000 * found,
        "cpu_seconds": took["cpu_seconds"], "train_cpu_seconds": metrics["cpu_seconds"],
        "psnr": metrics["psnr"], "verdict": metrics["verdict"]["level"],
    }  # fmt: skip


def write_rig(film: Film, folder: Path) -> None:
    """Writes the frames of each lens into a folder of its own, and rig.json with all that is known.

    Args:
        film: of two lenses.
        folder: an existing one.
    """
    cameras = {}
    for number, (lens, front_from_lens) in enumerate(film.lenses):
        name, readout = LENSES[number], film.readouts[number]
        (folder / "images" / name).mkdir(parents=True, exist_ok=True)
        save_camera(lens, folder / f"{name}.yaml")
        inside = lens.rays()[1].astype(np.uint8)
        write_picture(folder / "images" / name / "mask.png", 255 * inside)
        cameras[name] = {
            "file": f"{name}.yaml", "camera_from_reference": invert_pose(front_from_lens).tolist(),
            "shutter": "top_to_bottom" if readout > 0 else "bottom_to_top",
            "readout_seconds": abs(readout),
        }  # fmt: skip
    (folder / "rig.json").write_text(json.dumps({"cameras": cameras}), encoding="utf-8")
    width = film.camera.width
    for number, picture in enumerate(trace_frames(film)):
        for k in range(len(film.lenses)):
            part = picture[:, k * width : (k + 1) * width, ::-1]
            write_picture(folder / "images" / LENSES[k] / f"{number:03d}.png", part)


def compare_with_film(film: Film, data: Path) -> Row:
    """Compares the poses of a dataset with those of the film at the middle of each readout."""
    rows = json.loads((data / "poses.json").read_text())["views"]
    frames = json.loads((data / "transforms.json").read_text())["frames"]
    times = {"/".join(Path(f["file_path"]).parts[-2:]): f.get("timestamp") for f in frames}
    found, truth = [], []
    for row in rows:
        name = "/".join(Path(row["name"]).parts[-2:])
        if not row["registered"]:
            continue
        time = times[name]
        time = film.times[int(Path(name).stem)] if time is None else time
        front_from_lens = film.lenses[LENSES.index(Path(name).parent.name)][1]
        truth.append(invert_pose(film.path(np.array([time]))[0] @ front_from_lens))
        found.append(row["camera_from_world"])
    errors = compare_poses(np.array(found), np.array(truth))
    return {
        "centers_percent": errors.ate_percent,
        "rotation_degrees": float(np.median(errors.rotation_degrees)),
        "scale_percent": errors.scale_error_percent,
    }


BENCHMARK = Benchmark(
    help="rolling rigs of two fisheyes in the demo's hall: poses, readout and scene against truth",
    columns=(
        Column("rig"),
        Column("given"),
        Column("registered", form="d"),
        Column("images", form="d"),
        Column("centers_percent", "centres", "% of extent", ".3f"),
        Column("rotation_degrees", "rotation", "degrees", ".3f"),
        Column("scale_percent", "lengths", "%", "+.1f"),
        Column("readout_ms", "readout found", "of 20.0 ms", ".1f"),
        Column("cpu_seconds", "poses", "CPU-s", ".0f"),
        Column("psnr", "held-out PSNR", "dB", ".2f"),
        Column("train_cpu_seconds", "training", "CPU-s", ".0f"),
        Column("verdict", form="s"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("rigs", ("down and up",), ", ".join(_BACK)),
        Option("seconds", 3.0, "length of each film"),
        Option("frame_rate", 12.0, "frames per second"),
        Option("scale", 1.0, "size of the pictures"),
        Option("samples", 3, "rays per pixel, each at its moment of the exposure"),
    ),
)
