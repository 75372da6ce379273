"""gsplat's `info` of a batch of cameras: what its strategies of densification read."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from gsut import CameraMotion, LinearGaussians, project
from gsut.torch.arrays import to_array, to_tensor
from gsut.torch.views import View

_LEAST_VARIANCE = 1e-6  # pixels squared, beside a covariance that is inverted


def project_view(
    view: View, scene: list[torch.Tensor], pose: torch.Tensor, pose_end: torch.Tensor | None,
    lens: torch.Tensor,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Projects the Gaussians of one camera: radii, means2d, depths and conics."""
    names = ("means", "quats", "scales", "opacities")
    arrays = (to_array(t, name) for t, name in zip(scene, names, strict=True))
    gaussians = LinearGaussians(*arrays)
    motion = view.make_motion(pose, pose_end)
    found = project(gaussians, view.make_camera(lens), motion, dtype=str(gaussians.dtype))
    middle = motion.at(0.5) if isinstance(motion, CameraMotion) else motion
    depths = gaussians.means @ middle[2, :3] + middle[2, 3]
    reach = np.ceil(np.nan_to_num(found.extents))
    with np.errstate(invalid="ignore"):  # NaN, where there is no pixel, is not inside
        size = (view.width, view.height)
        inside = (found.centers + reach > 0) & (found.centers - reach < size)
        inside &= found.extents > 0
    seen = inside.all(axis=1) & (depths >= view.rule.near_z) & (depths <= view.rule.far_z)
    covariances = np.nan_to_num(found.covariances.astype(np.float64))
    inverse = np.linalg.inv(covariances + _LEAST_VARIANCE * np.eye(2))
    conics = np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], 1)
    dtype = gaussians.dtype
    return {
        "radii": np.where(seen[:, None], reach, 0).astype(np.int32),
        "means2d": np.where(seen[:, None], found.centers, 0).astype(dtype),
        "depths": np.where(seen, depths, 0).astype(dtype),
        "conics": np.where(seen[:, None], conics, 0).astype(dtype),
    }


class BatchInfo:
    """The projections of a batch of cameras, as `info` has them.

    Args:
        projections: of `project_view`, one a camera, batches of scenes outermost.
        lead: (..., C), how the cameras are arranged.
        opacities: [..., N].
        packed: a row for each pair of a camera and a Gaussian that it sees.
        api: version of gsplat whose shapes are wanted.
        with_gradient: whether `means2d` gets one.
    """

    def __init__(
        self, projections: list[dict[str, np.ndarray]], lead: tuple[int, ...],
        opacities: torch.Tensor, packed: bool, api: str, with_gradient: bool,
    ) -> None:  # fmt: skip
        arrays = {name: np.stack([p[name] for p in projections]) for name in projections[0]}
        self._num = arrays["radii"].shape[1]
        cameras, gaussians = np.nonzero((arrays["radii"] > 0).all(axis=2))
        self._rows = [np.flatnonzero(cameras == k) for k in range(len(projections))]
        self._ids = to_tensor(gaussians.astype(np.int64))
        if api == "1.4":
            arrays["radii"] = arrays["radii"].max(axis=2)
        per_camera = lead[-1]
        values = opacities[..., None, :].detach().expand(*lead, self._num)
        if packed:
            arrays = {name: array[cameras, gaussians] for name, array in arrays.items()}
            values = values.reshape(len(projections), self._num)
            values = values[to_tensor(cameras.astype(np.int64)), self._ids]
        else:
            arrays = {name: a.reshape(*lead, *a.shape[1:]) for name, a in arrays.items()}
        self._packed, self._lead = packed, lead
        self.values: dict[str, Any] = {name: to_tensor(array) for name, array in arrays.items()}
        self.values["means2d"].requires_grad_(with_gradient)
        self.values.update(
            opacities=values,
            batch_ids=to_tensor((cameras // per_camera).astype(np.int64)) if packed else None,
            camera_ids=to_tensor((cameras % per_camera).astype(np.int64)) if packed else None,
            gaussian_ids=self._ids if packed else None,
            n_cameras=per_camera,
            n_batches=int(np.prod(lead[:-1], dtype=int)),
        )

    def get_means2d(self, number: int) -> torch.Tensor:
        """Returns (N, 2) of one camera, a part of `means2d`, so that gradients arrive there."""
        means2d = self.values["means2d"]
        if not self._packed:
            return means2d.reshape(-1, self._num, 2)[number]
        rows = to_tensor(self._rows[number])
        zeros = torch.zeros(self._num, 2, dtype=means2d.dtype)
        return zeros.index_add(0, self._ids[rows], means2d[rows])
