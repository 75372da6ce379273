"""Answers questions about lenses with mrcal's Python module, under the system's Python.

    /usr/bin/python3 inside_mrcal.py QUESTION.json ANSWER.json

It imports mrcal and numpy 1 only: nothing of calib or gsut, whose numpy 2 mrcal cannot bear.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import mrcal
import numpy as np


def read_model(question: dict) -> mrcal.cameramodel:
    """Reads the .cameramodel whose text the question holds."""
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", suffix=".cameramodel") as file:
        file.write(question["model"])
        file.flush()
        return mrcal.cameramodel(file.name)


def format_model(model: mrcal.cameramodel) -> str:
    """Returns the text of a .cameramodel."""
    with tempfile.NamedTemporaryFile("r", encoding="utf-8", suffix=".cameramodel") as file:
        model.write(file.name)
        return Path(file.name).read_text(encoding="utf-8")


def describe_solve(question: dict) -> dict:
    """Describes every camera of the solve that mrcal-calibrate-cameras left in a model."""
    return describe_cameras(read_model(question).optimization_inputs())


def solve_again(question: dict) -> dict:
    """Repeats a solve from other lenses and poses, with all corners readmitted.

    mrcal-calibrate-cameras starts at random, and a rational lens has many minima: some runs end in
    a lens with a pole in the middle of the image, others of the same boards do not. mrcal 2.2 takes
    no start on its command line, hence this way.
    """
    inputs = read_model(question).optimization_inputs()
    inputs["intrinsics"] = np.array(question["params"])
    inputs["imagersizes"] = np.array(question["sizes"], np.int32)
    inputs["extrinsics_rt_fromref"] = np.array(question["poses"][1:]).reshape(-1, 6)
    seen = inputs["indices_frame_camintrinsics_camextrinsics"]
    for frame, path in zip(seen[:, 0], inputs["imagepaths"], strict=True):
        inputs["frames_rt_toref"][frame] = question["boards"][int(Path(path).stem.split("-")[1])]
    inputs["calobject_warp"] = np.array(question["warp"])
    if question["hold_lenses"]:
        inputs["do_optimize_intrinsics_core"] = inputs["do_optimize_intrinsics_distortions"] = False
        inputs["do_optimize_calobject_warp"] = False
    weights = inputs["observations_board"][..., 2]
    weights[weights < 0] *= -1  # mrcal marks outliers by a negative weight
    mrcal.optimize(**inputs)
    return describe_cameras(inputs)


def describe_cameras(inputs: dict) -> dict:
    """Lists each camera's lens, pose, boards, residuals and outliers out of mrcal's solve."""
    seen = inputs["indices_frame_camintrinsics_camextrinsics"]
    points = mrcal.hypothesis_board_corner_positions(**inputs)[0]  # in their cameras' frames
    warp = inputs.get("calobject_warp")
    cameras = []
    for index, params in enumerate(inputs["intrinsics"]):
        mine = np.flatnonzero(seen[:, 1] == index)
        observed = inputs["observations_board"][mine]
        pixels = mrcal.project(points[mine], inputs["lensmodel"], params)
        model = mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=index)
        cameras.append(
            {
                "text": format_model(model),
                "model": inputs["lensmodel"],
                "images": [Path(str(inputs["imagepaths"][i])).name for i in mine],
                "params": params.tolist(),
                "camera_from_reference": model.extrinsics_rt_fromref().tolist(),
                "reference_from_board": inputs["frames_rt_toref"][seen[mine, 0]].tolist(),
                "residuals": (pixels - observed[..., :2]).reshape(len(mine), -1, 2).tolist(),
                "outliers": (observed[..., 2] <= 0).reshape(len(mine), -1).tolist(),
                "warp": None if warp is None else warp.tolist(),
            }
        )
    return {"cameras": cameras}


def estimate_uncertainty(question: dict) -> dict:
    """Estimates the standard deviation in its worst direction, or "what", of distant points."""
    model = read_model(question)
    rays = mrcal.unproject(np.array(question["pixels"]), *model.intrinsics(), normalize=True)
    what = question.get("what", "worstdirection-stdev")
    sigma = mrcal.projection_uncertainty(rays, model=model, atinfinity=True, what=what)
    return {"sigma": sigma.tolist()}


def project(question: dict) -> dict:
    """Projects points (N, 3) in the camera's frame to pixels (N, 2)."""
    model = read_model(question)
    return {"pixels": mrcal.project(np.array(question["points"]), *model.intrinsics()).tolist()}


ANSWERS = (describe_solve, solve_again, estimate_uncertainty, project)


def main() -> None:
    """Reads the question's file and writes the answer's."""
    question = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    answer = next(answer for answer in ANSWERS if answer.__name__ == question["do"])
    Path(sys.argv[2]).write_text(json.dumps(answer(question)), encoding="utf-8")


if __name__ == "__main__":
    main()
