"""The folder of one training run: which files it holds, written so that no crash can spoil them."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.files import (
    check_regular,
    check_shape,
    format_json,
    read_json,
    read_text,
    reading,
    register_reader,
    whole_file,
    whole_folder,
    write_file,
    write_json,
)
from gsut.output_folder import MARKER, OutputFolder, claim_folder
from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.run.history import History
from gsut.run.options import TrainOptions
from gsut.run.resume import check_same_options, check_same_start
from gsut.run.shapes import ENVIRONMENT_SHAPE, METRICS_SHAPE, SCENE_SHAPE


class RunFile:
    """Names of the files and folders of a run, relative to it."""

    OPTIONS = "options.json"  # the TrainOptions
    ENVIRONMENT = "environment.json"  # dataset, command line, versions and machine
    HISTORY = "history.jsonl"  # one JSON object a line: see TrainingRecord
    CHECKPOINT = "checkpoint.npz"  # the whole state of training
    SCENE = "scene.ply"  # the trained Gaussians
    METRICS = "metrics.json"  # the figures on the held-out images
    REPORT = "report.html"  # all of it to look at
    STATE = "scene.json"  # inputs and settings of gsut scene, if that made the run, and its figures
    REFINED = "refined.json"  # poses and lenses, where they were refined (see gsut.refined_poses)
    TRANSFORMS = "transforms.json"  # the same as a dataset, where the format has the lens
    PAGE = "scene.html"  # the scene for any browser, if gsut convert wrote it
    BLOCKS = "blocks"  # states of a training in blocks, its plan and layout
    PLAN = f"{BLOCKS}/plan.json"  # how it is divided, with its TrainOptions as they were given
    RENDERS = "renders"  # pictures of the held-out views
    FINDINGS = "findings.json"  # what the doctor says of the data, see gsut.Finding
    CONFIDENCE = "confidence.npz"  # how sure renders are, if gsut render --confidence measured it


_FILES = (
    *(RunFile.OPTIONS, RunFile.ENVIRONMENT, RunFile.HISTORY, RunFile.CHECKPOINT, RunFile.SCENE),
    *(RunFile.METRICS, RunFile.REPORT, RunFile.REFINED, RunFile.TRANSFORMS),
    *(RunFile.BLOCKS, RunFile.RENDERS, RunFile.CONFIDENCE),
)
_DAMAGED = f"it is damaged; {RunFile.SCENE}, if it is there, can be used by itself"
_OTHER_CHECKPOINT = "it is not of this training; remove this file and begin a new run"
_RESULTS = (RunFile.SCENE, RunFile.METRICS, RunFile.REPORT)
_OF_FINDING = ("severity", "where", "what", "advice", "subject")
_OF_PLAN = ("blocks", "version", "isa", "options")
_SHAPES = {
    RunFile.ENVIRONMENT: ENVIRONMENT_SHAPE,
    RunFile.METRICS: METRICS_SHAPE,
    RunFile.FINDINGS: {"findings": [dict.fromkeys(_OF_FINDING, str)]},
    RunFile.STATE: SCENE_SHAPE,
}


class RunFolder:
    """Paths, atomic writing and reading of one run.

    Every file appears complete or not at all: it is written under a temporary name in the same
    folder, flushed to the disk and renamed. Make one with `create` (to train) or `open` (to read).

    Attributes:
        path: the folder.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._claim: OutputFolder | None = None  # of a folder that is written: see create
        self._stays = False  # a finished run, of which nothing is written again

    @classmethod
    def create(
        cls,
        path: str | os.PathLike[str],
        options: TrainOptions,
        *,
        resume: bool = False,
        environment: dict[str, Any] | None = None,
        command: str = "train",
        blocks: dict[str, Any] | None = None,
    ) -> RunFolder:
        """Makes the folder of a new run, or takes up the one of an interrupted run. One that is
        finished stays as it is, whatever is written to it.

        Args:
            path: the folder; it and its parents are made where absent.
            options: written as options.json.
            resume: go on with the run that the folder holds. Without one a new run begins.
            environment: written as environment.json; a run that is resumed keeps its own, which
                holds the command line that reproduces it. Its "digests" (see `digest_scene`) must
                be those of the data that the run started with.
            command: which makes the run.
            blocks: of a training in blocks: name -> content of the JSON files in its folder, which
                a new run gets at once and before all others; PLAN's gets the options as given.

        Raises:
            InputError: the folder holds a run and resume is not said; the run to resume has other
                options (all but `threads` and `checkpoint_every` must agree) or other data; the
                folder cannot be made, written or claimed (see `gsut.output_folder.claim_folder`).
        """
        run = cls.claim(path, command, (environment or {}).get("dataset"))
        if run.has_run():
            if resume:
                _check_same_way(run, blocks is not None)
                before = run.read_json(RunFile.ENVIRONMENT) or {}
                check_same_options(run.path, run.read_given_options(), options)
                run._stays = run.is_finished()
                check_same_start(run.path, before, environment or {}, run._stays)
            else:
                run.refuse_run(resumes=True)
        elif blocks is not None:
            plan = Path(RunFile.PLAN).name
            given = {"options": dataclasses.asdict(options)}
            with whole_folder(run.path / RunFile.BLOCKS) as folder:
                for name, content in blocks.items():
                    write_json(folder / name, content | (given if name == plan else {}))
        run.write_text(RunFile.OPTIONS, options.to_json() + "\n")
        if environment is not None and not (resume and (run.path / RunFile.ENVIRONMENT).is_file()):
            run.write_json(RunFile.ENVIRONMENT, environment)
        return run

    @classmethod
    def claim(
        cls,
        path: str | os.PathLike[str],
        command: str,
        source: str | os.PathLike[str] | None = None,
    ) -> RunFolder:
        """Takes a folder that this process writes while the object lives: see `claim_folder`."""
        run = cls(path)
        run._claim = claim_folder(path, command, source)
        return run

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> RunFolder:
        """Opens the folder of an existing run.

        Raises:
            InputError: there is no such folder, or it holds no run.
        """
        run = cls(path)
        if not run.path.is_dir():
            if os.path.lexists(run.path):
                check_regular(run.path)  # a pipe, a link to nowhere: said so
            raise InputError(f"{run.path}: no such folder; give the folder of a run")
        if not (run.path / RunFile.OPTIONS).is_file():
            raise InputError(
                f"{run.path} holds no run (no {RunFile.OPTIONS}); give a folder that gsut train "
                "has written"
            )
        return run

    def has_run(self) -> bool:
        """Returns whether the folder has any file of a run."""
        return any((self.path / name).exists() for name in _FILES)

    def is_finished(self) -> bool:
        """Returns whether a training has done all its steps and written all its files."""
        if not all((self.path / name).is_file() for name in _RESULTS):
            return False
        with reading(self.path / RunFile.METRICS, _DAMAGED):
            steps = self.read_json(RunFile.METRICS)["steps"]
        return read_plan(self) is not None or steps == self.read_options().steps

    def refuse_run(self, *, resumes: bool = False) -> None:
        """Raises InputError, which names --resume if the command `resumes`, on a run or a file."""
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"{self.path} is a file; give a folder for the run")
        if self.has_run():
            way = f"{'add --resume to resume it, or ' if resumes else ''}give another folder"
            raise InputError(f"{self.path} already holds a run; {way} (nothing was overwritten)")

    def refuse_finished(self, source: str | os.PathLike[str]) -> None:
        """Removes what a killed process left of a run made of `source`; else as `refuse_run`."""
        made_of = (self.read_json(MARKER) or {}).get("input")
        if made_of != os.path.realpath(source) or (self.path / RunFile.REPORT).is_file():
            self.refuse_run()
        for name in _FILES:
            shutil.rmtree(self.path / name, ignore_errors=True)  # of a file: nothing
            (self.path / name).unlink(missing_ok=True)

    @property
    def renders(self) -> Path:
        """The folder of the pictures, made on first use."""
        folder = self.path / RunFile.RENDERS
        folder.mkdir(exist_ok=True)
        return folder

    @property
    def history(self) -> History:
        """The rows of history.jsonl."""
        return History(self.path / RunFile.HISTORY, self._stays)

    # Files that appear whole or not at all.

    def write(self, name: str, writer: Callable[[Path], None]) -> Path:
        """Writes RUN/name atomically: `writer` gets the path that it has to write to.

        Raises:
            InputError: the folder cannot be written (permissions, disk full); what was there
                before is unchanged.
        """
        if not self._stays:
            with whole_file(self.path / name) as temporary:
                writer(temporary)
        return self.path / name

    def write_text(self, name: str, text: str) -> Path:
        """Writes RUN/name atomically as UTF-8."""
        if not self._stays:
            write_file(self.path / name, text)
        return self.path / name

    def write_json(self, name: str, value: Any) -> Path:
        """Writes RUN/name atomically as JSON; NaN and infinities, which JSON lacks, become null."""
        return self.write_text(name, format_json(value) + "\n")

    def read_json(self, name: str) -> Any:
        """Reads a JSON file of the run; None if the file is absent.

        Raises:
            InputError: the file is not JSON, or lacks what commands read of it.
        """
        path = self.path / name
        return read_run_json(path) if path.is_file() else None

    def read_options(self) -> TrainOptions:
        """Reads the options of the run.

        Raises:
            InputError: the file is absent or damaged.
        """
        path = self.path / RunFile.OPTIONS
        if not os.path.lexists(path):
            raise InputError(
                f"{path} is absent, so nobody knows how the run was made; {RunFile.SCENE}, if it "
                "is there, can be used by itself, and a new run needs another folder"
            )
        return _read_options(path)

    def read_given_options(self) -> TrainOptions:
        """Reads the options as given to a training in blocks; otherwise as `read_options`."""
        plan = read_plan(self)
        if plan is None:
            return self.read_options()
        source = self.path / RunFile.PLAN
        with reading(source, _DAMAGED):
            return TrainOptions.from_json(json.dumps(plan["options"]), source=str(source))

    # Checkpoints.

    def save_checkpoint(self, step: int, state: dict[str, Any]) -> Path:
        """Writes the state of training after `step` steps; replaces the one before atomically.

        Args:
            step: number of steps done.
            state: numpy arrays and JSON-able values, in nested dicts and lists; read back exactly.
        """
        path = self.path / RunFile.CHECKPOINT
        if not self._stays:
            write_checkpoint(path, {"step": step, "state": state})
        return path

    def load_checkpoint(self) -> tuple[int, dict[str, Any]] | None:
        """Reads the step and state of the last `save_checkpoint`; None without a checkpoint.

        Also rolls history.jsonl back to that step, so that the resumed run's rows follow on.

        Raises:
            InputError: the file is damaged.
        """
        path = self.path / RunFile.CHECKPOINT
        if not path.is_file():
            self.history.roll_back(0)
            return None
        content = read_checkpoint(path)
        with reading(path, _OTHER_CHECKPOINT):
            check_shape(content, {"step": int, "state": dict})
        self.history.roll_back(content["step"])
        return content["step"], content["state"]


