"""Rates results by tables of checks: the verdict is the worst row, causes before effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, Generic, NamedTuple, TypeVar

from gsut.run import Verdict

DIAGONAL = 350.0  # of the pictures in whose pixels all limits on geometry are
GOOD_PX = 2.0  # such pixels by which nearly all of a good result is off at most
USABLE_PX = 6.0  # the same of most of a usable one
# Growth of the median residual near what a rig or GPS states, above which images contradict that.
SHAKY = 1.5
NOT_GOOD = GOOD_PX / DIAGONAL  # error over the diagonal, above which a result is not good
UNUSABLE = USABLE_PX / DIAGONAL  # error over the diagonal, above which a result is not usable

_Result = TypeVar("_Result", contravariant=True)


class Fault(NamedTuple):
    """A check that a result has failed.

    Attributes:
        severity: 1: the result is usable at most; 2: it is poor.
        what: the fault, in words.
        advice: what to do against it.
        is_visible: see `Check`.
    """

    severity: int
    what: str
    advice: str
    is_visible: bool = False


@dataclasses.dataclass(frozen=True)
class Check(Generic[_Result]):
    """A row of a table of checks.

    Attributes:
        measure: returns how far a result is from perfect by one measure: 0 if it is perfect.
        usable, poor: values above which the result is usable at most, and above which it is poor.
        says: describes the fault.
        advice: one step against it, fixed or for the result.
        is_visible: whether held-out views show the fault, so that they decide how bad it is.
    """

    name: str
    measure: Callable[[_Result], float]
    usable: float
    poor: float
    says: Callable[[_Result], str]
    advice: str | Callable[[_Result], str]
    is_visible: bool = False

    def find_fault(self, result: _Result) -> Fault | None:
        """Returns what the result has failed by; None if it has passed."""
        value = self.measure(result)
        severity = int(value > self.usable) + int(value > self.poor)
        if severity == 0:
            return None
        advice = self.advice if isinstance(self.advice, str) else self.advice(result)
        return Fault(severity, self.says(result), advice, self.is_visible)


def find_faults(checks: Iterable[Check[Any]], result: Any) -> list[Fault]:
    """Lists what a result fails by, the worst first, and causes before effects, as in the table."""
    found = [fault for check in checks if (fault := check.find_fault(result)) is not None]
    return sorted(found, key=lambda fault: -fault.severity)


def judge(checks: Iterable[Check[Any]], result: Any, what: str, advice: str) -> Verdict:
    """Makes the verdict on a result; the worst fault sets level and advice.

    Args:
        checks: causes before what they lead to.
        what: what was found.
        advice: what to do next if there is no fault.
    """
    faults = find_faults(checks, result)
    level = Verdict.LEVELS[max((f.severity for f in faults), default=0)]
    hidden = Verdict.LEVELS[max((f.severity for f in faults if not f.is_visible), default=0)]
    advice = faults[0].advice if faults else advice
    return Verdict(level, what, tuple(fault.what for fault in faults), advice, hidden)


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
    ranks = [Verdict.LEVELS.index(measured.level)]
    ranks += [Verdict.LEVELS.index(verdict.hidden_level or verdict.level) for verdict in inferred]
    level = Verdict.LEVELS[min(max(ranks), ranks[0] + 1)]
    poorest = verdicts[ranks.index(max(ranks))]
    reasons = (r for v in (poorest, *verdicts) if v.level != "good" for r in v.reasons)
    return dataclasses.replace(poorest, level=level, reasons=tuple(dict.fromkeys(reasons)))
