"""Runs a case through the double reference and every instruction set, forward and backward."""

from __future__ import annotations

import dataclasses

import numpy as np

import flips
import gsut
import tolerances
from random_scenes import list_isas, relative_error

FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))


@dataclasses.dataclass
class Outcome:
    """One path's image and gradients."""

    path: str  # "float64", or the name of an instruction set
    result: gsut.Render
    gradients: gsut.Gradients


def every_path() -> list[str]:
    """The double reference first, then the instruction sets."""
    return ["float64", *list_isas()]


def run_every_path(g, camera, pose, weights, **options) -> list[Outcome]:
    """Renders and differentiates; asserts that every number that comes out is finite."""
    outcomes = []
    for path in every_path():
        dtype = "float64" if path == "float64" else "float32"
        gsut.machine.set_isa("" if path == "float64" else path)
        result = gsut.render(g, camera, pose, dtype=dtype, **options)
        gradients = gsut.render_backward(result, *weights)
        for name in ("image", "alpha", "depth"):
            assert np.isfinite(getattr(result, name)).all(), (path, name)
        assert np.all((result.alpha >= 0) & (result.alpha <= 1)), path
        for name in FIELDS:
            assert np.isfinite(getattr(gradients.gaussians, name)).all(), (path, name)
        assert np.isfinite(gradients.pose).all(), path
        outcomes.append(Outcome(path, result, gradients))
    gsut.machine.set_isa("")
    assert len(outcomes) == 1 + len(list_isas())
    return outcomes


@dataclasses.dataclass
class Errors:
    """Largest over the instruction sets, against the double reference."""

    image: float  # any colour value
    alpha: float
    depth: float  # relative L2
    gradients: float  # relative L2, worst of the five arrays
    pose: float  # relative L2
    flips: int  # pixels on a discontinuity, left out of all of the above


def errors_of(outcomes: list[Outcome], weights) -> Errors:
    """How far the float paths are from the first outcome, the double reference.

    Pixels that lie on a discontinuity of the blend rule (see flips.py) are left out, and lose
    their weight in the loss.
    """
    truth = outcomes[0]
    assert truth.path == "float64" and len(outcomes) > 1
    worst = Errors(0, 0, 0, 0, 0, 0)
    expected = truth.result
    for outcome in outcomes[1:]:
        found = outcome.result
        off, counts = flips.flipped(found, expected)
        same = ~off
        worst.flips = max(worst.flips, sum(counts.values()))
        worst.image = max(worst.image, np.abs(found.image - expected.image)[same].max(initial=0))
        worst.alpha = max(worst.alpha, np.abs(found.alpha - expected.alpha)[same].max(initial=0))
        worst.depth = max(worst.depth, relative_error(found.depth[same], expected.depth[same]))
        slopes, right = outcome.gradients, truth.gradients
        if off.any():
            kept = [np.where(same if w.ndim == 2 else same[..., None], w, 0) for w in weights]
            gsut.machine.set_isa(outcome.path)
            slopes, right = (gsut.render_backward(r, *kept) for r in (found, expected))
            gsut.machine.set_isa("")
        arrays = [(getattr(slopes.gaussians, n), getattr(right.gaussians, n)) for n in FIELDS]
        # An array may be zero but for rounding (a round Gaussian's to its quaternion).
        floor = tolerances.HARD_ZERO_GRADIENT * max(np.linalg.norm(b) for _, b in arrays)
        for a, b in arrays:
            error = np.linalg.norm(a.astype(np.float64) - b) / max(np.linalg.norm(b), floor, 1e-30)
            worst.gradients = max(worst.gradients, float(error))
        worst.pose = max(worst.pose, relative_error(slopes.pose, right.pose))
    return worst