@register_reader("JSON of a run", ".json", advice=_DAMAGED)
def read_run_json(path: Path) -> Any:
    """Reads a JSON file of a run, see `RunFolder.read_json`."""
    return read_json(path, _SHAPES.get(path.name, dict), advice=_DAMAGED)


@register_reader("options of a run", ".json", advice=_DAMAGED)
def _read_options(path: Path) -> TrainOptions:
    return TrainOptions.from_json(read_text(path), source=str(path))


def read_plan(run: RunFolder) -> dict[str, Any] | None:
    """Reads how a training in blocks is divided.

    The plan holds "blocks" (number or layout), the "version" and "isa" at its start, its
    "options" as they were given, and, once it is known, "count".

    Returns:
        None where the run is one as a whole.

    Raises:
        InputError: the file is absent or damaged.
    """
    if not (run.path / RunFile.BLOCKS).is_dir():
        return None
    path = run.path / RunFile.PLAN
    with reading(path, _DAMAGED):
        plan = run.read_json(RunFile.PLAN)
        if plan is None:
            raise InputError(f"{path} is absent or is not a file, so the run cannot go on")
        if "count" in plan:
            plan["count"] = int(plan["count"])
        return {name: plan[name] for name in _OF_PLAN} | plan


def _check_same_way(run: RunFolder, in_blocks: bool) -> None:
    if (read_plan(run) is not None) != in_blocks:
        ways = ("as a whole", "in blocks")
        raise InputError(
            f"{run.path} was started {ways[not in_blocks]}, not {ways[in_blocks]}; a resumed "
            "run cannot change that"
        )
