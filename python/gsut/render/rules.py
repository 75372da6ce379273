"""Chooses by which order and response a render blends."""

from __future__ import annotations

import dataclasses
from typing import Any

from gsut._core import BlendRule, InputError
from gsut.gaussians import Gaussians


def make_rule(parity: str | None, blend: BlendRule | None, order: str | None) -> BlendRule:
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
