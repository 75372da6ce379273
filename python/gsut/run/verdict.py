"""The verdict at the end of a command: how good the result is, why, and what to try next."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How good a result is, in words for somebody who does not know the measures.

    Args:
        level: "good", "usable" or "poor".
        what: what was found, with the figures that say so; a sentence without its full stop.
        reasons: what keeps it from being better, the most important first; empty if good.
        advice: what to do next: a command, or what to photograph; may be empty.
        hidden_level: the level by those reasons alone that no held-out view shows; None: `level`.
    """

    LEVELS: ClassVar[tuple[str, ...]] = ("good", "usable", "poor")
    # Of `as_dict` in JSON, see `gsut.files.check_shape`.
    SHAPE: ClassVar[dict[str, Any]] = {
        "level": frozenset(LEVELS), "what": str, "reasons": [str], "advice": str,
        "hidden_level?": (frozenset(LEVELS), type(None)),
    }  # fmt: skip
    level: str
    what: str
    reasons: tuple[str, ...] = ()
    advice: str = ""
    hidden_level: str | None = None

    def __post_init__(self) -> None:
        if self.level not in self.LEVELS:
            raise ValueError(f"level is {self.level!r}; one of {', '.join(self.LEVELS)}")

    def __str__(self) -> str:
        why = f" ({'; '.join(self.reasons)})" if self.reasons else ""
        advice = f" Next: {self.advice}" if self.advice else ""
        return f"{self.level}: {self.what}{why}.{advice}"

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Verdict:
        """Makes a verdict from the values of `as_dict`, also after a way through JSON."""
        names = {field.name for field in dataclasses.fields(cls)}
        of_class = {name: value for name, value in values.items() if name in names}
        return cls(**{**of_class, "reasons": tuple(values["reasons"])})

    def as_dict(self) -> dict[str, Any]:
        """Returns plain values for metrics.json, poses.json and `--json`."""
        return dataclasses.asdict(self) | {"reasons": list(self.reasons)}
