"""The light that photographs were taken in: exposure and white balance of each, falloff of a lens.

A photograph shows the scene times a gain of its own, one a channel, times the falloff of its lens,
a function of the field angle. Gaussians hold the scene at the mean gain and without falloff, as
bright as the photographs are on average: gain times falloff has a mean of 1 over their pixels.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

_CAMERAS_KEPT = 8  # whose field angles are kept, 8 bytes a pixel
ORDERS = 3  # coefficients of a channel's falloff: of t^2, t^4, t^6


@dataclasses.dataclass(frozen=True)
class Falloff:
    """Falloff of one lens: f(t) = 1 + a t^2 + b t^4 + c t^6, with t = field angle / `max_angle`.

    Args:
        max_angle: radians, of the widest pixel.
        coefficients: (3, ORDERS) a row a channel.
    """

    max_angle: float
    coefficients: np.ndarray

    def evaluate(self, angles: np.ndarray) -> np.ndarray:
        """Returns factors (..., 3) at field angles (...) in radians; 1 where the angle is NaN."""
        square = np.nan_to_num(angles / self.max_angle, nan=0.0) ** 2
        out = np.empty((*square.shape, 3))
        for channel, (a, b, c) in enumerate(self.coefficients):
            out[..., channel] = 1.0 + square * (a + square * (b + square * c))
        return out

    @staticmethod
    def compute_basis(t: np.ndarray) -> np.ndarray:
        """Returns the even powers (..., ORDERS) of t (...)."""
        return np.stack([t ** (2 * k) for k in range(1, ORDERS + 1)], axis=-1)

    def as_dict(self) -> dict[str, Any]:
        """Returns what metrics.json and checkpoints hold."""
        return {"max_angle": self.max_angle, "coefficients": self.coefficients.tolist()}

    @staticmethod
    def from_dict(values: dict[str, Any] | None) -> Falloff | None:
        """Reads what `as_dict` returned; None stays None."""
        if values is None:
            return None
        return Falloff(float(values["max_angle"]), np.array(values["coefficients"], float))


@dataclasses.dataclass(frozen=True)
class Light:
    """Gains of a scene's views and falloffs of its cameras.

    Args:
        gains: (V, 3), one row a view of the scene.
        falloffs: one a camera of the scene, or None where the lens has none.
    """

    # Describes the light of images that show the Gaussians as they are.
    SHOWN: ClassVar[str] = (
        "in the light of the scene: the photographs' mean brightness and colour, without the "
        "falloff of the lens"
    )

    gains: np.ndarray
    falloffs: tuple[Falloff | None, ...]

    def on(self, camera: Any, view: int, camera_index: int) -> np.ndarray:
        """Returns the factor that makes a render of a view look like its photograph.

        Returns:
            (3,) float32, or (H, W, 3) where the lens has a falloff.
        """
        falloff = self.falloffs[camera_index]
        gain = self.gains[view].astype(np.float32)
        return (
            gain
            if falloff is None
            else gain * falloff.evaluate(compute_field_angles(camera)).astype("f4")
        )

    def as_dict(self, names: Sequence[str]) -> dict[str, Any]:
        """Returns what metrics.json holds: gains by the views' names."""
        return {
            "gains": dict(zip(names, self.gains.tolist(), strict=True)),
            "falloffs": [None if each is None else each.as_dict() for each in self.falloffs],
        }

    def note(self) -> str:
        """Describes gains and falloff in sentences for the report."""
        logs = np.log(self.gains)
        brightness = logs.mean(axis=1)
        balance = logs - brightness[:, None]
        words = ""
        if np.ptp(logs, axis=0).any():
            words = (
                f"The photographs differ in exposure by {100 * brightness.std():.1f} % and in white"
                f" balance by {100 * balance.std():.1f} % (standard deviation). Gaussians show the "
                "scene at the mean of both; renders are compared at the photograph's own, which for"
                " held-out views is their neighbours'. "
            )
        for falloff in self.falloffs:
            if falloff is not None:
                rim = float(falloff.evaluate(np.array([falloff.max_angle])).mean())
                words += f"The lens passes {100 * rim:.0f} % of the light at its rim. "
        words += (
            "Films, exported files and the viewer away from the photographs show the Gaussians "
            f"{self.SHOWN}. "
        )
        return words + "--exposure off leaves this in the scene."

    @staticmethod
    def from_dict(values: dict[str, Any], names: Sequence[str]) -> Light:
        """Reads what `as_dict` returned for views of these names; a new view has a gain of 1."""
        gains = [values["gains"].get(name, [1.0, 1.0, 1.0]) for name in names]
        return Light(np.array(gains), tuple(Falloff.from_dict(f) for f in values["falloffs"]))


@functools.lru_cache(maxsize=_CAMERAS_KEPT)
def compute_field_angles(camera: Any) -> np.ndarray:
    """Computes the angle (H, W) of each pixel's ray to the optical axis in radians; NaN: no ray.

    Kept for the last cameras, and not to be written to.
    """
    rays, valid = camera.rays()
    rays = np.asarray(rays, np.float64)
    angles = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    angles[~valid] = np.nan
    angles.setflags(write=False)
    return angles
