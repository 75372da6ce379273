"""What the doctor reports: findings, their order, their text, and the error they become."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

from gsut._core import InputError
from gsut.data import DatasetError

SEVERITIES = ("error", "warning", "info")


@dataclasses.dataclass(frozen=True)
class Finding:
    """One finding of the doctor, printed as a sentence.

    Args:
        severity: "error" (training cannot start), "warning" (the result will suffer) or "info".
        where: file, frame or group of frames.
        what: what was found.
        advice: what to do; may be empty for "info".
        subject: "poses" or "lens" where these are wrong, else "".
    """

    severity: str
    where: str
    what: str
    advice: str = ""
    subject: str = ""

    def __str__(self) -> str:
        tail = f"; {self.advice}" if self.advice else ""
        return " ".join(f"{self.severity}: {self.where}: {self.what}{tail}".splitlines())


def make_reporters(where: str) -> tuple[Callable[..., Finding], Callable[..., Finding]]:
    """Makes two functions that turn words and advice into an "info" and a "warning" of a place."""
    return functools.partial(Finding, "info", where), functools.partial(Finding, "warning", where)


def finding_from_error(error: InputError) -> Finding:
    """Converts an error; errors of lens files have no separate advice."""
    if isinstance(error, DatasetError):
        return Finding("error", error.where, error.what, error.advice)
    where, _, what = str(error).partition(": ")
    return Finding("error", where, what) if what else Finding("error", "dataset", where)


def sort_findings(findings: Sequence[Finding]) -> list[Finding]:
    """Sorts findings by severity, errors first, and drops repeated ones."""
    unique = dict.fromkeys(findings)
    return sorted(unique, key=lambda finding: SEVERITIES.index(finding.severity))


def format_findings(findings: Sequence[Finding]) -> str:
    """Formats findings as text: a line each, then a line with their counts and the verdict."""
    count = {s: sum(f.severity == s for f in findings) for s in SEVERITIES}
    verdict = "training cannot start" if count["error"] else "training can start"
    lines = [str(finding) for finding in findings]
    lines.append(f"{count['error']} errors, {count['warning']} warnings: {verdict}")
    return "\n".join(lines)


def stop_at_errors(findings: Sequence[Finding], force: bool) -> None:
    """Raises an InputError that states the first error among the findings, unless `force`."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors and not force:
        more = f" (and {len(errors) - 1} more: gsut doctor)" if len(errors) > 1 else ""
        first = errors[0]
        raise InputError(
            f"{first.where}: {first.what}; {first.advice}{more}; --force goes on as it is"
        )
