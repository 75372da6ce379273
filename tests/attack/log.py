"""Rows that were carried out, in a file: a broken-off attack goes on where it stood."""

from __future__ import annotations

import hashlib
import json
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("python", "cpp", "calib", "tests/attack")


class Log:
    """Rows of one state of the tree; those of others in the same file count no more.

    Args:
        path: of the file, JSON lines; None: nothing is kept.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._tree = path, tree()
        self.before: dict[str, str | None] = {}  # title -> fault, on whatever tree, the last one
        self.done: dict[str, tuple[str, str | None]] = {}  # title -> kind and fault, on this one
        lines = path.read_text().splitlines() if path is not None and path.exists() else ()
        for line in lines:
            row = json.loads(line)
            self.before[row["title"]] = row["fault"]
            if row["tree"] == self._tree:
                self.done[row["title"]] = row["kind"], row["fault"]

    def add(self, title: str, kind: str, fault: str | None, seconds: float) -> None:
        self.done[title] = kind, fault
        if self._path is not None:
            row = {"title": title, "kind": kind, "fault": fault, "seconds": round(seconds, 2)}
            with open(self._path, "a") as file:
                file.write(json.dumps(row | {"tree": self._tree}) + "\n")


def tree() -> str:
    """A digest of product and attack as they lie here."""
    digest = hashlib.sha1()
    for words in (("ls-files", "-s"), ("diff", "HEAD")):
        command = ["git", *words, "--", *PARTS]
        digest.update(subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout)
    return digest.hexdigest()[:12]
