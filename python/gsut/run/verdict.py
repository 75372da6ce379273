"""The verdict at the end of a command: how good the result is, why, and what to try next."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

LEVELS = ("good", "usable", "poor")
# Below this number of pictures a scene has views from too few sides.
_FEW_PICTURES = 20
# Share of blurred pictures above which the sharp ones no longer make up for them.
_MANY_BLURRED = 0.25


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How good a result is, in words for somebody who does not know the measures.

    Args:
        level: "good", "usable" or "poor".
        what: what was found, with the figures that say so; a sentence without its full stop.
        reasons: what keeps it from being better, the most important first; empty if good.
        advice: what to do next: a command, or what to photograph; may be empty.
    """

    level: str
    what: str
    reasons: tuple[str, ...] = ()
    advice: str = ""

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise ValueError(f"level is {self.level!r}; one of {', '.join(LEVELS)}")

    def __str__(self) -> str:
        why = f" ({'; '.join(self.reasons)})" if self.reasons else ""
        advice = f" Next: {self.advice}" if self.advice else ""
        return f"{self.level}: {self.what}{why}.{advice}"

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Verdict:
        """Makes a verdict from the values of `as_dict`, also after a way through JSON."""
        return cls(**{**values, "reasons": tuple(values["reasons"])})

    def as_dict(self) -> dict[str, Any]:
        """Returns plain values for metrics.json, poses.json and `--json`."""
        return dataclasses.asdict(self) | {"reasons": list(self.reasons)}


def combine_verdicts(verdicts: Sequence[Verdict]) -> Verdict:
    """Returns the poorest verdict (the first of equals), with the reasons of all that are not good.

    Args:
        verdicts: of the stages of one command; at least one.
    """
    poorest = max(verdicts, key=lambda verdict: LEVELS.index(verdict.level))
    reasons = (r for v in (poorest, *verdicts) if v.level != "good" for r in v.reasons)
    return dataclasses.replace(poorest, reasons=tuple(dict.fromkeys(reasons)))


def judge_pictures(figures: dict[str, Any]) -> Verdict:
    """Judges the pictures that a capture chose, by their number and sharpness.

    Args:
        figures: of a capture: "frames", a row for each picture, and "size".
    """
    rows = figures["frames"]
    blurred = sum(bool(row.get("blurred")) for row in rows)
    what = f"{len(rows)} pictures of {figures['size'][0]} x {figures['size'][1]}"
    if len(rows) < _FEW_PICTURES:
        return Verdict(
            "usable", what, (f"only {len(rows)} pictures",),
            "take 60 or more, walking around what you want to see",
        )  # fmt: skip
    if blurred > _MANY_BLURRED * len(rows):
        return Verdict(
            "usable", what, (f"{blurred} of them blurred",),
            "film more slowly, or with more light",
        )  # fmt: skip
    return Verdict("good", what)
