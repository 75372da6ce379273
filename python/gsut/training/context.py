"""Gaussians that are drawn with those that are trained, and stay as they are."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut.gaussians import Gaussians, merge_gaussians


class Context:
    """What is drawn beside what is trained.

    Args:
        gaussians: that stay; None: there are none, and everything passes as it is.
    """

    def __init__(self, gaussians: Gaussians | None) -> None:
        self._gaussians = gaussians
        self._joined: Gaussians | None = None
        self._count = 0  # trained ones

    @property
    def is_empty(self) -> bool:
        """Whether what is trained is all that is drawn."""
        return self._gaussians is None

    def around(self, trained: Any) -> Any:
        """Those that are trained, then those that stay; valid until the next call."""
        if self._gaussians is None:
            return trained
        self._count = len(trained)
        if self._joined is None or len(self._joined) != self._count + len(self._gaussians):
            self._joined = merge_gaussians([trained, self._gaussians])
        for field in dataclasses.fields(trained):
            getattr(self._joined, field.name)[: self._count] = getattr(trained, field.name)
        return self._joined

    def trained(self, rows: Any) -> Any:
        """The rows of those that are trained, of all that was drawn last."""
        return rows if self._gaussians is None else rows[: self._count]
