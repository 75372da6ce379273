"""Coverage of the stated uncertainty: how often the truth lies within two standard deviations.

    .venv/bin/python -m tests.bench.measure_uncertainty [SOLVES] [SOLVER] [LENS]

Known lenses, random boards, Gaussian noise on every corner. The splined one has coarse knots near
the fisheye, and is solved with the same. Counts how often each parameter
(OpenCV's solves), and the projection of directions far away, lies within 2 sigma of the truth; for
mrcal's solves the sigma is mrcal's own.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass

import numpy as np

import gsut
from calib.boards.board import Board
from calib.camera.projection import PIXEL_SHIFT, to_gsut_camera, unproject_pixels
from calib.camera.rigid import matrix_from_rodrigues, rodrigues_from_matrix
from calib.camera.solution import LENSES, CameraSolution
from calib.report.lens_files import solution_from_fisheye
from calib.solve import mrcal_solver, opencv_solver
from calib.solve.mrcal_process import ask, require_mrcal
from calib.solve.splined_fit import fit_splined
from calib.trust.uncertainty import estimate_parameter_covariance, propagate_covariance
from tests.synthetic_boards import photographs, random_poses

NOISE_PX = 0.2
_BOARD = Board(8, 6, 0.03)
_BOARDS = 20
_WIDTH, _HEIGHT = 640, 480
# Pixels whose directions are followed: a grid over most of the image.
_COLUMNS, _ROWS = np.linspace(120, 520, 5), np.linspace(90, 390, 4)


@dataclass(frozen=True)
class Case:
    """A true lens.

    Args:
        params: fx fy cx cy and coefficients. widest_degrees: of the boards' centres.
    """

    params: tuple[float, ...]
    widest_degrees: float


CASES = {
    "fisheye": Case((200.0, 201.0, 322.0, 238.0, 0.02, -0.01, 0.004, -0.001), 65.0),
    "opencv4": Case((420.0, 421.0, 322.0, 238.0, -0.2, 0.05, 0.001, -0.0005), 28.0),
    # Near an equidistant lens up to 75 degrees, without a pole.
    "opencv8": Case(
        (260.0, 261.0, 322.0, 238.0, 0.5, 0.034, 0.001, -0.0005, 2e-4, 0.81, 0.12, 0.0024), 45.0
    ),
}
_SOLVERS = {"opencv": ("fisheye", "opencv4"), "mrcal": ("opencv4", "opencv8", "splined")}
_SURE_PX = 1.0  # standard deviation up to which a splined lens is to be used (trust.py)


def coverage(
    lens: str, solves: int, seed: int = 1, solver: str = "opencv"
) -> tuple[np.ndarray, float, float]:
    """Solves many times.

    Args:
        lens: a key of CASES. solves: how many. seed: of poses and noise. solver: "opencv" or
            "mrcal".

    Returns:
        Part of solves in which each parameter (K,) lies within 2 sigma of the truth (none for
        mrcal, which states none); the same for the coordinates of the pixels of distant
        directions, where the lens claims to be certain to _SURE_PX; mean of noise found over noise
        put in.
    """
    generator = np.random.default_rng(seed)
    case = CASES["fisheye" if lens == "splined" else lens]
    model, camera = _true_lens(lens, case)
    within, projected, ratio = [], [], []
    for _ in range(solves):
        poses = random_poses(camera, _BOARD, _BOARDS, case.widest_degrees, generator)
        seen = photographs(camera, _BOARD, poses, NOISE_PX, generator)
        if solver == "opencv":
            solved = opencv_solver.solve_camera(seen, _BOARD, lens)
            sigma, cov, layout, noise = estimate_parameter_covariance(solved, _BOARD)
            found = solved.params.copy()
            found[2:4] += PIXEL_SHIFT
            within.append(np.abs(found - case.params) <= 2 * sigma)
        else:
            solved = mrcal_solver.solve_camera(seen, _BOARD, lens, model=model)
            noise = _noise(solved)
        ratio.append(noise / NOISE_PX)
        pixels = np.stack(np.meshgrid(_COLUMNS, _ROWS), axis=-1).reshape(-1, 2)
        if solver == "opencv":
            spread = propagate_covariance(
                solved, unproject_pixels(solved, pixels - PIXEL_SHIFT), cov, layout.boards
            )
        else:
            spread = _mrcal_covariance(solved, pixels - PIXEL_SHIFT)
        deviation = np.sqrt(np.einsum("nii->ni", spread))
        error = _projected_again(camera, solved, poses, pixels) - pixels
        sure = np.all(deviation <= _SURE_PX, axis=1)
        projected.append((np.abs(error) <= 2 * deviation)[sure].ravel())
    parts = np.mean(within, axis=0) if within else np.empty(0)
    return parts, float(np.mean(np.concatenate(projected))), float(np.mean(ratio))


def _true_lens(lens: str, case: Case) -> tuple[str | None, gsut.Camera]:
    """mrcal's name of the lens where it has knots, and the lens."""
    if lens != "splined":
        return None, gsut.Camera(LENSES[lens][0], case.params, _WIDTH, _HEIGHT)
    fisheye = solution_from_fisheye(gsut.Camera("kannala_brandt", case.params, _WIDTH, _HEIGHT))
    model, params, _ = fit_splined(fisheye, np.pi, mrcal_solver.COARSE_KNOTS_DEGREES)
    splined = dataclasses.replace(fisheye, lens="splined", model=model, params=np.array(params))
    return model, to_gsut_camera(splined)


def _noise(solved: CameraSolution) -> float:
    """Of a corner's coordinate, from the residuals and the degrees of freedom."""
    good = 2 * int(np.sum(~solved.outliers))
    unknowns = len(solved.params) + 6 * len(solved.photographs) + 2  # 2: the board's warp
    return solved.rms_axis_px * float(np.sqrt(good / (good - unknowns)))


def _mrcal_covariance(solved: CameraSolution, pixels: np.ndarray) -> np.ndarray:
    question = {"do": "estimate_uncertainty", "model": solved.model_text, "pixels": pixels.tolist()}
    return np.array(ask({**question, "what": "covariance"})["sigma"])


def _projected_again(
    camera: gsut.Camera, solved: CameraSolution, poses: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Where the solved lens projects true directions of pixels, which stay fixed to the boards."""
    true_rays, valid = camera.unproject(pixels)
    assert valid.all()
    turns = [
        rodrigues_from_matrix(matrix_from_rodrigues(found[:3]) @ matrix_from_rodrigues(true[:3]).T)
        for found, true in zip(solved.camera_from_board, poses, strict=True)
    ]
    turned = true_rays @ matrix_from_rodrigues(np.mean(turns, axis=0)).T
    again, _ = to_gsut_camera(solved).project(turned)
    return again


def main() -> None:
    """Prints the coverage for each solver and lens."""
    solves = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for solver in sys.argv[2:3] or _SOLVERS:
        if solver == "mrcal":
            require_mrcal()
        for lens in sys.argv[3:4] or _SOLVERS[solver]:
            parameters, projected, ratio = coverage(lens, solves, solver=solver)
            text = ""
            if len(parameters):
                each = " ".join(f"{100 * part:.0f}" for part in parameters)
                text = f"parameters within 2 sigma: mean {100 * parameters.mean():.1f} % ({each}); "
            print(
                f"{lens} by {solver}: {solves} solves; {text}projections "
                f"{100 * projected:.1f} %; noise found / put in {ratio:.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
