"""Judges the pictures that a capture chose; whether they are enough is seen in held-out views."""

from __future__ import annotations

from typing import Any

from gsut.run.verdicts.verdict import Verdict

# Share of blurred pictures above which the sharp ones no longer make up for them.
_MANY_BLURRED = 0.25


def judge_pictures(figures: dict[str, Any]) -> Verdict:
    """Judges the pictures that a capture chose, by their sharpness.

    Args:
        figures: of a capture: "frames", a row for each picture, and "size".
    """
    rows = figures["frames"]
    blurred = sum(bool(row.get("blurred")) for row in rows)
    what = f"{len(rows)} pictures of {figures['size'][0]} x {figures['size'][1]}"
    if blurred > _MANY_BLURRED * len(rows):
        return Verdict(
            "usable", what, (f"{blurred} of them blurred",),
            "film more slowly, or with more light",
        )  # fmt: skip
    return Verdict("good", what)
