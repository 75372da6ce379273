"""Edits a scene from the page: finds its ground and floaters, and saves it to a new file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.bounds import FARTHEST, LEAST_SCALE
from gsut.compact import find_support
from gsut.files import Number, refuse_existing, write_json
from gsut.formats import WriteSettings, choose_format, save_gaussians
from gsut.gaussians import find_ground, rotate_upright, transform_gaussians
from gsut.view.frame_request import BOX, NONE, POINT
from gsut.view.selections import STEPS
from gsut.view.shown_gaussians import ShownGaussians

# Name of the new file if the page gives none.
_DEFAULT_NAME = "edited.ply"
# Shape of a request to save, see `save_edited`.
SAVED = {
    "name?": str, "crop?": BOX, "clean?": bool, "edits?": (NONE, str), "steps?": STEPS,
    "scale?": Number(LEAST_SCALE, 1 / LEAST_SCALE), "up?": (NONE, POINT),
    "level?": (NONE, Number(-FARTHEST, FARTHEST)),
}  # fmt: skip


def locate_ground(shown: ShownGaussians, up: Any) -> dict[str, Any]:
    """Finds the plane that the scene stands on, roughly across `up`: "normal" (3,) and "level"."""
    normal, level = find_ground(shown.load_all(), up)
    return {"normal": normal, "level": level}


def find_floaters(shown: ShownGaussians, on_view: Callable[[int], object]) -> dict[str, int]:
    """Finds the floaters, stores them in `shown` and returns how many there are.

    Raises:
        InputError: the stage has no training photographs.
    """
    stage = shown.stage
    if stage.scene is None or stage.kind != "run":
        raise InputError("floaters are found by a run's photographs, and there are none here")
    if shown.floaters is None:
        support = find_support(
            stage.scene, shown.load_all(), stage.scene.train_indices,
            background=stage.background, light=stage.light, on_view=on_view,
        )  # fmt: skip
        shown.floaters = support.contradicted
    return {"count": int(np.count_nonzero(shown.floaters)), "of": len(shown.floaters)}


def check_floaters(shown: ShownGaussians, clean: bool) -> None:
    """Raises InputError if floaters are to be left out before the search for them has ended."""
    if clean and shown.floaters is None:
        raise InputError("floaters are not found yet: wait until the search ends, or keep them")


def save_edited(
    shown: ShownGaussians, values: dict[str, Any], edits: list[dict[str, Any]]
) -> dict[str, Any]:
    """Writes the scene as it is shown to a new file beside the run or file.

    Args:
        shown: of the stage.
        values: "name" of the file; "crop", "clean" and "edits" as in a frame; "up" (3,) becomes -y,
            and with "level" the ground, which lies there along "up", becomes y = 0; lengths are
            multiplied by "scale".
        edits: made by hand, which are written beside the scene (.edits.json).

    Returns:
        "path" and, of the edits, "edits_path"; "num_gaussians", "of" and sentences on what the
        format "left_out".

    Raises:
        InputError: the file exists, lies in another folder or has an unknown format.
    """
    folder = shown.stage.folder
    if folder is None:
        raise InputError("this scene is not a file yet: it is saved when the training ends")
    name = values.get("name") or _DEFAULT_NAME
    if Path(name).name != name or name.startswith("."):
        raise InputError(f"give a file's name, without folders: it is saved in {folder}")
    path = folder / name
    choose_format(path)
    repeated = path.with_suffix(".edits.json") if edits else None
    for new in (path, repeated):
        if new is not None:
            refuse_existing(new)
    check_floaters(shown, values.get("clean", False))
    scale, crop = values.get("scale", 1.0), values.get("crop")
    crop = None if crop is None else np.array(crop, np.float64)
    whole = shown.load_all()
    clean, key = values.get("clean", False), values.get("edits") or None
    kept = whole[shown.select_kept(whole, crop, clean, key)]
    if not len(kept):
        raise InputError("nothing is left; crop or delete less")
    turn, height = np.eye(3), 0.0
    if values.get("up") is not None:
        turn = rotate_upright(values["up"])
        height = values.get("level") or 0.0
    moved = transform_gaussians(kept, turn, scale, scale * np.array([0.0, height, 0.0]))
    written = save_gaussians(path, moved, WriteSettings(antialiased=shown.stage.antialiased))
    if repeated is not None:
        write_json(repeated, {"edits": edits})
    return {
        "path": str(path), "edits_path": None if repeated is None else str(repeated),
        "num_gaussians": len(moved), "of": len(whole),
        "left_out": list(written.left_out),
    }  # fmt: skip
