"""What a run of `gsut poses` has done so far, on disk: a killed run goes on from there."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.sfm.features import Features
from gsut.sfm.matching import RawMatches

FOLDER = "stages"
_KEY = "key.json"
_MATCHES = "matches.npz"
_TEMPORARY = ".writing-"


def write_atomically(path: Path, data: bytes) -> None:
    """Writes a file as a whole or not at all.

    Raises:
        InputError: it cannot be written; what was there before is unchanged.
    """
    temporary = path.with_name(f"{_TEMPORARY}{os.getpid()}-{path.name}")
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(
            f"cannot write {path}: {error.strerror}; is the folder writable and the disk not full?"
        ) from error


class Stages:
    """The stage files of one output folder.

    Args:
        out: the output folder; made if absent.
        key: all that the stages depend on, as JSON values. Stages of another key are deleted.
    """

    def __init__(self, out: Path, key: dict[str, Any]) -> None:
        self._folder = out / FOLDER
        text = json.dumps(key, sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()
        stored = self._folder / _KEY
        if not (stored.is_file() and stored.read_text() == digest):
            shutil.rmtree(self._folder, ignore_errors=True)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make {self._folder}: {error.strerror}") from error
        write_atomically(stored, digest.encode())

    def remove(self) -> None:
        """Deletes the stage files: the run is done."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _save(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        import io

        buffer = io.BytesIO()
        np.savez(buffer, **arrays)  # type: ignore[arg-type]  # numpy's stub wants bool for a name
        write_atomically(self._folder / name, buffer.getvalue())

    def _load(self, name: str) -> dict[str, np.ndarray] | None:
        try:
            with np.load(self._folder / name) as file:
                return {key: file[key] for key in file.files}
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None  # absent or damaged: made again

    def save_features(self, index: int, features: Features) -> None:
        """Keeps the features of an image."""
        self._save(
            f"features-{index:06d}.npz",
            {
                "pixels": features.pixels, "sizes": features.sizes,
                "descriptors": features.descriptors, "colors": features.colors,
            },
        )  # fmt: skip

    def load_features(self, index: int) -> Features | None:
        """The features of an image, or None."""
        arrays = self._load(f"features-{index:06d}.npz")
        if arrays is None or set(arrays) != {"pixels", "sizes", "descriptors", "colors"}:
            return None
        return Features(**arrays)

    def save_matches(self, raw: RawMatches) -> None:
        """Keeps the matches of all pairs."""
        self._save(
            _MATCHES,
            {
                "pairs": np.asarray(raw.pairs, np.int64).reshape(-1, 2),
                "lengths": np.array([len(m) for m in raw.matches], np.int64),
                "matches": np.concatenate([np.zeros((0, 2), np.int32), *raw.matches]),
            },
        )

    def load_matches(self) -> RawMatches | None:
        """The matches of all pairs, or None."""
        arrays = self._load(_MATCHES)
        if arrays is None:
            return None
        ends = np.cumsum(arrays["lengths"])
        starts = ends - arrays["lengths"]
        return RawMatches(
            arrays["pairs"],
            [arrays["matches"][a:b] for a, b in zip(starts, ends, strict=True)],
        )
