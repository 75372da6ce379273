"""Which parameters of a lens photographs of a scene can determine, without a board."""

from __future__ import annotations

import numpy as np

from gsut.lens.camera import Camera

_SAMPLES = 33  # pixels along each side of the image
_LEAST = 1e-9  # of a derivative's length: less is not its own, but that of others


def find_refinable_params(camera: Camera) -> np.ndarray:
    """Returns which parameters a bundle adjustment may refine; the others must be held.

    Held are those that move no pixel (the configuration of a spline, the polynomial of an f-theta
    lens that only inverts the other), those that the ones before them, or a rotation of all
    cameras, make up for (the skew beside it), and the control points of a spline, as features do
    not reach each of them.

    Args:
        camera: the lens, at the size of the images.

    Returns:
        (K,) bool.
    """
    free = np.zeros(len(camera.params), bool)
    if not len(free):
        return free
    size = camera.width, camera.height
    across, down = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES * side for side in size)
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays, valid = camera.unproject(pixels)
    names = camera.param_names.split()
    count = names.index("control_points") if "control_points" in names else len(free)
    by_point, by_params = camera.project_jacobian(rays[valid], range(count))
    by_rotation = by_point @ np.cross(np.eye(3), rays[valid][:, None, :]).transpose(0, 2, 1)
    basis = np.linalg.qr(by_rotation.reshape(-1, 3))[0]
    for k, column in enumerate(by_params.reshape(-1, count).T):
        own = column
        for _ in range(2):  # twice is enough (Kahan)
            own = own - basis @ (basis.T @ own)
        length = np.linalg.norm(own)
        free[k] = length > _LEAST * np.linalg.norm(column)
        if free[k]:
            basis = np.column_stack([basis, own / length])
    return free
