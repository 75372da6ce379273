"""Measures what automatic choices of a training cost against fixed ones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.proving.commands import run_gsut

# Small, with more views held out than usual: differences count.
_SMALL = ("--preset", "fast", "--max-side", "128", "--test-every", "4", "--force", "--quiet")
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
    metrics = _train(data, work / "automatic")
    if metrics is None:
        return {}
    own = {
        "degree": metrics["complexity"]["sh_degree"],
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
            fixed = _train(data, work / f"{choice}-{value}", flags[choice], str(value))
            if fixed is not None:
                shown[choice][str(value)] = fixed["psnr"]
    return shown


def _train(data: Path, out: Path, *words: str) -> dict[str, Any] | None:
    outcome = run_gsut("train", data, "-o", out, *_SMALL, *words, work=out.parent)
    if outcome.status != 0:
        return None
    return json.loads((out / "metrics.json").read_text("utf-8"))


def find_regret(row: Mapping[str, Any], choice: str) -> float | None:
    """Returns by how many dB the best other value of a choice beats the automatic one."""
    shown = row.get("regret") or {}
    fixed = shown.get(choice)
    return max(fixed.values()) - shown["automatic"] if fixed else None
