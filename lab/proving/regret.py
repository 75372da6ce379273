"""Measures what the chosen degree of the harmonics costs against the better one."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lab.proving.commands import run_training

# More views than usual are held out: differences count.
_FLAGS = ("--preset", "fast", "--test-every", "4", "--force")
_DEGREES = (1, 3)
_SEEDS = (0, 1)
# How a training reports its short trainings.
_GAIN = re.compile(r"showed (\d+) photographs set aside ([+-][\d.]+) \+- ([\d.]+) dB")


def measure_regret(data: Path, work: Path) -> dict[str, Any]:
    """Trains with the degree that short trainings choose, and with fixed ones in two seeds.

    Args:
        data: an exact dataset.
        work: an existing folder.

    Returns:
        {"chosen": degree, "short": photographs set aside, gain and standard error in dB (empty if
        they were too few), "degrees": {degree: held-out PSNR in dB of each seed}}; {} where a
        training failed.
    """

    def train(*words: str) -> dict[str, Any]:
        return run_training(data, work / "-".join(("run", *words)), *_FLAGS, *words, work=work)[1]

    automatic = train()
    runs = {
        degree: [train("--sh-degree", str(degree), "--seed", str(seed)) for seed in _SEEDS]
        for degree in _DEGREES
    }
    if not automatic or not all(all(each) for each in runs.values()):
        return {}
    found = _GAIN.search(" ".join(automatic["notes"]))
    return {
        "chosen": automatic["sh_degree"],
        "short": [float(value) for value in found.groups()] if found else [],
        "degrees": {str(degree): [run["psnr"] for run in each] for degree, each in runs.items()},
    }


def find_regret(row: Mapping[str, Any]) -> float | None:
    """Returns by how many dB the better degree beats the chosen one, in the mean of the seeds."""
    shown = row.get("regret") or {}
    means = {int(key): sum(each) / len(each) for key, each in shown.get("degrees", {}).items()}
    return max(means.values()) - means[shown["chosen"]] if means else None
