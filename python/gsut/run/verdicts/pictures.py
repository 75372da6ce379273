"""Judges the pictures that a capture chose."""

from __future__ import annotations

from typing import Any

from gsut.run.verdicts.verdict import Verdict

# Below this number of pictures a scene has views from too few sides.
_FEW_PICTURES = 20
# Share of blurred pictures above which the sharp ones no longer make up for them.
_MANY_BLURRED = 0.25


def judge_pictures(figures: dict[str, Any]) -> Verdict:
    """Judges the pictures that a capture chose, by their number and sharpness.

    Args:
        figures: of a capture: "frames", a row for each picture, and "size".
    """
    rows = figures["frames"]
    blurred = sum(bool(row.get("blurred")) for row in rows)
    what = f"{len(rows)} pictures of {figures['size'][0]} x {figures['size'][1]}"
    if len(rows) < _FEW_PICTURES:
        return Verdict(
            "usable", what, (f"only {len(rows)} pictures",),
            "take 60 or more, walking around what you want to see",
        )  # fmt: skip
    if blurred > _MANY_BLURRED * len(rows):
        return Verdict(
            "usable", what, (f"{blurred} of them blurred",),
            "film more slowly, or with more light",
        )  # fmt: skip
    return Verdict("good", what)
