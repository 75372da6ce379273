"""A stage: a world, its light, and where a camera can go in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from lab.proving.world import Mesh, Sky


@dataclasses.dataclass(frozen=True)
class Stage:
    """A scene before anybody films it. Lengths in metres, z up.

    Attributes:
        mesh, sky: what is there.
        focus: what cameras that look inward look at.
        orbit: radius and height above the focus of ways around it.
        line: ends of a free straight way.
        spot: a place to turn on.
        inward: cameras on an orbit look at the focus, else ahead.
        motions: that make sense here, the usual ones first.
        lean: of ways along the line: where cameras look, radians to the left of ahead.
        tilt: radians above the horizon that a camera looks.
        reach: metres that what is seen is away, in the rough.
        movers: builds what moves at a time in seconds; None: nothing does.
    """

    mesh: Mesh
    sky: Sky
    focus: Sequence[float]
    orbit: tuple[float, float]
    line: tuple[Sequence[float], Sequence[float]]
    spot: Sequence[float]
    inward: bool
    motions: tuple[str, ...]
    lean: float = 0.0
    tilt: float = -0.05
    reach: float = 4.0
    movers: Callable[[float], Mesh] | None = None
