"""How far a render may be from the truth, by what photographs show of each Gaussian."""

from __future__ import annotations

import dataclasses
import os
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import Array, read_npz, register_reader, write_npz
from gsut.gaussians import COLOR_ROUNDING, StoredGaussians

# Share of pixels whose difference one sigma bounds, as that of a normal distribution does.
_ONE_SIGMA = 0.68
# Shares of pixels for which a calibration has factors.
_LEVELS = (0.5, _ONE_SIGMA, 0.8, 0.9, 0.95)
_SIGMA = _LEVELS.index(_ONE_SIGMA)
# Factors where no view was held out: differences of colour have the tail of an exponential
# distribution, and one sigma is what training views show.
_FACTORS = tuple(np.log1p(-np.array(_LEVELS)) / np.log1p(-_ONE_SIGMA))
# Pixels of weight in all photographs together, below which none has shown a Gaussian.
_LEAST_WEIGHT = 0.05
# Part of a pixel that Gaussians which photographs show must cover for it to count as seen.
_LEAST_SEEN = 0.5
# Standard deviation of a depth, in spreads of the blended distances along the ray. No photograph
# calibrates it: this is the value of scenes whose depths are known exactly.
_PER_SPREAD = 0.55
# Standard deviation of a depth where the Gaussians of a ray agree, x its distance.
_PER_DISTANCE = 0.005
_OF_EACH = Array("f", ("N",), least=0.0)
# What `Confidence.save` writes.
_FIELDS = {
    "weight": _OF_EACH, "views": _OF_EACH, "residual": _OF_EACH,
    "mark": Array("i", ()), "levels": Array("f", ("L",)), "factors": Array("f", ("L",)),
    "held": Array("f", ("L",), finite=False), "held_by_view": Array("f", ("V", "L"), finite=False),
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Confidence:
    """What photographs show of N Gaussians, and how far renders of them are off.

    Attributes:
        weight: (N,) float32, sum of blend weights in the training views, in pixels.
        views: (N,) float32, effective number of these views: (sum of w)^2 / sum of w^2, w being
            the weight in a view.
        residual: (N,) float32, mean absolute difference of colour to the photographs, by weight.
        mark: checksum of the Gaussians' places.
        levels: (L,) shares of pixels.
        factors: (L,) times the residual that a pixel blends, bounds the difference of such a share.
        held: (L,) the share it bounds in held-out views that were not used for the factor; NaN
            with fewer than two.
        held_by_view: (V, L) the same of each held-out view.
    """

    weight: np.ndarray
    views: np.ndarray
    residual: np.ndarray
    mark: int
    levels: np.ndarray = dataclasses.field(default_factory=lambda: np.array(_LEVELS))
    factors: np.ndarray = dataclasses.field(default_factory=lambda: np.array(_FACTORS))
    held: np.ndarray = dataclasses.field(default_factory=lambda: np.full(len(_LEVELS), np.nan))
    held_by_view: np.ndarray = dataclasses.field(
        default_factory=lambda: np.zeros((0, len(_LEVELS)))
    )

    @staticmethod
    def from_sums(
        gaussians: Any, weight: np.ndarray, squares: np.ndarray, differences: np.ndarray
    ) -> Confidence:
        """Makes the confidence of Gaussians that is not calibrated yet.

        Args:
            gaussians: N Gaussians.
            weight, squares, differences: (N,) sums over views of blend weights w, of w^2, and of
                w times the pixels' differences of colour.
        """
        least = np.finfo(np.float64).tiny
        arrays = weight, weight**2 / np.maximum(squares, least), differences / (weight + least)
        weights, views, residual = (each.astype(np.float32) for each in arrays)
        return Confidence(weights, views, residual, _mark_places(gaussians))

    def __repr__(self) -> str:
        return f"Confidence(of {len(self.weight)} Gaussians, {self.describe()})"

    def describe(self) -> str:
        """Describes in a few words how well one sigma of the colour holds."""
        number = len(self.held_by_view)
        if number == 0:
            return "sigma of colour not calibrated: fewer than two views are held out"
        of_views = 100 * self.held_by_view[:, _SIGMA]
        low, high = of_views.min(), of_views.max()
        return (
            f"one sigma of colour holds {100 * self.held[_SIGMA]:.0f} % of the pixels of {number} "
            f"held-out views, {low:.0f} to {high:.0f} % of a view; {100 * _ONE_SIGMA:.0f} % are due"
        )

    def calibrate(self, ratios: Sequence[np.ndarray]) -> Confidence:
        """Calibrates the factors by held-out views; each half is judged by those of the other.

        Args:
            ratios: of each view (P,), differences of its pixels over those expected.

        Source: split conformal prediction (Lei et al., JASA 2018); pixels of one view are not
            independent, so the shares hold on average over views.
        """
        if not ratios:
            return self
        factors = np.quantile(np.concatenate(ratios), _LEVELS)
        if len(ratios) == 1:
            return dataclasses.replace(self, factors=factors)
        others = [np.quantile(np.concatenate(ratios[k::2]), _LEVELS) for k in (1, 0)]
        held = [np.mean(each[:, None] <= others[k % 2], axis=0) for k, each in enumerate(ratios)]
        sizes = [len(each) for each in ratios]
        return dataclasses.replace(
            self, factors=factors, held=np.average(held, axis=0, weights=sizes),
            held_by_view=np.array(held),
        )  # fmt: skip

    def is_of(self, gaussians: Any) -> bool:
        """Returns whether it was measured of these Gaussians, by their places and order."""
        return len(self.weight) == len(gaussians) and _mark_places(gaussians) == self.mark

    def list_channels(self, gaussians: Any, features: np.ndarray | None = None) -> np.ndarray:
        """Lists the features (N, 3) that a render blends for `add_sigmas`.

        Raises:
            InputError: the confidence is that of other Gaussians, or there are other features.
        """
        if features is not None:
            raise InputError("confidence is drawn as features: render your features by themselves")
        if isinstance(gaussians, StoredGaussians):
            raise InputError(
                "confidence needs all Gaussians in memory: free some, or compact the "
                "scene (gsut compact)"
            )
        if not self.is_of(gaussians):
            raise InputError(
                f"the confidence is of other Gaussians, {len(self.weight):,}; these are "
                f"{len(gaussians):,}: measure it again (gsut.rendering.measure_confidence)"
            )
        known = (self.weight >= _LEAST_WEIGHT).astype(np.float32)
        return np.stack([known, known * self.residual, known * self.views], axis=1)

    def expect_differences(self, result: Any) -> np.ndarray:
        """Computes the difference of colour (H, W) that training views have; NaN: never seen."""
        known, residual = result.features[..., 0], result.features[..., 1]
        return (
            residual / np.where(known >= _LEAST_SEEN, known, np.nan) + COLOR_ROUNDING
        )  # as of photographs

    def add_sigmas(self, result: Any) -> Any:
        """Returns a render with the maps of `render(confidence=...)`."""
        expected = self.expect_differences(result)
        seen = np.isfinite(expected)
        covered = np.where(seen, result.alpha, np.nan)
        depth = self.find_depth_sigma(result.distortion, result.depth, covered)
        views = result.features[..., 2] / np.where(seen, result.features[..., 0], 1.0)
        maps = {
            "color_sigma": self.factors[_SIGMA] * expected,
            "depth_sigma": depth,
            "seen_views": np.where(seen, views, 0.0),
        }
        return dataclasses.replace(
            result, **{name: values.astype(np.float32) for name, values in maps.items()}
        )

    @staticmethod
    def find_depth_sigma(distortion: Any, depth: Any, alpha: Any) -> Any:
        """Computes the standard deviation of distances along rays by how widely they spread.

        Args:
            distortion, depth, alpha: (H, W) or of a pixel, see `Rendered`.
        """
        return np.hypot(_PER_SPREAD * np.sqrt(distortion / alpha), _PER_DISTANCE * depth / alpha)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .npz file."""
        write_npz(path, dataclasses.asdict(self), pack=True)

    @staticmethod
    @register_reader("confidence", ".npz")
    def load(path: str | os.PathLike[str]) -> Confidence:
        """Reads what `save` wrote.

        Raises:
            InputError: it is not such a file.
        """
        values: dict[str, Any] = read_npz(path, _FIELDS, fails=_make_error)
        return Confidence(**values | {"mark": int(values["mark"])})


def _make_error(where: object, what: str, _: str) -> InputError:
    return InputError(f"{where} holds no confidence: {what}; remove it, and it is measured again")


def _mark_places(gaussians: Any) -> int:
    """Computes a checksum of the Gaussians' places and order."""
    return zlib.crc32(
        gaussians.means.astype(np.float32).tobytes(), zlib.crc32(gaussians.origin.tobytes())
    )
