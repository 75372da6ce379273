"""What was lifted onto Gaussians: how it looks from any view, and its file."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import Array, read_npz, register_reader, write_npz
from gsut.render import Render, render

UNKNOWN = -1  # the label of a pixel or a Gaussian that has none
_SUFFIX = ".npz"
_LABELS = np.iinfo(np.int32)
_FIELDS = {
    "features": Array("f", ("N", "D"), most=float(np.finfo(np.float32).max)),
    "weights": Array("f", ("N",), least=0.0, most=float(np.finfo(np.float32).max)),
    "ids?": Array("i", ("D",), least=_LABELS.min, most=_LABELS.max),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Lifted:
    """Values of Gaussians, each the mean of the pixels that see it.

    Attributes:
        features: (N, D) float32 mean of the maps by blend weight; of labels the share of each, a
            column an id. 0 where `weights` are.
        weights: (N,) float32 sums of blend weights; 0: no pixel saw the Gaussian.
        ids: (D,) int32 the labels, rising; None: values.
    """

    features: np.ndarray
    weights: np.ndarray
    ids: np.ndarray | None = None

    def __post_init__(self) -> None:
        features, weights, ids = self.features, self.weights, self.ids
        if features.ndim != 2 or features.shape[1] == 0 or weights.shape != features.shape[:1]:
            raise InputError(
                f"lifted features must have shape (N, D) and weights (N,), found {features.shape} "
                f"and {weights.shape}"
            )
        if ids is not None and ids.shape != features.shape[1:]:
            raise InputError(
                f"lifted ids must have shape {features.shape[1:]}, an id a column, found "
                f"{ids.shape}"
            )

    def __repr__(self) -> str:
        what = f"{self.features.shape[1]} {'values' if self.ids is None else 'labels'}"
        return f"Lifted({what} of {len(self.weights):,} Gaussians)"

    @property
    def labels(self) -> np.ndarray:
        """Chooses the label (N,) int32 of most of each Gaussian's weight; -1: no pixel saw it.

        Raises:
            InputError: values were lifted, not labels.
        """
        if self.ids is None:
            raise InputError("values were lifted, not labels: lift with labels=True")
        return np.where(self.weights > 0, self.ids[self.features.argmax(axis=1)], UNKNOWN)

    def render(
        self, gaussians: Any, camera: Any, camera_from_world: Any, **options: Any
    ) -> np.ndarray:
        """Renders what was lifted.

        Args:
            gaussians: those that it was lifted onto.
            camera, camera_from_world, options: as of `gsut.render`.

        Returns:
            (H, W, D) float32 weighted mean of the Gaussians of each pixel, NaN where none of them
            has a value; of labels (H, W) int32, that of most of the weight, -1 where there is none.

        Raises:
            InputError: the Gaussians are not as many, or as of `gsut.render`.
        """
        if len(gaussians) != len(self.weights):
            raise InputError(
                f"this was lifted onto {len(self.weights):,} Gaussians, found {len(gaussians):,}; "
                "lift onto these"
            )
        seen = (self.weights > 0).astype(np.float32)[:, None]
        values = np.concatenate([self.features, seen], axis=1)
        by_centers = gaussians.order_by_centers()
        drawn = render(by_centers, camera, camera_from_world, features=values, **options)
        return self.read_features(drawn)

    def read_features(self, drawn: Render) -> np.ndarray:
        """Divides rendered features and their last channel, the weight of those that have any."""
        assert drawn.features is not None
        sums, weight = drawn.features[..., :-1], drawn.features[..., -1]
        if self.ids is not None:
            return np.where(weight > 0, self.ids[sums.argmax(axis=2)], UNKNOWN)
        with np.errstate(invalid="ignore", divide="ignore"):
            means = sums / weight[..., None]
        return np.where(weight[..., None] > 0, means, np.float32(np.nan))

    @staticmethod
    def check_name(path: str | os.PathLike[str]) -> Path:
        """Returns the path of a file of lifted values.

        Raises:
            InputError: another extension than .npz.
        """
        file = Path(path)
        if file.suffix.lower() != _SUFFIX:
            raise InputError(f"{file}: what was lifted is written as {_SUFFIX}; give such a name")
        return file

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes an .npz of features, weights and, of labels, ids.

        Raises:
            InputError: another extension.
        """
        file = self.check_name(path)
        arrays = {"features": self.features, "weights": self.weights}
        if self.ids is not None:
            arrays["ids"] = self.ids
        write_npz(file, arrays, pack=True)

    @classmethod
    @register_reader("what was lifted", ".npz")
    def load(cls, path: str | os.PathLike[str]) -> Lifted:
        """Reads what `save` wrote.

        Raises:
            InputError: absent, damaged, or another file.
        """
        file = Path(path)
        if not file.is_file():
            raise InputError(f"{file}: no such file; `gsut lift` writes it")
        found = read_npz(file, _FIELDS, fails=_make_error)
        ids = found.get("ids")
        return cls(
            np.ascontiguousarray(found["features"], np.float32),
            np.ascontiguousarray(found["weights"], np.float32),
            None if ids is None else ids.astype(np.int32),
        )


def _make_error(where: object, what: str, _: str) -> InputError:
    return InputError(f"{where}: no file of `gsut lift`: {what}")
