"""Measures what automatic choices of a training cost against fixed ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lab.proving.commands import run_training

# Small, with more views held out than usual: differences count.
_SMALL = ("--preset", "fast", "--max-side", "128", "--test-every", "4", "--force")
_DEGREES = (0, 1, 2, 3)
_FACTORS = (0.5, 2.0)  # of the automatic number of Gaussians and of steps
CHOICES = ("degree", "gaussians", "steps")


def measure_regret(data: Path, work: Path) -> dict[str, Any]:
    """Trains with automatic choices, and with one of them fixed at a time.

    Args:
        data: an exact dataset.
        work: an existing folder.

    Returns:
        {choice: {value: held-out PSNR in dB}} of the fixed ones, and {"automatic": PSNR}; empty
        where the first training failed.
    """
    _, metrics = run_training(data, work / "automatic", *_SMALL, work=work)
    if not metrics:
        return {}
    own = {
        "degree": metrics["sh_degree"],
        "gaussians": metrics["num_gaussians"],
        "steps": metrics["steps"],
    }
    tried = {
        "degree": [value for value in _DEGREES if value != own["degree"]],
        "gaussians": [round(factor * own["gaussians"]) for factor in _FACTORS],
        "steps": [round(factor * own["steps"]) for factor in _FACTORS],
    }
    flags = {"degree": "--sh-degree", "gaussians": "--max-gaussians", "steps": "--steps"}
    shown: dict[str, Any] = {"automatic": metrics["psnr"]}
    for choice in CHOICES:
        shown[choice] = {}
        for value in tried[choice]:
            words = (*_SMALL, flags[choice], str(value))
            _, fixed = run_training(data, work / f"{choice}-{value}", *words, work=work)
            if fixed:
                shown[choice][str(value)] = fixed["psnr"]
    return shown


def find_regret(row: Mapping[str, Any], choice: str) -> float | None:
    """Returns by how many dB the best other value of a choice beats the automatic one."""
    shown = row.get("regret") or {}
    fixed = shown.get(choice)
    return max(fixed.values()) - shown["automatic"] if fixed else None
