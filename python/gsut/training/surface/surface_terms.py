"""Adds the terms of `--surface`: flat Gaussians that agree with each other on one surface.

Without `--surface`, the term of known distances alone where depth files give them.

A second render, at half the size, has the Gaussians' shortest axes for its colours, so that the
kernels of any lens and shutter compute the terms forward and backward.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.gaussians import Gaussians
from gsut.training.surface.known_depth import KnownDepth, anneal

# Distance of the viewpoint of a parallel lens in world units: its rays then agree to rounding.
_FAR = 1e6


@dataclasses.dataclass(frozen=True)
class SurfaceWeights:
    """Weights of the terms and when they apply.

    Attributes:
        normal: of 1 - cosine between the Gaussians' normals and those of the depth.
        distortion: of the variance of the distances in a pixel, relative to the squared distance.
        flatten: of the mean shortest scale, over the scene's extent.
        known: of the relative error of known inverse distances, at the beginning.
        start: fraction of the steps at which the terms begin; they grow over the next tenth.
        size: of the second render, relative to the photographs.
        every: steps from one that adds the terms to the next, whose gradients count as often.
    """

    normal: float = 0.04
    distortion: float = 0.06
    flatten: float = 0.2
    known: float = 0.15
    start: float = 0.15
    size: float = 0.5
    every: int = 4


# Of depth files alone: the term then costs a twentieth of the training.
_DEPTHS_ALONE = SurfaceWeights(0.0, 0.0, 0.0, known=0.6, start=0.0, every=8)


class SurfaceTerms:
    """Computes the gradients of a view's surface terms; it has no state between steps.

    Args:
        weights: of the terms.
        scene: at full resolution.

    Attributes:
        last_terms: of the last view: normals, distortion, known distances.
    """

    def __init__(self, weights: SurfaceWeights, scene: Scene) -> None:
        self.weights, self.extent = weights, scene.extent
        self.known = KnownDepth(scene)
        self.renderer = _core.Renderer()
        self.last_terms = [0.0, 0.0, 0.0]
        self._cameras: dict[int, tuple[Any, Any]] = {}
        self._maps: dict[tuple[int, int], list[np.ndarray]] = {}

    @classmethod
    def choose(cls, scene: Scene, is_flat: bool) -> SurfaceTerms | None:
        """Returns the terms of `--surface`, or those of depth files alone; None without either."""
        terms = cls(SurfaceWeights() if is_flat else _DEPTHS_ALONE, scene)
        return terms if is_flat or terms.known.by_files else None

    def share(self, fraction: float) -> float:
        """Returns the share of the weights that applies at this fraction of the steps."""
        return min(max((fraction - self.weights.start) / 0.1, 0.0), 1.0)

    def is_due(self, step: int, fraction: float) -> bool:
        """Returns whether a step adds the terms."""
        return step % self.weights.every == 0 and self.share(fraction) > 0.0

    def compute_gradients(
        self, gaussians: Gaussians, scene: Scene, view: int, rule: Any, fraction: float
    ) -> Gaussians:
        """Returns the gradients of all terms to the drawn Gaussians, except to their harmonics.

        Args:
            gaussians: as they are drawn.
            scene: at the step's size, with the current poses.
            view: the step's.
            rule: of the blend.
            fraction: of the steps.
        """
        share, motion = self.weights.every * self.share(fraction), scene.views[view].motion
        small = self._shrink_camera(scene.camera(view))
        center = _find_center(small, motion)
        g, sh = gaussians, np.empty((len(gaussians), 1, 3), np.float32)
        normals = Gaussians(g.means, g.quats, g.log_scales, g.opacity_logits, sh, **g.rule)
        _core.facing_axes(gaussians, center, normals.sh)
        image, dimage, alpha, dalpha, depth, ddepth, distortion, ddistortion = self._get_buffers(
            small
        )
        job = _core.RenderJob(small, motion, rule=rule, background=(0.5, 0.5, 0.5), sh_degree=0)
        self.renderer.render(normals, job, image, alpha, depth, distortion)
        directions, origins = self.renderer.rays()
        maps = {
            "directions": directions, "origins": origins, "alpha": alpha, "depth": depth,
            "distortion": distortion, "normals": image, "known": self.known.map(scene, view, small),
        }  # fmt: skip
        w = self.weights
        known = share * w.known * anneal((fraction - w.start) / (1 - w.start))
        weights = (share * w.normal, share * w.distortion, known, self.extent)
        self.last_terms = _core.surface_loss(maps, weights, dalpha, ddepth, ddistortion, dimage)
        out = normals.make_zeros()
        touched = np.zeros(len(out), np.uint8)
        self.renderer.backward(
            dimage, out, touched, dalpha=dalpha, ddepth=ddepth, ddistortion=ddistortion,
            with_poses=False,
        )  # fmt: skip
        flatten = share * w.flatten / self.extent
        _core.facing_axes_backward(gaussians, center, out.sh, out, flatten)
        return out

    def _shrink_camera(self, camera: Any) -> Any:
        if id(camera) not in self._cameras:
            size = self.weights.size
            width, height = (max(1, round(size * n)) for n in (camera.width, camera.height))
            self._cameras[id(camera)] = camera, camera.resize(width, height)
        return self._cameras[id(camera)][1]

    def _get_buffers(self, camera: Any) -> list[np.ndarray]:
        shape = (camera.height, camera.width)
        if shape not in self._maps:
            shapes = [(*shape, 3)] * 2 + [shape] * 6
            self._maps[shape] = [np.zeros(each, np.float32) for each in shapes]
        return self._maps[shape]


def _find_center(camera: Any, motion: Any) -> list[float]:
    """Returns the point that the Gaussians are seen from."""
    pose = motion.at(0.5) if isinstance(motion, _core.CameraMotion) else np.asarray(motion)
    center = -pose[:3, :3].T @ pose[:3, 3]
    return list(center - _FAR * pose[2, :3] if camera.is_parallel else center)
