"""Trains blocks on a Ray cluster: the same tasks; each state returns to this machine when made."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gsut import _core
from gsut._core import InputError
from gsut.blocks.segment import BlockLoop, run_segment
from gsut.blocks.task import BlockTask, list_photographs
from gsut.blocks.workers import Job, Report, summarize_state
from gsut.files import read_bytes, write_file
from gsut.run import read_checkpoint, write_checkpoint

# Times that Ray repeats a segment whose worker or node is lost.
_RETRIES = 20
# Seconds between looks at what has finished.
_WAIT_SECONDS = 1.0
# Seconds for each node to describe itself.
_DESCRIBE_SECONDS = 60.0
# Address that stands for the cluster of this machine.
_AUTO = "auto"

# A worker's folder for photographs; empty until it is needed.
_folder: list[tempfile.TemporaryDirectory] = []
# Task and loop of a worker's last segment, by the hash of the task: the next one is often the same.
_last: dict[str, tuple[BlockTask, list[BlockLoop]]] = {}


class Cluster:
    """Runs blocks on the nodes of a Ray cluster, which this machine is one of.

    Args:
        address: "auto" or HOST:PORT.

    Attributes:
        isa: the widest instruction set that all nodes have, which becomes this process' own.
        threads: processors that a block takes: all of the smallest node.

    Raises:
        InputError: Ray is not installed, there is no such cluster, or its nodes have different
            versions of gsut.
    """

    def __init__(self, address: str) -> None:
        try:
            import ray
        except ImportError:
            raise InputError(
                "--cluster needs Ray: pip install gsut[cluster], on every node"
            ) from None
        self._ray: Any = ray
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        if not ray.is_initialized():
            try:
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
            except (ConnectionError, RuntimeError, ValueError) as error:
                where = "this machine" if address == _AUTO else address
                raise InputError(
                    f"no Ray cluster at {where} ({str(error).splitlines()[0]}); start one with ray "
                    "start --head, and run gsut on a machine of it (ray start --address HOST:PORT)"
                ) from None
        self.isa, self.threads, self.nodes = self._compare_nodes()
        _core.set_isa(self.isa)

    def _compare_nodes(self) -> tuple[str, int, int]:
        """Returns instruction set, threads and number of nodes that can be used together."""
        ray = self._ray
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        nodes = [node for node in ray.nodes() if node["Alive"]]
        ask = ray.remote(describe_node)
        asked = [
            ask.options(
                num_cpus=0,
                max_retries=0,
                scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False),
            ).remote()
            for node in nodes
        ]
        try:
            found = ray.get(asked, timeout=_DESCRIBE_SECONDS)
        except ray.exceptions.RayError as error:
            raise InputError(
                f"a node of the cluster cannot run gsut ({_quote_error(error)}); install the same "
                "version on all of them"
            ) from None
        own = describe_node()
        for node, each in zip(nodes, found, strict=True):
            if each["version"] != own["version"]:
                raise InputError(
                    f"{node['NodeManagerHostname']} has gsut {each['version']}, this machine "
                    f"{own['version']}; install the same version on all nodes"
                )
        processors = [int(node["Resources"].get("CPU", 0)) for node in nodes]
        if not any(processors):
            raise InputError("the cluster's nodes have no processors to give; see ray status")
        common = set.intersection(*(set(each["isas"]) for each in [own, *found]))
        isa = next(name for name in own["isas"] if name in common)  # widest first
        return isa, min(count for count in processors if count), sum(map(bool, processors))

    def run(self, jobs: Sequence[Job], report: Report) -> None:
        """Trains all blocks that are not finished.

        Raises:
            InputError: a worker found an error, or Ray gave up.
        """
        photographs: dict[str, Any] = {}
        coming: dict[Any, tuple[Job, Callable[[Any], Any]]] = {}
        for job in jobs:
            if not job.is_done():
                submit = self._make_submitter(job, photographs)
                first = read_bytes(job.state) if job.state.is_file() else None
                coming[submit(first)] = job, submit
        try:
            while coming:
                for done in self._ray.wait(list(coming), timeout=_WAIT_SECONDS)[0]:
                    job, submit = coming.pop(done)
                    state, summary = self._fetch_result(done, job)
                    write_file(job.state, state)
                    report(job, summary | {"bytes": len(state)})
                    if not job.is_done():
                        coming[submit(state)] = job, submit
        finally:
            for left in coming:
                self._ray.cancel(left, force=True)

    def close(self) -> None:
        """Does nothing: the cluster continues to run, and Ray ends with this process."""

    def _make_submitter(self, job: Job, photographs: dict[str, Any]) -> Callable[[Any], Any]:
        """Returns a function that submits a block's next segment; task and files are sent once.

        A state travels by way of this machine, which keeps it: the node that made it may be lost.
        """
        segment = self._ray.remote(train_segment).options(
            num_cpus=self.threads, max_retries=_RETRIES
        )
        paths = list_photographs(read_checkpoint(job.task, ("views",)))
        files = [self._put(path, photographs) for path in paths]
        task = self._ray.put(read_bytes(job.task))

        def submit(state: bytes | None) -> Any:
            before = None if state is None else self._ray.put(state)
            driver = Driver(self.isa, _core.__version__, self.threads)
            return segment.remote(task, paths, files, before, driver)

        return submit

    def _put(self, path: str, known: dict[str, Any]) -> Any:
        """Puts a file's content into the cluster, once for all blocks."""
        if path not in known:
            known[path] = self._ray.put(read_bytes(path))
        return known[path]

    def _fetch_result(self, done: Any, job: Job) -> tuple[bytes, dict[str, Any]]:
        try:
            return self._ray.get(done)
        except self._ray.exceptions.RayTaskError as error:
            cause = error.cause
            if isinstance(cause, InputError):
                raise InputError(f"block {job.block}: {cause}") from None
            raise
        except self._ray.exceptions.RayError as error:
            raise InputError(
                f"block {job.block}: Ray gave up after {_RETRIES} attempts "
                f"({_quote_error(error)}); see ray status for the nodes' memory and disks. Its "
                "states are here: --resume continues"
            ) from None


