"""Trains blocks on this machine: one after another in this process, or by several processes."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from gsut import _core
from gsut._core import InputError
from gsut.blocks.segment import BlockLoop, run_segment
from gsut.blocks.task import BlockTask
from gsut.files import FileError, parse_json
from gsut.run import measure_peak_rss, read_checkpoint, release_memory, write_checkpoint

# Times that a worker may end without a new state before the run ends: it would do so for ever.
_MOST_DEATHS = 3
# Seconds between reports within a segment.
_REPORT_SECONDS = 0.5
# Entries of a state that can be read without its Gaussians, see `run_segment`.
FIGURES = ("segment", "step", "seconds", "pixels", "views", "finished")
Report = Callable[["Job", dict[str, Any]], object]


@dataclasses.dataclass(frozen=True)
class Job:
    """One block of a round: its task and its last state, which its training replaces.

    Attributes:
        block: number.
        task, state: files of `write_checkpoint`.
    """

    block: int
    task: Path
    state: Path

    def read_state(self, names: Collection[str] | None = None) -> dict[str, Any] | None:
        """Reads the last state, or these entries of it; None before the first one."""
        return read_checkpoint(self.state, names) if self.state.is_file() else None

    def is_done(self) -> bool:
        """Returns whether the state is the last one."""
        state = self.read_state(FIGURES)
        return state is not None and state["finished"]


def write_state(path: Path, state: dict[str, Any]) -> int:
    """Replaces the file atomically and returns its bytes."""
    write_checkpoint(path, state)
    return path.stat().st_size


def run_job(job: Job, report: Report) -> None:
    """Trains a block in this process from its last state to the end of the round.

    `report` receives step, loss and count now and then, and after each segment its "segment", the
    seconds and rendered pixels of the round so far, the bytes of its state, and the most memory
    that the process took.
    """
    task, state = BlockTask.from_dict(read_checkpoint(job.task)), job.read_state()
    kept: list[BlockLoop] = []
    last = time.monotonic()

    def on_step(step: int, loss: float, count: int) -> None:
        nonlocal last
        if time.monotonic() - last > _REPORT_SECONDS:
            last = time.monotonic()
            report(job, {"step": step, "loss": float(loss), "count": count})

    while state is None or not state["finished"]:
        state = run_segment(task, state, kept, on_step)
        report(job, summarize_state(state) | {"bytes": write_state(job.state, state)})
    release_memory()


def summarize_state(state: dict[str, Any]) -> dict[str, Any]:
    """Returns the figures of a state's segment, without its arrays."""
    figures = {name: state[name] for name in ("segment", "step", "seconds", "pixels")}
    return figures | {"peak_rss_mb": measure_peak_rss(), "process": os.getpid()}


class Workers:
    """Runs blocks in processes of this machine; if there is only one, in this process.

    Args:
        count: number of processes.
        threads: of all together; 0: all processors.
    """

    def __init__(self, count: int, threads: int) -> None:
        self._count = count
        self._threads = max(1, (threads or _core.num_threads()) // count)
        self._workers: list[_Worker] = []

    def run(self, jobs: Sequence[Job], report: Report) -> None:
        """Trains all blocks that are not finished.

        Raises:
            InputError: a worker found an error, or ended repeatedly.
        """
        jobs = [job for job in jobs if not job.is_done()]
        if self._count == 1:
            for job in jobs:
                run_job(job, report)
            return
        waiting: queue.SimpleQueue[Job] = queue.SimpleQueue()
        for job in jobs:
            waiting.put(job)
        errors: list[BaseException] = []
        lock = threading.Lock()

        def forward_report(job: Job, message: dict[str, Any]) -> None:
            with lock:
                report(job, message)

        def serve(worker: _Worker) -> None:
            try:
                while not errors:
                    try:
                        job = waiting.get_nowait()
                    except queue.Empty:
                        return
                    worker.run(job, forward_report)
            except BaseException as error:
                errors.append(error)
            finally:
                worker.finish()

        self._workers = [_Worker(self._threads) for _ in range(min(self._count, len(jobs)))]
        servers = [threading.Thread(target=serve, args=(each,)) for each in self._workers]
        try:
            for server in servers:
                server.start()
            for server in servers:
                while server.is_alive() and not errors:
                    server.join(0.2)
        finally:
            self.close()
            for server in servers:
                server.join()
        if errors:
            raise errors[0]

    def close(self) -> None:
        """Ends the processes; their last states stay."""
        for worker in self._workers:
            worker.close()
        self._workers = []


class _Worker:
    """Runs one process, started when needed and again when it dies."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._closed = False
        self.process: subprocess.Popen[str] | None = None

    def run(self, job: Job, report: Report) -> None:
        deaths = 0
        while not self._closed:
            before = job.read_state(FIGURES)
            if self._serve(job, report):
                return
            code = self.finish()
            after = job.read_state(FIGURES)
            advanced = after is not None and (
                before is None or after["segment"] > before["segment"]
            )
            deaths = 0 if advanced else deaths + 1
            if deaths >= _MOST_DEATHS and not self._closed:
                raise InputError(
                    f"the worker that trains block {job.block} ended {deaths} times (exit status "
                    f"{code}) without coming further: most likely memory ran out; give --memory, "
                    "fewer --workers or more --blocks, and --resume to go on"
                )

    def close(self) -> None:
        """Ends the process from another thread, so that `run` returns."""
        self._closed = True
        process = self.process
        if process is not None:
            process.kill()

    def finish(self) -> int | None:
        """Ends the process and returns its exit status."""
        process, self.process = self.process, None
        if process is None:
            return None
        process.kill()
        with contextlib.suppress(BrokenPipeError), process:
            process.wait()
        return process.returncode

    def _serve(self, job: Job, report: Report) -> bool:
        """Returns whether the worker has finished the job; False if it died."""
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "gsut.blocks.worker", str(self._threads)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8",
                env=os.environ | {"GSUT_ISA": _core.active_isa()},
            )  # fmt: skip
        process = self.process
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(
                json.dumps([job.block, os.fspath(job.task), os.fspath(job.state)]) + "\n"
            )
            process.stdin.flush()
            for line in process.stdout:
                message = parse_json(line, "a worker's message", dict)
                if "error" in message:
                    raise InputError(message["error"])
                if "done" in message:
                    return True
                report(job, message)
        except (OSError, FileError):
            pass  # it died while it was written to or was writing
        return False


def serve_forever(threads: int) -> None:
    """Serves jobs in a worker: one a line on standard input, messages on standard output."""
    _core.set_num_threads(threads)
    out = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # nothing else may write among the messages
    jobs: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            jobs.put(line)
        os._exit(0)  # the driver is gone

    threading.Thread(target=read, daemon=True).start()

    def send(message: dict[str, Any]) -> None:
        with contextlib.suppress(BrokenPipeError):
            out.write(json.dumps(message) + "\n")

    while (line := jobs.get()) is not None:
        block, task, state = parse_json(line, "a job", list)
        try:
            run_job(Job(block, Path(task), Path(state)), lambda _, message: send(message))
            send({"done": True})
        except MemoryError:
            send({"error": f"block {block}: memory ran out; give more --blocks or --memory"})
        except Exception as error:
            text = str(error) if isinstance(error, InputError) else repr(error)
            send({"error": f"block {block}: {text}"})
