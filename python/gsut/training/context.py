"""Draws Gaussians that stay as they are together with those that are trained."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut.gaussians import Gaussians, merge_gaussians


class Context:
    """Gaussians that are drawn beside the trained ones and not changed.

    Args:
        gaussians: these Gaussians; None: there are none, and everything passes unchanged.
    """

    def __init__(self, gaussians: Gaussians | None) -> None:
        self._gaussians = gaussians
        self._joined: Gaussians | None = None
        self._num_trained = 0

    @property
    def is_empty(self) -> bool:
        """Whether only trained Gaussians are drawn."""
        return self._gaussians is None

    def append_to(self, trained: Any) -> Any:
        """Returns the trained Gaussians followed by the context; valid until the next call."""
        if self._gaussians is None:
            return trained
        self._num_trained = len(trained)
        if self._joined is None or len(self._joined) != self._num_trained + len(self._gaussians):
            self._joined = merge_gaussians([trained, self._gaussians])
        for field in dataclasses.fields(trained):
            getattr(self._joined, field.name)[: self._num_trained] = getattr(trained, field.name)
        return self._joined

    def select_trained(self, rows: Any) -> Any:
        """Returns those of all drawn rows that belong to trained Gaussians."""
        return rows if self._gaussians is None else rows[: self._num_trained]
