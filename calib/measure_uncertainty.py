"""Does the truth lie within two standard deviations in 95 % of solves? Many synthetic solves.

    PYTHONPATH=python:. python calib/measure_uncertainty.py [SOLVES]

Known fisheye and radial lenses, random boards, Gaussian noise on every corner. Counts how often
each parameter, and the projection of directions far away, lies within 2 sigma of the truth.
"""

from __future__ import annotations

import sys

import numpy as np

import gsut
from calib.board import Board
from calib.lens import PIXEL_SHIFT, rays
from calib.solution import LENSES
from calib.solve_opencv import solve_camera
from calib.synthetic import photographs, random_poses
from calib.uncertainty import parameter_covariance, projection_sigma

NOISE_PX = 0.2
_LENSES = {
    "fisheye": [200.0, 201.0, 322.0, 238.0, 0.02, -0.01, 0.004, -0.001],
    "opencv4": [420.0, 421.0, 322.0, 238.0, -0.2, 0.05, 0.001, -0.0005],
}
_WIDEST = {"fisheye": 65.0, "opencv4": 28.0}  # degrees of the boards' centres
_BOARDS = 20


def coverage(lens: str, solves: int, seed: int = 1) -> tuple[np.ndarray, float, float]:
    """Solves many times.

    Args:
        lens: "fisheye" or "opencv4". solves: how many. seed: of the noise.

    Returns:
        Part of solves in which each parameter (K,) lies within 2 sigma of the truth; the same for
        the pixels of distant directions (in their worst direction's deviation, radial distance
        below 2 sigma in each axis); mean of noise found over noise put in.
    """
    generator = np.random.default_rng(seed)
    board = Board(8, 6, 0.03)
    truth = np.array(_LENSES[lens])
    camera = gsut.Camera(LENSES[lens][0], truth, 640, 480)
    within, projected, ratio = [], [], []
    for _ in range(solves):
        poses = random_poses(camera, board, _BOARDS, _WIDEST[lens], generator)
        solved = solve_camera(photographs(camera, board, poses, NOISE_PX, generator), board, lens)
        sigma, cov, layout, noise = parameter_covariance(solved, board)
        found = solved.params.copy()
        found[2:4] += PIXEL_SHIFT
        within.append(np.abs(found - truth) <= 2 * sigma)
        ratio.append(noise / NOISE_PX)
        projected.append(_projected_within(camera, solved, poses, cov, layout.boards))
    return np.mean(within, axis=0), float(np.mean(projected)), float(np.mean(ratio))


def _projected_within(camera, solved, poses, cov, boards) -> np.ndarray:
    """Whether true directions, fixed to the boards, are projected within 2 sigma of the truth."""
    from calib.rigid import rodrigues_vector, rotation_matrix

    x, y = np.meshgrid(np.linspace(200, 440, 4), np.linspace(140, 340, 3))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2)
    true_rays = rays_of(camera, pixels)
    turns = [
        rodrigues_vector(rotation_matrix(found[:3]) @ rotation_matrix(true[:3]).T)
        for found, true in zip(solved.camera_from_board, poses, strict=True)
    ]
    turned = true_rays @ rotation_matrix(np.mean(turns, axis=0)).T
    params = solved.params.copy()
    params[2:4] += PIXEL_SHIFT
    again, _ = gsut.Camera(camera.model, params, camera.width, camera.height).project(turned)
    sigma = projection_sigma(solved, rays(solved, pixels - PIXEL_SHIFT), cov, boards)
    return np.abs(again - pixels) <= 2 * sigma[:, None]


def rays_of(camera: gsut.Camera, pixels: np.ndarray) -> np.ndarray:
    """(N, 3) unit rays of pixels in gsut's convention."""
    found, valid = camera.unproject(pixels)
    assert valid.all()
    return found


def main() -> None:
    """Prints the coverage for each lens."""
    solves = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    for lens in _LENSES:
        parameters, projected, ratio = coverage(lens, solves)
        each = " ".join(f"{100 * part:.0f}" for part in parameters)
        print(
            f"{lens}: {solves} solves; parameters within 2 sigma: mean "
            f"{100 * parameters.mean():.1f} % ({each}); projections {100 * projected:.1f} %; "
            f"noise found / put in {ratio:.4f}"
        )


if __name__ == "__main__":
    main()
