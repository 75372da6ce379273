"""How much each Gaussian counts, seen through the real lenses of a scene's views."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians
from gsut.render import DEFAULT_UNSCENTED

# First coefficient of the harmonics' basis: a colour is 0.5 + _SH0 x sh + ...
_SH0 = 0.28209479177387814
# LightGaussian: volumes count by (V / V of the 90th percentile) to this power, at most 1 before it.
_VOLUME_POWER = 0.1
_VOLUME_PERCENTILE = 90.0
# Random signs drawn for each view's Fisher matrices, each on three colour channels.
_FISHER_PROBES = 2
_PARAMETERS = 6  # position and scale
# Added to the diagonal of a Fisher matrix, of its trace: what few pixels saw has no full rank.
_FISHER_RIDGE = 1e-9


@dataclasses.dataclass(frozen=True)
class SeenView:
    """A view without its photograph: what scores and weights need.

    Attributes:
        camera: lens and image size.
        camera_from_world: (4, 4).
        mask: (H, W) bool, pixels that count.
    """

    camera: Any
    camera_from_world: np.ndarray
    mask: np.ndarray


def seen_views(scene: Any, indices: Sequence[int]) -> list[SeenView]:
    """The given views of a scene with their masks (dataset's mask and the lens' valid field)."""
    return [
        SeenView(scene.camera(i), scene.views[i].camera_from_world, scene.mask(i)) for i in indices
    ]


def blend_weights(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """Sum of each Gaussian's blend weights (alpha x transmittance) over all valid pixels.

    The image is linear in the colours, and the blend weight is the factor: so this is the gradient
    of the images' sum to the colours, exactly, by the backward pass that trains.

    Args:
        gaussians: N Gaussians.
        views: at least one.
        on_view: called after each.

    Returns:
        (N,) float64, in pixels; 0 for what no valid pixel sees.
    """
    grey = _grey(gaussians)
    sums = np.zeros(len(gaussians))
    passes = _Passes(grey)
    for view in _needed(views):
        dimage = np.zeros((*view.mask.shape, 3), np.float32)
        dimage[..., 0] = view.mask
        passes.render(view)
        sums += passes.backward(dimage).sh[:, 0, 0].astype(np.float64) / _SH0
        on_view()
    return np.maximum(sums, 0.0)


def lightgaussian_scores(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
) -> np.ndarray:
    """LightGaussian's global significance: blend weights times (V / V_90%)^0.1.

    The publication sums opacity x transmittance of the rays that hit; here each hit counts with its
    response too (alpha x transmittance), which is what the ray really sees.

    Args:
        gaussians: N Gaussians.
        views: at least one.
        on_view: called after each.

    Returns:
        (N,) float64 >= 0; the lowest are pruned.

    Source: Fan et al., "LightGaussian", NeurIPS 2024.
    """
    log_volume = gaussians.log_scales.astype(np.float64).sum(axis=1)
    if len(log_volume) == 0:
        return log_volume
    volume = np.exp(log_volume - log_volume.max())  # in units of the largest
    relative = np.minimum(volume / np.percentile(volume, _VOLUME_PERCENTILE), 1.0)
    return blend_weights(gaussians, views, on_view) * relative**_VOLUME_POWER


def pup_scores(
    gaussians: Gaussians,
    views: Sequence[SeenView],
    on_view: Callable[[], object] = lambda: None,
    *,
    seed: int = 0,
) -> np.ndarray:
    """PUP-3DGS' sensitivity: log det of each Gaussian's Fisher matrix over position and scale.

    The Fisher matrix is the sum over pixels and channels of J J^T, J the pixel's gradient to the
    six parameters. The backward pass gives sums of J only; with a random sign at each pixel and
    channel the square of such a sum has the Fisher matrix as its mean (Hutchinson), so two of them
    a view are added up over all views.

    Args:
        gaussians: N Gaussians.
        views: at least one.
        on_view: called after each.
        seed: of the signs.

    Returns:
        (N,) float64; the lowest are pruned; -inf for what no pixel sees.

    Source: Hanson et al., "PUP 3D-GS", CVPR 2025.
    """
    rng = np.random.default_rng(seed)
    n = len(gaussians)
    fisher = np.zeros((n, _PARAMETERS, _PARAMETERS))
    scales = np.exp(gaussians.log_scales.astype(np.float64))
    passes = _Passes(gaussians)
    for view in _needed(views):
        passes.render(view)
        for _ in range(_FISHER_PROBES):
            signs = rng.integers(0, 2, (*view.mask.shape, 3), dtype=np.int8) * 2 - 1
            gradient = passes.backward((signs * view.mask[..., None]).astype(np.float32))
            j = np.concatenate([gradient.means, gradient.log_scales / scales], axis=1)
            seen = np.flatnonzero(passes.touched)
            fisher[seen] += j[seen, :, None] * j[seen, None, :]
        on_view()
    trace = np.trace(fisher, axis1=1, axis2=2)
    scores = np.full(n, -np.inf)
    seen = np.flatnonzero(trace > 0)
    scaled = fisher[seen] / trace[seen, None, None] + _FISHER_RIDGE * np.eye(_PARAMETERS)
    scores[seen] = np.linalg.slogdet(scaled)[1] + _PARAMETERS * np.log(trace[seen])
    return scores


class _Passes:
    """Forward and backward passes of one set of Gaussians with shared buffers."""

    def __init__(self, gaussians: Gaussians) -> None:
        self.gaussians = gaussians.astype(np.float32)
        self.touched = np.zeros(len(gaussians), np.uint8)
        self._gradients = Gaussians(
            *(np.zeros_like(getattr(self.gaussians, f.name)) for f in dataclasses.fields(Gaussians))
        )
        self._renderer = _core.Renderer()
        self._rule = _core.BlendRule()

    def render(self, view: SeenView) -> None:
        image = np.zeros((view.camera.height, view.camera.width, 3), np.float32)
        self._renderer.render(
            self.gaussians,
            view.camera,
            view.camera_from_world,
            self._rule,
            (0.0, 0.0, 0.0),
            self.gaussians.sh_degree,
            DEFAULT_UNSCENTED,
            image,
            None,
            None,
            True,
        )

    def backward(self, dimage: np.ndarray) -> Gaussians:
        self._renderer.backward(dimage, None, None, self._gradients, self.touched, True)
        return self._gradients


def _grey(gaussians: Gaussians) -> Gaussians:
    """The same shapes in mid-grey: no colour is clamped, so no gradient is cut off."""
    return Gaussians(
        gaussians.means,
        gaussians.quats,
        gaussians.log_scales,
        gaussians.opacity_logits,
        np.zeros((len(gaussians), 1, 3), gaussians.dtype),
    )


def _needed(views: Sequence[SeenView]) -> Sequence[SeenView]:
    if not views:
        raise InputError("scores need at least one view; give the views of the scene")
    return views