def describe_node() -> dict[str, Any]:
    """Returns the version of gsut and the instruction sets, widest first, of this machine."""
    return {"version": _core.__version__, "isas": _core.available_isas()}


class Driver(NamedTuple):
    """What the workers must have of the process that drives them.

    Attributes:
        isa: instruction set of all.
        version: of gsut.
        threads: of a worker.
    """

    isa: str
    version: str
    threads: int


def train_segment(
    task: bytes, paths: list[str], photographs: list[Any], state: bytes | None, driver: Driver
) -> tuple[bytes, dict[str, Any]]:
    """Trains a segment on a worker; returns the next state's file and its summary.

    Args:
        task: content of the task's file.
        paths: of its photographs, on the driver's machine.
        photographs: their content, or where Ray has it.
        state: content of the last state's file; None: the first segment.
        driver: of gsut.

    Raises:
        InputError: version or instruction set do not match, or the disk is full.
    """
    if _core.__version__ != driver.version:
        raise InputError(
            f"{platform.node()} has gsut {_core.__version__}, the driver {driver.version}; "
            "install the same version on all nodes"
        )
    if driver.isa not in _core.available_isas():
        raise InputError(
            f"{platform.node()} has no {driver.isa} instructions, which this run started with"
        )
    _core.set_isa(driver.isa)
    _core.set_num_threads(driver.threads)
    folder = _make_folder()
    name = hashlib.sha256(task).hexdigest()
    if name not in _last:
        _last.clear()
        files = zip(paths, photographs, strict=True)
        places = {path: _store_photograph(path, content, folder) for path, content in files}
        values = _from_bytes(task, folder)
        _last[name] = BlockTask.from_dict(values, lambda path: places.get(path, path)), []
    loaded, kept = _last[name]
    before = None if state is None else _from_bytes(state, folder)
    began = time.perf_counter()
    after = run_segment(loaded, before, kept)
    summary = summarize_state(after) | {"wall_seconds": time.perf_counter() - began}
    file = folder / "state.npz"
    write_checkpoint(file, after)
    return read_bytes(file), summary


def _make_folder() -> Path:
    try:
        if not _folder:
            _folder.append(tempfile.TemporaryDirectory(prefix="gsut-"))
        return Path(_folder[0].name)
    except OSError as error:
        raise _make_disk_error(error) from None


def _store_photograph(path: str, content: Any, folder: Path) -> str:
    """Returns the path of a photograph in this process' folder, storing it first if needed."""
    place = folder / (hashlib.sha256(path.encode()).hexdigest()[:16] + Path(path).suffix)
    if not place.is_file():
        try:
            if not isinstance(content, bytes):
                import ray

                content = ray.get(content)
            write_file(place, content)
        except OSError as error:
            raise _make_disk_error(error) from None
    return str(place)


def _from_bytes(content: bytes, folder: Path) -> dict[str, Any]:
    file = folder / "incoming.npz"
    try:
        write_file(file, content)
        return read_checkpoint(file)
    except OSError as error:
        raise _make_disk_error(error) from None
    finally:
        with contextlib.suppress(OSError):
            file.unlink()


def _make_disk_error(error: OSError) -> InputError:
    return InputError(
        f"{platform.node()} cannot keep photographs in {tempfile.gettempdir()} "
        f"({error.strerror or error}); give that node room there, or another TMPDIR"
    )


def _quote_error(error: BaseException) -> str:
    return (
        f"{type(error).__name__}: {str(error).strip().splitlines()[0]}"
        if str(error)
        else (type(error).__name__)
    )
