"""Where float and double may rightly choose differently: pixels on a discontinuity of the rule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import gsut
import ray_model
import tolerances
from random_scenes import list_isas, relative_error

# Of Gaussians of which no tile may miss one: for `gaussians_in_view`.
SHAPES = {
    "ordinary": {},
    "needles": {"aspect": 2.5},
    "close": {"distances": (0.02, 0.5), "sizes": (0.1, 1.0)},
    "huge": {"sizes": (0.5, 5.0)},
    "tiny": {"sizes": (1e-4, 1e-2)},
}
REASONS = ("cut", "order", "origin", "stop", "thin")


def reason(expected: gsut.Render, row: int, column: int, off: float) -> str:
    """Why float may choose otherwise than double at a pixel; empty if there is no reason.

    Args:
        expected: the double reference's result.
        off: by how much they differ there.

    Returns:
        "cut": a Gaussian's alpha, or response, lies on the rule's cut-off; "order": two Gaussians
        that are seen have the same key to float; "origin": the nearest point of a Gaussian's line
        lies on the camera; "stop": the transmittance lies on the rule's limit; "thin": Gaussians so
        thin that the rounding of their place to float, over their thickness, explains `off`.
    """
    g, rule = expected.gaussians.to_dtype(np.float64), expected.rule
    pose, pixels = expected.camera_from_world, np.array([[row, column]])
    traced = ray_model.trace(g, expected.camera, pose, rule, pixels=pixels)
    distance2, along, alpha = traced.distance2[0], traced.along[0], traced.alpha[0]
    response, line = np.exp(-0.5 * distance2), traced.line_alpha[0]
    # In float, D has the error of the camera-relative mean over the smallest scale.
    distances = np.linalg.norm(g.means @ pose[:3, :3].T + pose[:3, 3], axis=1)
    rounding = tolerances.RENDER_KEY_MARGIN * distances / np.exp(g.log_scales).min(axis=1)
    wobble = line * np.sqrt(distance2) * rounding
    margin = wobble + tolerances.RENDER_CUT_MARGIN
    cut = np.abs(line - rule.alpha_min) < margin
    cut |= (rule.response_min > 0) & (np.abs(response - rule.response_min) < margin)
    if np.any(cut & (along > 0)):
        return "cut"
    at_origin = np.abs(along) < tolerances.RENDER_ORIGIN_MARGIN * (
        distances + np.exp(g.log_scales).max(axis=1)
    )
    if np.any(at_origin & (line >= rule.alpha_min)):
        return "origin"
    seen = np.flatnonzero(alpha >= rule.alpha_min)
    seen = seen[np.argsort(traced.keys[seen])]
    keys = traced.keys[seen]
    if np.any(np.diff(keys) < tolerances.RENDER_KEY_MARGIN * np.abs(keys[1:])):
        return "order"
    left = np.cumprod(1 - alpha[seen])
    stop = rule.transmittance_min
    if np.any(np.abs(left - stop) < tolerances.RENDER_STOP_MARGIN * stop):
        return "stop"
    return "thin" if off < np.sum(wobble[seen]) else ""


def flipped(found: gsut.Render, expected: gsut.Render) -> tuple[np.ndarray, dict[str, int]]:
    """Pixels that differ by more than RENDER_FLIP, each with a reason.

    Returns:
        (H, W) bool and the number of pixels by reason. Fails where there is no reason.
    """
    off = np.abs(found.image - expected.image).max(axis=2)
    off = np.maximum(off, np.abs(found.alpha - expected.alpha))
    counts = dict.fromkeys(REASONS, 0)
    for row, column in np.argwhere(off > tolerances.RENDER_FLIP):
        why = reason(expected, row, column, off[row, column])
        assert why, f"pixel {row}, {column} is off by {off[row, column]} for no reason"
        counts[why] += 1
    return off > tolerances.RENDER_FLIP, counts


def assert_isas_match(
    expected: gsut.Render,
    weights: Sequence[np.ndarray],
    camera: gsut.Camera,
    place: Any,
    *,
    gradient: float = tolerances.RENDER_GRADIENT,
    share: float = tolerances.EXTINCTION_FLIPS,
    explain: bool = False,
    **options: Any,
) -> int:
    """Holds the image and the gradients of every instruction set to those of the reference.

    Args:
        expected: of the reference.
        weights: of the loss: of image, alpha and depth.
        camera, place: from where its Gaussians are seen.
        gradient: the relative error of each gradient, at most.
        share: of pixels where float may choose otherwise, which are left out.
        explain: each of them must have a reason, see `reason`.
        options: of `gsut.render`.

    Returns:
        How many pixels were left out.
    """
    g, count = expected.gaussians, 0
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        found = gsut.render(g, camera, place, **options)
        off = np.abs(found.image - expected.image).max(axis=2)
        same = np.maximum(off, np.abs(found.alpha - expected.alpha)) < tolerances.RENDER_FLIP
        count += int((~same).sum())
        assert same.mean() > 1 - share
        if explain:
            flipped(found, expected)
        for name in ("image", "alpha"):
            rms = np.sqrt(
                np.mean(np.square((getattr(found, name) - getattr(expected, name))[same]))
            )
            assert rms < tolerances.RENDER_IMAGE_RMS, (isa, name, rms)
        error = relative_error(found.depth[same], expected.depth[same])
        assert error < tolerances.RENDER_DEPTH, (isa, "depth", error)
        kept = [np.where(same if w.ndim == 2 else same[..., None], w, 0) for w in weights]
        slopes = gsut.render_backward(found, *kept)
        truth = gsut.render_backward(expected, *kept)
        for field in g.list_arrays():
            error = relative_error(
                getattr(slopes.gaussians, field), getattr(truth.gaussians, field)
            )
            assert error < gradient, (isa, field, error)
        assert slopes.pose.shape == truth.pose.shape
        error = relative_error(slopes.pose, truth.pose)
        assert error < gradient, (isa, "pose", error)
    return count


def assert_none_missed(
    g: gsut.Gaussians, camera: gsut.Camera, place: Any, label: Any, **options: Any
) -> int:
    """Holds the tiles to the reference: what has a pixel above the cut-off there must be touched.

    Nothing hides anything (transmittance_min 0). The reference's cut-off is a little higher, for
    rounding.

    Returns:
        How many Gaussians the reference sees.
    """
    rule, strict = gsut.BlendRule(), gsut.BlendRule()
    rule.transmittance_min = strict.transmittance_min = 0.0
    strict.alpha_min = rule.alpha_min * (1 + tolerances.RENDER_MISS_MARGIN)
    dimage = np.ones((camera.height, camera.width, 3))
    truth = gsut.render(g, camera, place, blend=strict, dtype="float64", **options)
    visible = gsut.render_backward(truth, dimage).gaussians.sh[:, 0, 0] > 0
    found = gsut.render(g, camera, place, blend=rule, **options)
    missed = np.flatnonzero(visible & ~gsut.render_backward(found, dimage).touched)
    assert len(missed) == 0, (label, missed)
    return int(visible.sum())
