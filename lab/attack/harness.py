"""Runs a case of the attack: a command line over spoiled inputs, and judges what it did."""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import io
import json
import re
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

from folder_snapshot import take_snapshot
from gsut.cli import main
from gsut.files import UNFINISHED
from gsut.terminal import escape_controls
from lab.attack.world import copy_needs, enter_folder

Spoil = Callable[[Path], object]
SLOWEST = 20.0  # processor seconds of one case
PATIENCE = 300.0  # seconds by the clock: something waits that should not


class Hang(BaseException):
    """A case takes too long."""


@dataclasses.dataclass(frozen=True)
class Case:
    """One row of the table.

    Attributes:
        kind: its class, in the counts.
        name: of the row.
        words: the command line; relative names are of the scratch folder.
        needs: names in the world, copied to the scratch folder.
        spoil: changes the copies.
        said: what the sentence must name: a pattern each.
        may_pass: the command may also succeed: what was given can be read in a good sense.
        noted: what must be said, by `doctor` of a dataset, where the command goes on: a pattern.
        keeps: names that the command may leave though it fails: stages for the next time; and may
            change where it ends well.
        judge: returns what is wrong with what a command that ends well printed, or None.
    """

    kind: str
    name: str
    words: tuple[str, ...]
    needs: tuple[str, ...] = ()
    spoil: Spoil | None = None
    said: tuple[str, ...] = ()
    may_pass: bool = False
    noted: str = ""
    keeps: tuple[str, ...] = ()
    judge: Callable[[Outcome], str | None] | None = None

    @property
    def title(self) -> str:
        return f"{self.kind}: {self.name}: gsut {' '.join(self.words)}"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a command did.

    Attributes:
        status: its exit status; None where it raised.
        errors: standard error.
        seconds: of the processor.
        output: standard output.
    """

    status: int | None
    errors: str
    seconds: float
    output: str = ""


def run_words(words: tuple[str, ...], apart: bool = False) -> Outcome:
    """Runs a command in this process, or in one of its own."""
    if apart:
        started = time.monotonic()
        command = [sys.executable, "-m", "gsut", *words]
        try:
            done = subprocess.run(command, capture_output=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            return Outcome(None, "it hangs", PATIENCE)
        errors = done.stderr.decode(errors="backslashreplace").rpartition("\r")[2]
        return Outcome(done.returncode, errors, time.monotonic() - started)
    out, errors = io.StringIO(), io.StringIO()
    before = warnings.showwarning
    started = time.process_time()
    status: int | None = None
    with (
        _limit_time() as stopped,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        try:
            status = main(list(words))
        except SystemExit as end:  # argparse's --help
            status = end.code if isinstance(end.code, int) else 1
        except BaseException:
            errors.write(traceback.format_exc())
        finally:
            warnings.showwarning = before
    if stopped:  # also where what was stopped has swallowed that
        return Outcome(None, f"it hangs: {errors.getvalue()}", time.process_time() - started)
    return Outcome(status, errors.getvalue(), time.process_time() - started, out.getvalue())


@contextlib.contextmanager
def _limit_time() -> Iterator[list[int]]:
    """Stops what takes too long; the list that it yields then gets the signal."""
    stopped: list[int] = []

    def stop(number: int, _: object) -> None:
        stopped.append(number)
        raise Hang(f"signal {number}")

    old = [signal.signal(number, stop) for number in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, SLOWEST)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield stopped
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGPROF, old[0])
        signal.signal(signal.SIGALRM, old[1])


def attack(case: Case, world: Path, scratch: Path) -> str | None:
    """Runs a case in a new folder; returns what is wrong with what happened, or None."""
    return run_case(case, world, scratch)[1]


def run_case(case: Case, world: Path, scratch: Path) -> tuple[Outcome, str | None]:
    """Runs a case like `attack`; returns the done as well."""
    scratch.mkdir()
    copy_needs(case.needs, world, scratch)
    try:
        with enter_folder(scratch):
            if case.spoil is not None:
                case.spoil(scratch)
            before = take_snapshot(scratch)
            # calib/ is a process of its own, whose words do not go through Python's streams
            done = run_words(case.words, case.words[0] == "calibrate" and case.kind != "flag")
            gc.collect()  # folders that a failed command held are let go
            return done, find_fault(case, done, before, take_snapshot(scratch))
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def find_disagreement(doctor: Case, train: Case, world: Path, scratch: Path) -> str | None:
    """Runs both cases: `doctor` must find what `train` refuses, in the same words, and reverse."""
    done, wrong = run_case(train, world, scratch)
    found, _ = run_case(doctor, world, scratch)
    if wrong is not None:
        return wrong
    if found.status is None or found.status != done.status:
        return f"train {done.status}, doctor {found.status}: {done.errors} {found.output[-900:]}"
    if done.status == 0:
        noted = re.search(doctor.noted, found.output)
        return None if noted else f"goes on without a word of {doctor.noted}: {found.output[-600:]}"
    sentence = done.errors.splitlines()[-1]
    if not found.output:  # there is no dataset to look at
        return None if found.errors.splitlines()[-1] == sentence else f"others: {found.errors}"
    errors = [each for each in json.loads(found.output) if each["severity"] == "error"]
    same = [escape_controls(" ".join(e["what"].split())) in sentence for e in errors]
    return None if any(same) else f"other words: {sentence} {errors}"


def find_fault(
    case: Case, done: Outcome, before: dict[str, str], after: dict[str, str]
) -> str | None:
    if done.status is None or "Traceback" in done.errors:
        return f"traceback: {done.errors[-1500:]}"
    kept = re.compile("|".join(case.keeps) or "$^")
    changed = sorted(name for name in before if after.get(name) != before[name])
    if done.status == 0:
        changed = [name for name in changed if not kept.match(name)]
    if changed:
        return f"changed {changed} and ended with {done.status}: {done.errors[-300:]}"
    half = [name for name in after if UNFINISHED in name]
    if half:
        return f"left {half}"
    if done.status == 0:
        if case.noted and not re.search(case.noted, done.errors + done.output):
            return f"goes on without a word of {case.noted}: {done.errors[-300:]}"
        if not case.may_pass:
            return f"accepted: {done.errors[-300:]}"
        return case.judge(done) if case.judge is not None else None
    if done.status != 2:
        return f"status {done.status}: {done.errors[-300:]}"
    new = [name for name in after if name not in before and not kept.match(name)]
    if new:
        return f"failed and left {new}: {done.errors[-300:]}"
    if case.words[0] == "doctor" and done.output:  # which finds what is wrong: no error of its own
        missing = [each for each in case.said if not re.search(each, done.output)]
        return f"does not find {missing}: {done.output[-600:]}" if missing else None
    lines = [line for line in done.errors.splitlines() if line.startswith("gsut: error: ")]
    if len(lines) != 1 or not done.errors.endswith(lines[0] + "\n"):
        return f"not one sentence at the end: {done.errors[-600:]}"
    missing = [each for each in case.said if not re.search(each, lines[0])]
    return f"does not say {missing}: {lines[0]}" if missing else None
