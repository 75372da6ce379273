"""Reads what an image is drawn with: the blend rule, the background, and features."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import BlendRule, InputError
from gsut.gaussians import Gaussians, StoredGaussians


def read_rule(parity: str | None, blend: BlendRule | None, order: str | None) -> BlendRule:
    """Makes the blend rule of a render from what its caller gave.

    Raises:
        InputError: two of them contradict each other, or a name is unknown.
    """
    if blend is not None and parity is not None:
        raise InputError("give parity or blend, not both")
    if blend is not None and order is not None:
        raise InputError("give order or blend, which has an order, not both")
    rule = BlendRule(parity or "") if blend is None else blend
    if order is not None:
        rule.order = order
    return rule


def set_response(gaussians: Any, response: str | None) -> Any:
    """Returns the Gaussians with another response; None: as they are.

    Raises:
        InputError: it is unknown, or they are not `Gaussians`.
    """
    if response is not None and not isinstance(gaussians, Gaussians):
        raise InputError("a response belongs to Gaussians in memory with logits; leave it out")
    return gaussians if response is None else dataclasses.replace(gaussians, response=response)


def read_background(
    background: Sequence[float] | np.ndarray | None, camera: _core.Camera
) -> tuple[tuple[float, float, float], np.ndarray | None]:
    """Reads one colour, or black and an image (H, W, 3) to stand behind it where there are rays."""
    black = (0.0, 0.0, 0.0)
    if background is None:
        return black, None
    found = _core.read_array(background, "background")
    shape = (camera.height, camera.width, 3)
    if found.shape not in ((3,), shape) or found.dtype.kind not in "fiu":
        raise InputError(
            f"background must be 3 finite numbers, found shape {found.shape}; or give an image of "
            f"shape {shape}"
        )
    if not (np.abs(found) <= np.finfo(np.float32).max).all():
        raise InputError("background must be 3 finite numbers, found NaN, infinity or one beyond")
    if found.dtype.kind != "f" and (found.ndim == 3 or found.min() < 0 or found.max() > 1):
        raise InputError(
            f"background must be in [0, 1], found {found.dtype} of {found.min()} to {found.max()}; "
            "divide by 255"
        )
    if found.ndim == 1:
        red, green, blue = found.tolist()
        return (float(red), float(green), float(blue)), None
    return black, np.where(camera.rays()[1][..., None], found, 0.0)


def read_features(
    features: np.ndarray | None, background: Any, gaussians: Any, dtype: str
) -> dict[str, Any]:
    """Reads features and what is behind them as arguments of the core's job; {} without any."""
    if features is None:
        if background is not None:
            raise InputError("features_background is given without features")
        return {}
    if isinstance(gaussians, StoredGaussians):
        raise InputError("features belong to Gaussians in memory, not to those in a file")
    num_gaussians = len(gaussians)
    found = _core.read_array(features, "features")
    if found.ndim != 2 or len(found) != num_gaussians or found.shape[1] == 0:
        raise InputError(
            f"features must have shape ({num_gaussians}, D), a row a Gaussian, found {found.shape}"
        )
    values = np.ascontiguousarray(found, dtype)
    width = values.shape[1]
    behind = np.zeros(width) if background is None else np.asarray(background)
    if behind.shape != (width,):
        raise InputError(f"features_background must have shape ({width},), found {behind.shape}")
    behind = np.ascontiguousarray(behind, dtype)
    for name, array in (("features", values), ("features_background", behind)):
        if not np.isfinite(array).all():
            raise InputError(f"{name} must be finite in {dtype}, found NaN or infinity")
    return {"features": values, "features_background": behind}
