"""Answers questions about lenses with mrcal's Python module; run by /usr/bin/python3 only.

    /usr/bin/python3 inside_mrcal.py QUESTION.json ANSWER.json FOLDER_OF_GSUT

Imports mrcal, numpy 1 and those files of calib and gsut that need numpy alone; never the package
gsut itself or OpenCV.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import mrcal
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
# The name gsut without the package, which this Python cannot import: its single files can be.
sys.modules["gsut"] = ModuleType("gsut")
sys.modules["gsut"].__path__ = [sys.argv[3]]
from calib.bundle import Observation, State, minimise  # noqa: E402


def read_model(text: str) -> mrcal.cameramodel:
    """A .cameramodel from its text."""
    with tempfile.NamedTemporaryFile("w", encoding="utf-8", suffix=".cameramodel") as file:
        file.write(text)
        file.flush()
        return mrcal.cameramodel(file.name)


def model_text(model: mrcal.cameramodel) -> str:
    """The text of a .cameramodel."""
    with tempfile.NamedTemporaryFile("r", encoding="utf-8", suffix=".cameramodel") as file:
        model.write(file.name)
        return Path(file.name).read_text(encoding="utf-8")


def solved(question: dict) -> dict:
    """What mrcal-calibrate-cameras left in a model: lens, boards, residuals, outliers."""
    model = read_model(question["models"][0])
    inputs = model.optimization_inputs()
    lensmodel, params = model.intrinsics()
    observed = inputs["observations_board"]
    points = mrcal.hypothesis_board_corner_positions(model.icam_intrinsics(), **inputs)[0]
    pixels = mrcal.project(points, lensmodel, params)
    count = observed.shape[0]
    warp = inputs.get("calobject_warp")
    return {
        "model": lensmodel,
        "params": params.tolist(),
        "camera_from_board": inputs["frames_rt_toref"].tolist(),
        "residuals": (pixels - observed[..., :2]).reshape(count, -1, 2).tolist(),
        "outliers": (observed[..., 2] <= 0).reshape(count, -1).tolist(),
        "warp": None if warp is None else warp.tolist(),
    }


def solve_together(question: dict) -> dict:
    """A rig's solve again, from other lenses and poses, all corners given a new chance."""
    inputs = read_model(question["models"][0]).optimization_inputs()
    inputs["intrinsics"] = np.array(question["params"])
    inputs["imagersizes"] = np.array(question["sizes"], np.int32)
    inputs["extrinsics_rt_fromref"] = np.array(question["poses"][1:])
    seen = inputs["indices_frame_camintrinsics_camextrinsics"]
    names = [Path(str(path)).name for path in inputs["imagepaths"]]
    for frame, name in zip(seen[:, 0], names, strict=True):
        inputs["frames_rt_toref"][frame] = question["boards"][int(Path(name).stem.split("-")[1])]
    inputs["calobject_warp"] = np.array(question["warp"])
    if question["hold_lenses"]:
        inputs["do_optimize_intrinsics_core"] = inputs["do_optimize_intrinsics_distortions"] = False
        inputs["do_optimize_calobject_warp"] = False
    weights = inputs["observations_board"][..., 2]
    weights[weights < 0] *= -1
    mrcal.optimize(**inputs)
    points = mrcal.hypothesis_board_corner_positions(**inputs)[0]  # in their cameras' frames
    cameras = []
    for index in range(len(question["params"])):
        mine = seen[:, 1] == index
        observed = inputs["observations_board"][mine]
        pixels = mrcal.project(points[mine], inputs["lensmodel"], inputs["intrinsics"][index])
        model = mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=index)
        cameras.append(
            {
                "text": model_text(model),
                "images": [name for name, is_mine in zip(names, mine, strict=True) if is_mine],
                "params": inputs["intrinsics"][index].tolist(),
                "camera_from_reference": model.extrinsics_rt_fromref().tolist(),
                "reference_from_board": inputs["frames_rt_toref"][seen[mine, 0]].tolist(),
                "residuals": (pixels - observed[..., :2]).reshape(mine.sum(), -1, 2).tolist(),
                "outliers": (observed[..., 2] <= 0).reshape(mine.sum(), -1).tolist(),
                "warp": inputs["calobject_warp"].tolist(),
            }
        )
    return {"cameras": cameras}


def solve_again(question: dict) -> dict:
    """The same solve from another lens and other boards' poses, all corners given a new chance."""
    inputs = read_model(question["models"][0]).optimization_inputs()
    inputs["intrinsics"] = np.array([question["params"]])
    inputs["frames_rt_toref"] = np.array(question["boards"])
    inputs["calobject_warp"] = np.zeros(2)
    weights = inputs["observations_board"][..., 2]
    weights[weights < 0] *= -1
    mrcal.optimize(**inputs)
    model = mrcal.cameramodel(optimization_inputs=inputs, icam_intrinsics=0)
    return {"model": model_text(model)}


def uncertainty(question: dict) -> dict:
    """Of a distant point's projection: standard deviation in its worst direction, or "what"."""
    model = read_model(question["models"][0])
    rays = mrcal.unproject(np.array(question["pixels"]), *model.intrinsics(), normalize=True)
    what = question.get("what", "worstdirection-stdev")
    sigma = mrcal.projection_uncertainty(rays, model=model, atinfinity=True, what=what)
    return {"sigma": sigma.tolist()}


def project(question: dict) -> dict:
    """Pixels (N, 2) of points (N, 3) in the camera's frame."""
    model = read_model(question["models"][0])
    return {"pixels": mrcal.project(np.array(question["points"]), *model.intrinsics()).tolist()}


def fit_boards(question: dict) -> dict:
    """Poses of boards (and, for a rig, of its cameras) with the lenses held; and the residuals."""
    models = [read_model(text).intrinsics() for text in question["models"]]

    def projector(lensmodel: str):
        def project(params: np.ndarray, points: np.ndarray):
            return mrcal.project(points, lensmodel, params, get_gradients=True)

        return project

    observations = [
        Observation(o["camera"], o["board"], np.array(o["pixels"]), np.array(o["points"]))
        for o in question["observations"]
    ]
    state = State(
        [np.array(params) for _, params in models],
        np.array(question["cameras"]),
        np.array(question["boards"]),
    )
    lenses = [projector(lensmodel) for lensmodel, _ in models]
    state = minimise(state, observations, lenses, free_cameras=len(models) > 1)
    return {"cameras": state.cameras.tolist(), "boards": state.boards.tolist()}


ANSWERS = {
    "solved": solved,
    "solve_together": solve_together,
    "solve_again": solve_again,
    "uncertainty": uncertainty,
    "project": project,
    "fit_boards": fit_boards,
}


def main() -> None:
    """Reads the question's file, writes the answer's."""
    question = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    answer = ANSWERS[question["do"]](question)
    Path(sys.argv[2]).write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main()
