"""gsplat's `info` of a batch of cameras: what its strategies of densification read."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import Any

import numpy as np
import torch

from gsut import CameraMotion, LinearGaussians, project
from gsut.torch.arguments import Cameras, Place
from gsut.torch.arrays import to_array, to_tensor
from gsut.torch.views import View

_LEAST_VARIANCE = 1e-6  # pixels squared, beside a covariance that is inverted
# What is computed when it is read: a training that reads none of it does not pay for it.
_PROJECTED = ("radii", "means2d", "depths")
# gsplat's lists of tiles, which are not here.
_TILES = ("tiles_per_gauss", "isect_ids", "flatten_ids", "isect_offsets")
_INDICES = ("batch_ids", "camera_ids", "gaussian_ids")


def project_view(view: View, place: Place, radius_clip: float = 0.0) -> dict[str, np.ndarray]:
    """Projects the Gaussians of one camera.

    Args:
        view, place: the camera.
        radius_clip: a Gaussian whose radii do not exceed it, in pixels, counts as unseen.

    Returns:
        radii (N, 2) int32, means2d (N, 2), depths (N,): all 0 where unseen; covariances (N, 2, 2);
        small (N,), whether only `radius_clip` hides it.
    """
    names = ("means", "quats", "scales", "opacities")
    arrays = (to_array(t, name) for t, name in zip(place.scene, names, strict=True))
    gaussians = LinearGaussians(*arrays)
    motion = view.make_motion(place.pose, place.pose_end)
    found = project(gaussians, view.make_camera(place.lens), motion, dtype=str(gaussians.dtype))
    middle = motion.at(0.5) if isinstance(motion, CameraMotion) else motion
    depths = gaussians.means @ middle[2, :3] + middle[2, 3]
    reach = np.ceil(np.nan_to_num(found.extents))
    with np.errstate(invalid="ignore"):  # NaN, where there is no pixel, is not inside
        size = (view.width, view.height)
        inside = (found.centers + reach > 0) & (found.centers - reach < size)
        inside &= found.extents > 0
    seen = inside.all(axis=1) & (depths >= view.rule.near_z) & (depths <= view.rule.far_z)
    small = (reach <= radius_clip).all(axis=1) & (reach > 0).all(axis=1)
    seen &= ~small
    if view.rule.order != "z":
        depths = found.depths
    return {
        "radii": np.where(seen[:, None], reach, 0).astype(np.int32),
        "means2d": np.where(seen[:, None], found.centers, 0).astype(gaussians.dtype),
        "depths": np.where(seen, depths, 0).astype(gaussians.dtype),
        "covariances": found.covariances,
        "small": small,
    }


def invert_covariances(
    covariances: np.ndarray, radii: np.ndarray, eps2d: float
) -> dict[str, np.ndarray]:
    """Inverts covariances (N, 2, 2) after `eps2d` is added along both axes.

    Returns:
        conics (N, 3) xx, xy, yy of the inverse, and compensations (N,), the root of the ratio of
        determinants before and after; 0 where `radii` are.
    """
    xx, xy, yy = (covariances[:, i, j].astype(np.float64) for i, j in ((0, 0), (0, 1), (1, 1)))
    added = max(eps2d, _LEAST_VARIANCE)
    determinant = (xx + added) * (yy + added) - xy * xy
    seen = np.asarray((radii > 0).all(axis=1))
    inverse = np.where(seen, 1.0 / determinant, 0.0)
    conics = np.stack([(yy + added) * inverse, -xy * inverse, (xx + added) * inverse], 1)
    ratios = np.sqrt(np.maximum((xx * yy - xy * xy) * inverse, 0.0))
    dtype = covariances.dtype
    return {
        "conics": np.where(seen[:, None], conics, 0.0).astype(dtype),
        "compensations": np.where(seen, ratios, 0.0).astype(dtype),
    }


class BatchInfo(MutableMapping[str, Any]):
    """The projections of a batch of cameras under gsplat's names, made when they are first read.

    Args:
        cameras: whose scenes are kept as they are, whatever an optimizer does to them.
        packed: a row for each pair of a camera and a Gaussian that it sees; made at once.
        api: version of gsplat whose shapes are wanted.
        radius_clip, eps2d: as of `rasterization`.
        values: entries that are known.
    """

    def __init__(
        self, cameras: Cameras, packed: bool, api: str, radius_clip: float, eps2d: float,
        values: dict[str, Any],
    ) -> None:  # fmt: skip
        self._cameras, self._packed, self._api = cameras.freeze(), packed, api
        self._radius_clip, self._eps2d = radius_clip, eps2d
        lead, opacities = cameras.lead, cameras.scene[3]
        self._lead, self._num = lead, opacities.shape[-1]
        self._values: dict[str, Any] = dict.fromkeys(
            (*_PROJECTED, "conics", "opacities", *_INDICES)
        )
        self._values.update(n_cameras=lead[-1], n_batches=int(np.prod(lead[:-1], dtype=int)))
        self._values.update(values)
        self._projections: list[dict[str, np.ndarray]] = []
        self._is_read = False
        dtype = np.float64 if opacities.dtype == torch.float64 else np.float32
        self._centers = np.zeros((*lead, self._num, 2), dtype)
        if packed:
            self._project()
        else:
            self._values["means2d"] = to_tensor(self._centers)
        self._values["means2d"].requires_grad_(cameras.scene[0].requires_grad)

    def __getitem__(self, name: str) -> Any:
        if name in _TILES and name not in self._values:
            raise KeyError(
                f"{name}: gsut's renderer orders the Gaussians of each tile itself and keeps no "
                "such list; radii, means2d and depths say which tiles a Gaussian meets"
            )
        if name in _PROJECTED or name in ("conics", "opacities"):
            self._project()
            self._is_read |= name == "means2d"
        if name == "conics" and self._values[name] is None:
            self._values[name] = self._invert_covariances()
        return self._values[name]

    def __setitem__(self, name: str, value: Any) -> None:
        self._values[name] = value

    def __delitem__(self, name: str) -> None:
        del self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def is_read(self) -> bool:
        """Returns whether somebody has `means2d`, whose gradient is then computed."""
        return self._is_read

    def get_means2d(self, index: tuple[int, ...]) -> torch.Tensor:
        """Returns (N, 2) of one camera, a part of `means2d`, so that gradients arrive there."""
        means2d = self._values["means2d"]
        if not self._packed:
            return means2d[index]
        rows = to_tensor(self._rows[int(np.ravel_multi_index(index, self._lead))])
        zeros = torch.zeros(self._num, 2, dtype=means2d.dtype)
        return zeros.index_add(0, self._values["gaussian_ids"][rows], means2d[rows])

    def list_small(self) -> dict[tuple[int, ...], np.ndarray]:
        """Lists which Gaussians (N,) `radius_clip` hides from each camera."""
        self._project()
        hidden = (projection["small"] for projection in self._projections)
        return dict(zip(np.ndindex(*self._lead), hidden, strict=True))

    def _invert_covariances(self) -> torch.Tensor:
        """Returns the conics, arranged as the other values are."""
        found = [
            invert_covariances(p["covariances"], p["radii"], self._eps2d)["conics"]
            for p in self._projections
        ]
        if self._packed:
            found = [conics[(p["radii"] > 0).all(axis=1)] for conics, p in
                     zip(found, self._projections, strict=True)]  # fmt: skip
            return to_tensor(np.concatenate(found))
        return to_tensor(np.stack(found).reshape(*self._lead, self._num, 3))

    def _project(self) -> None:
        if self._projections:
            return
        for place in self._cameras:
            arrays = project_view(self._cameras.view, place, self._radius_clip)
            self._projections.append(arrays)
        arrays = {name: np.stack([p[name] for p in self._projections]) for name in _PROJECTED}
        cameras, gaussians = np.nonzero((arrays["radii"] > 0).all(axis=2))
        if self._api == "1.4":
            arrays["radii"] = arrays["radii"].max(axis=2)
        values = self._cameras.scene[3][..., None, :].expand(*self._lead, self._num)
        if not self._packed:
            self._centers[...] = arrays.pop("means2d").reshape(self._centers.shape)
            arrays = {name: a.reshape(*self._lead, *a.shape[1:]) for name, a in arrays.items()}
        else:
            per_camera = self._lead[-1]
            arrays = {name: array[cameras, gaussians] for name, array in arrays.items()}
            ids = (cameras // per_camera, cameras % per_camera, gaussians)
            for name, array in zip(_INDICES, ids, strict=True):
                self._values[name] = to_tensor(array.astype(np.int64))
            rows = to_tensor(cameras.astype(np.int64))
            values = values.reshape(-1, self._num)[rows, self._values["gaussian_ids"]]
            self._rows = [np.flatnonzero(cameras == k) for k in range(len(self._projections))]
        self._values.update({name: to_tensor(array) for name, array in arrays.items()})
        self._values["opacities"] = values
