"""What a run of `gsut poses` has done so far, on disk: a killed run goes on from there."""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.files import whole_file, write_file
from gsut.sfm.core.features import Features
from gsut.sfm.core.matching import RawMatches

FOLDER = "stages"
_KEY = "key.txt"
_MATCHES = "matches.npz"


def digest(key: dict[str, Any]) -> str:
    """Of all that a result depends on, as JSON values."""
    return hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()


class Stages:
    """The stage files of one output folder.

    Args:
        out: the output folder; made if absent.
        key: all that the stages depend on, as JSON values. Stages of another key are deleted.
    """

    def __init__(self, out: Path, key: dict[str, Any]) -> None:
        self._folder = out / FOLDER
        of_key = digest(key)
        stored = self._folder / _KEY
        if not (stored.is_file() and stored.read_text(encoding="utf-8") == of_key):
            shutil.rmtree(self._folder, ignore_errors=True)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make {self._folder}: {error.strerror}") from error
        write_file(stored, of_key)

    def remove(self) -> None:
        """Deletes the stage files: the run is done."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _save(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        with whole_file(self._folder / name) as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # numpy's stub wants bool for a name

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
