"""What readers and doctor say about a dataset: one sentence of place, finding and advice."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from gsut._core import InputError

SEVERITIES = ("error", "warning", "info")
NAMES_SHOWN = 5  # names listed before "and n more"


class DatasetError(InputError):
    """A dataset cannot be used as it is.

    Attributes:
        where: file, with line, byte offset or frame where known.
        what: what was found, and what was expected.
        advice: what to do about it.
    """

    def __init__(self, where: object, what: str, advice: str) -> None:
        super().__init__(f"{where}: {what}; {advice}")
        self.where, self.what, self.advice = str(where), what, advice


# Readers hand each error of a single frame to such a function: `stop` raises it, the doctor
# collects it and the reader goes on without that frame.
OnError = Callable[[InputError], None]


def stop(error: InputError) -> None:
    """Raises the first error: what `load_dataset` does."""
    raise error


@dataclasses.dataclass(frozen=True)
class Finding:
    """One finding of `doctor`, which `gsut doctor` prints as a sentence.

    Args:
        severity: "error" (training cannot start), "warning" (the result will suffer) or "info".
        where: file, frame or group of frames.
        what: what was found.
        advice: what to do; may be empty for "info".
    """

    severity: str
    where: str
    what: str
    advice: str = ""

    def __str__(self) -> str:
        tail = f"; {self.advice}" if self.advice else ""
        return f"{self.severity}: {self.where}: {self.what}{tail}"


def sorted_findings(findings: Sequence[Finding]) -> list[Finding]:
    """Each finding once, errors first."""
    unique = dict.fromkeys(findings)
    return sorted(unique, key=lambda finding: SEVERITIES.index(finding.severity))


def some_names(names: Sequence[str]) -> str:
    """The first few of a list of names, and how many more there are."""
    shown = ", ".join(names[:NAMES_SHOWN])
    more = len(names) - NAMES_SHOWN
    return f"{shown} and {more} more" if more > 0 else shown
