"""The verdict at the end of a command: how good the result is, why, and what to try next."""

from __future__ import annotations

import dataclasses
from typing import Any

LEVELS = ("good", "usable", "poor")


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
    def of(cls, values: dict[str, Any]) -> Verdict:
        """From the values that `as_dict` gave, also through JSON."""
        return cls(**{**values, "reasons": tuple(values["reasons"])})

    def as_dict(self) -> dict[str, Any]:
        """For metrics.json, poses.json and `--json`."""
        return dataclasses.asdict(self)


def worst(verdicts: list[Verdict]) -> Verdict:
    """The verdict of several stages: the poorest one, and the first of these."""
    return max(verdicts, key=lambda verdict: LEVELS.index(verdict.level))
