"""Spoils datasets: `gsut doctor` and `gsut train` must agree on each and name what is wrong."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import random
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from lab.attack.damage import CAUSES, TO_ANY_FILE, TO_TEXT
from lab.attack.harness import Case, Spoil

TRAIN = ("--steps", "2", "--quiet")
NUMBERS: tuple[Any, ...] = (float("nan"), float("inf"), -1, 0, 1e300, 10**400, "x", "", None, [],
                            {}, True, 1 << 31)  # fmt: skip


def edit_json(change: Callable[[dict[str, Any]], object]) -> Spoil:
    """Changes the dictionary of transforms.json."""

    def spoil(folder: Path) -> None:
        path = folder / "ds" / "transforms.json"
        values = json.loads(path.read_text())
        changed = change(values)
        path.write_text(json.dumps(values if changed is None else changed))

    return spoil


def set_key(*keys: Any, value: Any) -> Spoil:
    """Writes a value in the place that the keys lead to."""

    def change(values: Any) -> None:
        for key in keys[:-1]:
            values = values[key]
        values[keys[-1]] = value

    return edit_json(change)


def del_key(*keys: Any) -> Spoil:
    def change(values: Any) -> None:
        for key in keys[:-1]:
            values = values[key]
        del values[keys[-1]]

    return edit_json(change)


def edit_image(make: Callable[[Path], object], name: str = "images/003.png") -> Spoil:
    return lambda folder: make(folder / "ds" / name)


def encode_as(make: Callable[[np.ndarray], bytes]) -> Callable[[Path], object]:
    """Another file of the same pixels."""

    def write(path: Path) -> None:
        pixels = cv2.imread(str(path))
        path.write_bytes(make(pixels))

    return write


def encode_png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def save_as(mode: str, form: str, **settings: Any) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        image = Image.open(path).convert(mode)
        buffer = io.BytesIO()
        image.save(buffer, form, **settings)
        path.write_bytes(buffer.getvalue())

    return write


def claim_size(path: Path) -> None:
    """A PNG whose header says 30000 x 30000, with a right checksum."""
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 30000, 30000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    path.write_bytes(data)


def write_holed_jpeg(path: Path) -> None:
    noise = np.random.default_rng(3).integers(0, 255, (48, 48, 3), dtype=np.uint8)
    data = bytearray(cv2.imencode(".jpg", cv2.resize(noise, (48, 48)))[1].tobytes())
    middle = len(data) // 2
    data[middle : middle + 512] = bytes(len(data[middle : middle + 512]))
    path.write_bytes(data)


def flip_bytes(path: Path) -> None:
    data = bytearray(path.read_bytes())
    for place in random.Random(2).sample(range(60, len(data) - 20), 5):
        data[place] ^= 0x55
    path.write_bytes(data)


def keep_views(count: int) -> Spoil:
    def change(values: dict[str, Any]) -> None:
        values["frames"] = values["frames"][:count]
        for key in ("train_filenames", "test_filenames"):
            del values[key]

    return edit_json(change)


def rename_bytes(folder: Path) -> None:
    """A picture whose name is no UTF-8; the list names it as Python does."""
    name = os.fsdecode(b"images/caf\xe9.png")
    (folder / "ds/images/003.png").rename(folder / "ds" / name)
    text = (folder / "ds/transforms.json").read_text()
    (folder / "ds/transforms.json").write_text(
        text.replace("images/003.png", "images/caf\\udce9.png")
    )


def edit_pose(change: Callable[[np.ndarray], Any]) -> Spoil:
    def to(values: dict[str, Any]) -> None:
        frame = values["frames"][3]
        changed = change(np.array(frame["transform_matrix"]))
        frame["transform_matrix"] = changed.tolist() if isinstance(changed, np.ndarray) else changed

    return edit_json(to)


def add_mask(pixels: Any) -> Spoil:
    """Frames with one mask."""

    def spoil(folder: Path) -> None:
        cv2.imwrite(str(folder / "ds/mask.png"), np.asarray(pixels, np.uint8))
        put_masks = edit_json(
            lambda values: [f.update(mask_path="mask.png") for f in values["frames"]] and None
        )
        put_masks(folder)

    return spoil


# Name -> (what is done, what both say; "" where the dataset can be trained on all the same).
ROWS: dict[str, tuple[Spoil, str]] = {
    "frames are missing": (del_key("frames"), "transforms.json.*frames"),
    "frames are none": (set_key("frames", value=[]), "frames|no image|holds no"),
    "frames are a number": (set_key("frames", value=7), "transforms.json.*frames"),
    "frames are words": (set_key("frames", value="images"), "transforms.json.*frames"),
    "a frame is a list": (set_key("frames", 3, value=[1]), "transforms.json.*frame"),
    "a frame is null": (set_key("frames", 3, value=None), "transforms.json.*frame"),
    "a frame lacks its pose": (del_key("frames", 3, "transform_matrix"), "transform_matrix"),
    "a frame lacks its name": (del_key("frames", 3, "file_path"), "file_path"),
    "a name is empty": (set_key("frames", 3, "file_path", value=""), "file_path|images/003"),
    "a name is a number": (set_key("frames", 3, "file_path", value=3), "file_path"),
    "a name is a folder": (set_key("frames", 3, "file_path", value="images"), "images"),
    "a name has a zero byte": (set_key("frames", 3, "file_path", value="a\0b.png"),
        "images/003|byte"),
    "a name has 5000 letters": (set_key("frames", 3, "file_path", value="a" * 5000), "aaaa|003"),
    "a name leads out": (set_key("frames", 3, "file_path", value="../../etc/passwd"), "passwd|003"),
    "a name is a device": (set_key("frames", 3, "file_path", value="/dev/zero"), "zero|003"),
    "a name is twice": (set_key("frames", 3, "file_path", value="images/004.png"),
        "images/004.png"),
    "a name is no UTF-8": (rename_bytes, ""),
    "a pose is of zeros": (edit_pose(lambda m: m * 0), "pose|rotation|matrix"),
    "a pose is NaN": (edit_pose(lambda m: m * np.nan), "transforms.json|images/003"),
    "a pose is mirrored": (edit_pose(lambda m: m @ np.diag([-1, 1, 1, 1])), "images/003|mirror"),
    "a pose is scaled": (edit_pose(lambda m: m @ np.diag([3, 3, 3, 1])), "images/003|rotation"),
    "a pose is sheared": (edit_pose(lambda m: m + np.eye(4)[::-1] * 0.5), "images/003|rotation"),
    "a pose is far": (edit_pose(lambda m: m + 1e300 * np.eye(4, k=3)), "1e|pose|far"),
    "a pose is apart": (edit_pose(lambda m: m + 1e3 * np.eye(4, k=3)), ""),
    "a pose has three columns": (edit_pose(lambda m: m[:, :3]), "shape"),
    "a pose is of words": (edit_pose(lambda m: [["a"] * 4] * 4), "numbers"),
    "a pose is ragged": (edit_pose(lambda m: [[1, 2], [3]]), "matrix|numbers|shape"),
    "a pose is nested": (edit_pose(lambda m: [m.tolist()]), "shape"),
    "a pose has big integers": (edit_pose(lambda m: [[10**400] * 4] * 4), "transforms.json|images"),
    **{
        f"{key} is {value!r:.12}": (set_key(key, value=value), f"transforms.json.*{said}")
        for key, said in (("fl_x", "key 'fl_x'"), ("w", "w")) for value in NUMBERS
    },
    "cx is far outside": (set_key("cx", value=1e9), "cx"),
    "k1 is 1e300": (
        edit_json(lambda values: values.update(camera_model="OPENCV", k1=1e300)), "key 'k1'"
    ),
    "focal lengths in a ratio of 13": (
        edit_json(lambda values: values.update(fl_y=13 * values["fl_x"])),
        "key 'fl_x'.*factor of 13"
    ),
    "k1 is NaN": (set_key("k1", value=float("nan")), "k1"),
    "the lens is unknown": (set_key("camera_model", value="MAGIC"), "MAGIC"),
    "the lens is a list": (set_key("camera_model", value=["PINHOLE"]), "camera_model"),
    "the width is another": (set_key("w", value=96), "48|96"),
    "the test list is a number": (set_key("test_filenames", value=5), "test_filenames"),
    "the test list names nothing": (set_key("test_filenames", value=["zebra.png"]), "zebra"),
    "all views are tests": (
        edit_json(lambda v: v.update(train_filenames=[], test_filenames=[
            f["file_path"] for f in v["frames"]])), "training"),
    "one view": (keep_views(1), ""),
    "two views": (keep_views(2), ""),
    "points are of no file": (set_key("ply_file_path", value="nowhere.ply"), "nowhere.ply"),
    "points are a list": (set_key("ply_file_path", value=[1]), "ply_file_path"),
    "points are a picture": (set_key("ply_file_path", value="images/001.png"), "images/001.png"),
    "the mask is black": (add_mask(np.zeros((48, 48))), "mask"),
    "the mask is of another size": (add_mask(np.full((9, 9), 255)), "mask.png"),
    "the mask is a text": (
        lambda folder: (add_mask(np.ones((48, 48)))(folder),
                        (folder / "ds/mask.png").write_text("no mask")), "mask.png"),
    "the mask is missing": (set_key("frames", 3, "mask_path", value="gone.png"), "gone.png"),
    "a picture claims 30000 x 30000": (edit_image(claim_size), "003.png"),
    "a picture has flipped bytes": (edit_image(flip_bytes), "003.png"),
    "a picture is a JPEG with a hole": (edit_image(write_holed_jpeg), "003.png"),
    "a picture is a whole JPEG": (edit_image(save_as("RGB", "JPEG")), ""),
    "a picture is CMYK": (edit_image(save_as("CMYK", "JPEG")), ""),
    "a picture is grey": (edit_image(save_as("L", "PNG")), ""),
    "a picture is of 1 bit": (edit_image(save_as("1", "PNG")), ""),
    "a picture has a palette": (edit_image(save_as("P", "PNG")), ""),
    "a picture is a WebP": (edit_image(save_as("RGB", "WEBP")), ""),
    "a picture is a GIF": (edit_image(save_as("P", "GIF")), "003.png|"),
    "a picture is a TIFF": (edit_image(save_as("RGB", "TIFF")), ""),
    "a picture is of another size": (
        edit_image(encode_as(lambda p: encode_png(p[:40]))), "003.png"),
    "a picture is turned": (
        edit_image(encode_as(lambda p: encode_png(p[:, :47]))), "003.png"),
    "a picture has alpha 0": (
        edit_image(encode_as(lambda p: encode_png(np.dstack([p, p[..., 0] * 0])))),
        "003.png: the mask"),
    "a picture of 64 x 1 pixels": (
        edit_image(encode_as(lambda p: encode_png(p[:1]))), "003.png"),
    "the last picture is cut": (
        edit_image(lambda path: path.write_bytes(path.read_bytes()[:-40]), "images/011.png"),
        "011.png"),
    **{
        f"{key} is {value!r:.12}": (
            set_key("frames", 3, key, value=value), key if value == 10**400 else "")
        for key in ("timestamp", "timestamp_ns") for value in NUMBERS
    },
    "a rolling shutter stands still": (set_key("rolling_shutter", value="top_to_bottom"), ""),
    "the dataset is a list": (edit_json(lambda _: [1, 2]), "transforms.json"),
    "the dataset is a number": (edit_json(lambda _: 7), "transforms.json"),
    "the dataset is null": (
        lambda folder: (folder / "ds/transforms.json").write_text("null"), "transforms.json"),
    "a key is twice": (
        lambda folder: (folder / "ds/transforms.json").write_text(
            (folder / "ds/transforms.json").read_text().replace('"w": 48', '"w": 48, "w": 48')),
        "'w' is there twice"),
    "NaN without quotes": (set_key("fl_y", value=float("nan")), "fl_y"),
    "deeply nested": (
        lambda folder: (folder / "ds/transforms.json").write_text("[" * 100_000),
        "transforms.json"),
}  # fmt: skip
# What doctor says of a row.
NOTED = {
    "a pose is apart": "stands farther from all other cameras",
    "a rolling shutter stands still": "count as taken in one moment",
    "timestamp is nan": "no number of seconds",
    "timestamp_ns is 1e+300": "no number of nanoseconds",
}
# What is there can be read, and nothing says that there was more.
SHORTER = {("data.csv", "cut in half"), ("points3D.txt", "empty"), ("points3D.txt", "cut in half")}
FAILS = "(?!)"  # no sentence has it: this must pass
# What may be absent, and what doctor says then.
NO_POINTS, NO_PICTURE, FIRST = "points", r"000\.png", "1403636579763555584.png"
OPTIONAL = {
    "plane": {"000.png": NO_PICTURE, "points3D.ply": NO_POINTS},
    "colmap_text": {"000.png": NO_PICTURE, "points3D.txt": NO_POINTS},
    "colmap_binary": {"000.png": NO_PICTURE, "points3D.bin": NO_POINTS},
    "folder": {"000.png": NO_PICTURE, "points3D.ply": NO_POINTS},
    "euroc": {FIRST: re.escape(FIRST), "data.csv": ""},  # without a table names are times
    "tumvi": {FIRST: ""},  # of which there is no list
}
LAYOUTS = ("plane", "colmap_text", "colmap_binary", "folder", "euroc", "tumvi")


def list_dataset_rows(world: Path) -> Iterator[tuple[str, str, Spoil, str, str | None]]:
    """(name, dataset, what is done, what both say, what doctor notes where both may go on)."""
    for name, (spoil, said) in ROWS.items():
        goes_on = NOTED.get(name, "") if said == "" or said.endswith("|") else None
        yield name, "ds", spoil, said.removesuffix("|") or FAILS, goes_on
    for layout in LAYOUTS:
        listed = sorted(p.relative_to(world) for p in (world / layout).rglob("*") if p.is_file())
        tables = [p for p in listed if p.suffix not in (".png", ".jpg")]
        for path in [*tables, *[p for p in listed if p.suffix == ".png"][:1]]:
            damages = TO_ANY_FILE | (TO_TEXT if path.suffix in (".json", ".yaml", ".txt") else {})
            for name, damage in damages.items():
                goes_on = "" if (path.name, name) in SHORTER else None
                if name in CAUSES and layout in OPTIONAL and path.name in OPTIONAL[layout]:
                    goes_on = OPTIONAL[layout][path.name]
                yield (
                    f"{path} is {name}", layout,
                    lambda folder, path=path, damage=damage: damage(folder / path),
                    f"{re.escape(path.name)}|{layout}", goes_on,
                )  # fmt: skip


def list_dataset_cases(world: Path) -> Iterator[tuple[Case, Case]]:
    """Lists pairs of cases, of `doctor` and of `train`."""
    for name, dataset, spoil, said, noted in list_dataset_rows(world):
        doctor, train = (
            Case("dataset", name, words, (dataset,), spoil, (said,), noted is not None, noted or "")
            for words in (("doctor", dataset, "--json"), ("train", dataset, "-o", "out", *TRAIN))
        )
        yield doctor, dataclasses.replace(train, noted="")
