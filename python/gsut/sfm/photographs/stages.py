"""Keeps on disk what a run has finished, so that an interrupted run resumes from there."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import FileError, read_npz, read_text, write_file, write_npz

FOLDER = "stages"
_KEY = "key.txt"


def digest_key(key: dict[str, Any]) -> str:
    """Returns the hash of all that a result depends on, given as JSON values."""
    return hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()


class Stages:
    """The stage files of one output folder.

    Args:
        out: the output folder; made if absent.
        key: all that the stages depend on, as JSON values. Stages of another key are deleted.

    Attributes:
        folder: of the files.
        digest: hash of the key.
    """

    def __init__(self, out: Path, key: dict[str, Any]) -> None:
        self.folder = out / FOLDER
        self.digest = digest_key(key)
        stored = self.folder / _KEY
        if not self._is_current(stored):
            shutil.rmtree(self.folder, ignore_errors=True)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make {self.folder}: {error.strerror}") from error
        write_file(stored, self.digest)

    def _is_current(self, stored: Path) -> bool:
        try:
            return read_text(stored) == self.digest
        except FileError:  # none, or one that a power cut left empty or torn
            return False

    def remove(self) -> None:
        """Deletes the stage files once the run is complete."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def save(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        """Writes named arrays as one stage file."""
        write_npz(self.folder / f"{name}.npz", arrays)

    def load(self, name: str) -> dict[str, np.ndarray] | None:
        """Reads the arrays of a stage; None if the file is absent or damaged."""
        try:
            return read_npz(self.folder / f"{name}.npz")
        except FileError:
            return None
