"""The verdict at the end of a command: how good the result is, why, and what to try next."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

LEVELS = ("good", "usable", "poor")


class Fault(NamedTuple):
    """Something that may keep a result from being good.

    Attributes:
        severity: 0 if there is nothing wrong; 1: the result is usable at most; 2: it is poor.
        what: the fault, in words.
        advice: what to do against it.
        is_visible: whether held-out views show it, so that they decide how bad it is.
    """

    severity: int
    what: str
    advice: str
    is_visible: bool = False


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
        if self.level not in LEVELS:
            raise ValueError(f"level is {self.level!r}; one of {', '.join(LEVELS)}")

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

    @classmethod
    def from_faults(cls, what: str, faults: Iterable[Fault], advice: str) -> Verdict:
        """Makes the verdict of a result with faults; the worst one sets level and advice.

        Args:
            what: what was found.
            faults: causes before what they lead to; those of severity 0 do not count.
            advice: what to do next if there is no fault.
        """
        found = sorted((f for f in faults if f.severity > 0), key=lambda fault: -fault.severity)
        level = LEVELS[found[0].severity if found else 0]
        hidden = LEVELS[max((f.severity for f in found if not f.is_visible), default=0)]
        advice = found[0].advice if found else advice
        return cls(level, what, tuple(f.what for f in found), advice, hidden)

    def as_dict(self) -> dict[str, Any]:
        """Returns plain values for metrics.json, poses.json and `--json`."""
        return dataclasses.asdict(self) | {"reasons": list(self.reasons)}


def combine_verdicts(measured: Verdict, *inferred: Verdict) -> Verdict:
    """Returns the poorest verdict (the first of equals), with the reasons of all that are not good.

    What earlier stages infer about the result lowers what was measured of it by one level at most,
    and only by what held-out views do not show: where these are good, a poor guess of their causes
    stays a reason and lowers nothing.

    Args:
        measured: of the result itself.
        inferred: of the stages before.
    """
    verdicts = measured, *inferred
    levels = [LEVELS.index(measured.level)]
    levels += [LEVELS.index(verdict.hidden_level or verdict.level) for verdict in inferred]
    level = min(max(levels), levels[0] + 1)
    poorest = verdicts[levels.index(max(levels))]
    reasons = (r for v in (poorest, *verdicts) if v.level != "good" for r in v.reasons)
    return dataclasses.replace(poorest, level=LEVELS[level], reasons=tuple(dict.fromkeys(reasons)))
