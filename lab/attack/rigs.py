"""Spoils rigs: their file, their folders and images; a wrong one is refused or said to be wrong."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lab.attack.damage import CAUSES, TO_ANY_FILE, TO_TEXT
from lab.attack.harness import Case, Spoil
from lab.attack.world import RIG_SIZE

WORDS = ("poses", "rig/images", "--rig", "rig/rig.json", "-o", "out")
SAID = ("rig.json",)


def edit_rig(change: Callable[[dict[str, Any]], object]) -> Spoil:
    """Changes the cameras of rig.json."""

    def spoil(folder: Path) -> None:
        path = folder / "rig" / "rig.json"
        values = json.loads(path.read_text())
        change(values["cameras"])
        path.write_text(json.dumps(values))

    return spoil


def set_right(**values: Any) -> Spoil:
    return edit_rig(lambda cameras: cameras["right"].update(values))


def edit_pose(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def edit(cameras: dict[str, Any]) -> None:
        pose = np.array(cameras["right"]["camera_from_reference"], float)
        cameras["right"]["camera_from_reference"] = change(pose).tolist()

    return edit_rig(edit)


def edit_images(change: Callable[[Path, Path], object]) -> Spoil:
    """Changes the folders of both cameras."""
    return lambda folder: change(folder / "rig/images/left", folder / "rig/images/right")


def swap_folders(left: Path, right: Path) -> None:
    left.rename(left.with_name("middle"))
    right.rename(left)
    left.with_name("middle").rename(right)


def shift_frames(left: Path, right: Path) -> None:
    """Gives the right camera's images to the frames three before and after."""
    names = sorted(right.glob("0*.png"))
    for path in names:
        path.rename(path.with_suffix(".moved"))
    for number, path in enumerate(names):
        names[(number + 3) % len(names)].with_suffix(".moved").rename(path)


def repeat_frame(left: Path, right: Path) -> None:
    for folder in (left, right):
        shutil.copy(folder / "002.png", folder / "003.png")


def blacken(left: Path, right: Path) -> None:
    for path in right.glob("0*.png"):
        cv2.imwrite(str(path), np.zeros((RIG_SIZE, RIG_SIZE, 3), np.uint8))


def resize_right(left: Path, right: Path) -> None:
    for path in right.glob("0*.png"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), (RIG_SIZE // 2, RIG_SIZE)))


def remove_frames(left: Path, right: Path) -> None:
    for name in ("001.png", "004.png"):
        (right / name).unlink()


def rename_right(left: Path, right: Path) -> None:
    for path in sorted(right.glob("0*.png"))[1:]:
        path.rename(path.with_name(f"r{path.name}"))
    (right / "000.png").unlink()


def mirror_pose(pose: np.ndarray) -> np.ndarray:
    return np.diag([-1.0, 1.0, 1.0, 1.0]) @ pose


def refuse(name: str, spoil: Spoil, *said: str, may_pass: bool = False, noted: str = "") -> Case:
    # Features that were found are kept for the next run.
    return Case("rig", name, WORDS, ("rig",), spoil, said, may_pass, noted, ("out",))


def list_rig_cases() -> Iterator[Case]:
    """Lists rigs whose file is damaged or contradicts the images."""
    for name, damage in (TO_ANY_FILE | TO_TEXT).items():
        said = (SAID[0], CAUSES.get(name, ""))
        yield refuse(
            f"rig.json is {name}", lambda folder, own=damage: own(folder / "rig/rig.json"), *said
        )
    nan, far = float("nan"), 1e308
    for name, spoil, said in (
        ("a pose of NaN", set_right(camera_from_reference=[nan] * 6), "right"),
        ("a pose without end", set_right(camera_from_reference=[0, 0, 0, far, far, far]), ""),
        ("a pose of five numbers", set_right(camera_from_reference=[0] * 5), "six numbers"),
        ("a mirrored pose", edit_pose(mirror_pose), "mirrors"),
        ("no baseline", set_right(camera_from_reference=[0] * 6), "one place"),
        ("the lens of a number", set_right(file=7), "right"),
        ("a lens outside any folder", set_right(file="../../none.yaml"), "right"),
        ("a folder for a lens", set_right(file="images"), "images"),
        ("itself for a lens", set_right(file="rig.json"), ""),
        ("an unknown shutter", set_right(shutter="sideways"), "top_to_bottom"),
        ("a readout of NaN", set_right(shutter="top_to_bottom", readout_seconds=nan), "readout"),
        ("a readout and no shutter", set_right(readout_seconds=0.01), "shutter"),
        ("one camera", edit_rig(lambda cameras: cameras.pop("right")), "1 camera"),
        ("a camera more", edit_rig(lambda c: c.update(third=dict(c["right"]))), "third"),
        ("a name that leads out", edit_rig(lambda c: c.update({"../left": c.pop("left")})), "left"),
    ):  # fmt: skip
        yield refuse(f"rig.json has {name}", spoil, f"{SAID[0]}|images", said)
    for name, change, said in (
        ("no folder of a camera", lambda left, right: shutil.rmtree(right), "no folder right"),
        ("an empty folder", lambda left, right: [p.unlink() for p in right.iterdir()], "no images"),
        ("two images of one frame",
         lambda left, right: shutil.copy(left / "001.png", left / "001.jpg"), "001"),
        ("pictures of another size", resize_right, "camera right .*160 x 160"),
        ("black pictures of one camera", blacken, "camera right .* dark"),
        ("names that differ in number", rename_right, "frame"),
    ):  # fmt: skip
        yield refuse(f"the images have {name}", edit_images(change), said)
    wrong = "swapped|other side|right way round|refine-rig|not taken together|agree"
    for name, spoil, noted in (
        ("the cameras are swapped", edit_images(swap_folders), wrong),
        ("the pose is the wrong way round", edit_pose(np.linalg.inv), wrong),
        ("frames are those of other times", edit_images(shift_frames), wrong),
        ("a frame is there twice", edit_images(repeat_frame), ""),
        ("frames lack an image", edit_images(remove_frames), "2 without the image of a camera"),
    ):  # fmt: skip
        yield refuse(name, spoil, wrong + "|no scale", may_pass=True, noted=noted)
