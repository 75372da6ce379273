"""Does --calibration-weights help? Trains with lenses of few boards, measures through the true one.

    .venv/bin/python -m tests.bench.measure_weights DATA WORK [OPTION...]

DATA: a transforms.json data set whose fisheye lens (OPENCV_FISHEYE) is the truth, and its images.
WORK: a folder for the runs. From OPTION on: options of `gsut train`, such as --steps 500.

For each calibration: boards in the middle of the image only, through the true lens, are solved as
`gsut calibrate` does. The scene is trained with that lens, over its whole field and cut at the
angle to which it is trusted, with and without weights; its held-out views are rendered through the
true lens. The solved lens' turn against the true one is put into the poses, as the estimation of
poses would.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gsut
from calib import solve_opencv
from calib.board import Board
from calib.errors import SolveError
from calib.halves import best_rotation
from calib.lens import PIXEL_SHIFT, gsut_camera
from calib.lens_files import write_lens
from calib.trust import Trust, field_angle, judge
from calib.uncertainty import spread_pixels, uncertainty_map
from tests.synthetic_boards import photographs, random_poses

_BOARD = Board(8, 6, 0.03)
_NOISE_PX = 0.3
_KEYS = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4")
_LIMIT = "max_theta_rad"
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Boards:
    """A poor calibration: how many boards, how far their centres are from the axis, the seed."""

    count: int
    widest_degrees: float
    seed: int


CALIBRATIONS = (Boards(5, 20.0, 1), Boards(5, 20.0, 2), Boards(6, 30.0, 3), Boards(8, 45.0, 4))


def poor_lens(true: gsut.Camera, boards: Boards, path: Path) -> tuple[gsut.Camera, Trust]:
    """Solves synthetic boards, writes the lens and its uncertainty; returns it uncut."""
    generator = np.random.default_rng(boards.seed)
    poses = random_poses(true, _BOARD, boards.count, boards.widest_degrees, generator)
    seen = photographs(true, _BOARD, poses, _NOISE_PX, generator)
    camera = solve_opencv.solve_camera(seen, _BOARD, "fisheye")
    trust = judge(camera, _BOARD, uncertainty_map(camera, _BOARD))
    if trust.refusal:
        raise SolveError(trust.refusal)
    write_lens(path, camera, trust, "synthetic boards")
    return gsut_camera(camera), trust


def turn_between(true: gsut.Camera, found: gsut.Camera, valid_angle: float) -> np.ndarray:
    """(3, 3) rotation that brings true rays of pixels to the found lens' inside its field."""
    pixels = spread_pixels(true.width, true.height).reshape(-1, 2) + PIXEL_SHIFT
    a, b = true.unproject(pixels)[0], found.unproject(pixels)[0]
    use = np.all(np.isfinite(a) & np.isfinite(b), axis=1)
    use[use] &= field_angle(b[use]) <= valid_angle
    return best_rotation(a[use], b[use])


def write_data(
    source: Path, out: Path, lens: gsut.Camera, turn: np.ndarray, limit: float | None
) -> Path:
    """The data set with another lens and poses turned with it; images stay where they are."""
    values = json.loads((source / "transforms.json").read_text())
    values.update(zip(_KEYS, map(float, lens.params), strict=True))
    if limit is not None:
        values[_LIMIT] = min(limit, values.get(_LIMIT, np.pi))
    place = {}
    back = np.eye(4)
    back[:3, :3] = turn.T
    for frame in values["frames"]:
        pose = np.array(frame["transform_matrix"]) @ _OPENGL_FROM_OPENCV @ back
        frame["transform_matrix"] = (pose @ _OPENGL_FROM_OPENCV).tolist()
        frame.pop("depth_file_path", None)
        for key in ("file_path", "mask_path"):
            if key in frame:
                place[frame[key]] = os.path.relpath(source / frame[key], out)
                frame[key] = place[frame[key]]
    for key in ("train_filenames", "test_filenames"):
        if key in values:
            values[key] = [place[name] for name in values[key]]
    if "ply_file_path" in values:
        values["ply_file_path"] = os.path.relpath(source / values["ply_file_path"], out)
    out.mkdir(parents=True, exist_ok=True)
    (out / "transforms.json").write_text(json.dumps(values))
    return out


def trained(data: Path, run: Path, truth: Path, words: list[str]) -> dict:
    """Trains and evaluates on the truth's views; what `gsut eval --json` prints."""
    gsut_command = [sys.executable, "-m", "gsut"]
    subprocess.run(
        [*gsut_command, "train", str(data), "-o", str(run), "--quiet", *words], check=True
    )
    done = subprocess.run(
        [*gsut_command, "eval", str(run), "--data", str(truth), "--json"],
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout)


def row(name: str, figures: dict) -> str:
    """One line of the table."""
    rings = [r["psnr"] for r in figures["rings"]]
    each = "".join("      -" if value is None else f"{value:7.2f}" for value in rings)
    return f"{name:34}{figures['psnr']:7.2f}  {each}"


def main() -> None:
    """Prints PSNR over held-out views and by ring of field angle, with and without weights."""
    if len(sys.argv) < 3:
        sys.exit("usage: measure_weights.py DATA WORK [options of gsut train]")
    source, work, words = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    true = gsut.load_camera(source / "transforms.json")
    if true.model != "kannala_brandt":
        sys.exit(f"{source}: the lens is {true.model}; give a data set with OPENCV_FISHEYE")
    work.mkdir(parents=True, exist_ok=True)
    print(f"{'':34}   PSNR   0-30  30-60  60-80   80- degrees")
    print(row("true lens", trained(source, work / "true", source, words)), flush=True)
    for boards in CALIBRATIONS:
        name = f"{boards.count} boards to {boards.widest_degrees:.0f} degrees"
        path = work / f"lens{boards.seed}.yaml"
        try:
            found, trust = poor_lens(true, boards, path)
        except SolveError as error:
            print(f"{name}: no lens: {error}", flush=True)
            continue
        turn = turn_between(true, found, trust.valid_angle)
        axis = np.radians(np.arange(10.0, 91.0, 20.0))
        points = np.stack([np.sin(axis), 0 * axis, np.cos(axis)], axis=1)
        error = np.linalg.norm(found.project(points @ turn.T)[0] - true.project(points)[0], axis=1)
        sigma = trust.sigma[trust.sigma.shape[0] // 2, trust.sigma.shape[1] // 2 :: 4]
        print(
            f"{name}, trusted to {np.degrees(trust.valid_angle):.0f}: error at 10, 30 .. 90 "
            f"degrees {np.round(error, 2)} px; sigma from centre to rim {np.round(sigma, 2)} px"
        )
        for limit in (None, trust.valid_angle):
            label = "whole field" if limit is None else "trusted field"
            data = write_data(source, work / f"data{boards.seed}-{label[0]}", found, turn, limit)
            for extra in ([], ["--calibration-weights", str(path)]):
                run = work / f"run{boards.seed}-{label[0]}{len(extra)}"
                figures = trained(data, run, source, [*words, *extra])
                print(row(f"  {label}{', weights' if extra else ''}", figures), flush=True)


if __name__ == "__main__":
    main()
