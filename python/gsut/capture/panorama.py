"""Prepares pictures of 360-degree cameras: gives panoramas their lens, splits dual fisheyes.

Dual-fisheye pictures hold the circles of two lenses, back to back, side by side. Each becomes a
square picture of its own, masked outside its circle; both lenses start with the same parameters.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.capture.frames import IMAGES, JPEG_QUALITY, Capture
from gsut.capture.video import read_stream_start
from gsut.data import CAPTURE, read_capture
from gsut.data.images import decode_image
from gsut.files import claim_name, read_picture, to_file_name, write_json, write_picture
from gsut.lens import Camera
from gsut.lens.files import values_from_camera
from gsut.sampling import ENOUGH_PICTURES, choose_evenly

# Names of the two lenses, which are folders of their pictures.
LENSES = ["front", "back"]
# Name of the mask that all pictures share.
MASK = "mask.png"
# Folder of the two lenses' pictures.
_SPLIT = "lenses"
# Grey level below which nothing is seen.
_DARK = 24
# Share of a circle's pixels that are brighter in at least one picture.
_BRIGHT_SHARE = 0.6
# Share of the circle's radius that is used: its edge is dim and coloured.
_RIM = 0.985
# Field of view of a circle in radians if unknown, between those of common cameras.
_FIELD = math.radians(195)
# Widths over heights of pictures with two circles, which may have borders.
_WIDTHS = (1.7, 2.1)
# Most difference across the seam of a panorama, x that between its other columns.
_SEAM = 2.0
# Said where nothing below the camera is masked.
_ADVICE = "; if a tripod, hand or stick is seen below, --nadir-cap 25 leaves it out"


@dataclasses.dataclass(frozen=True)
class _Circle:
    """A circle in pixels."""

    x: float
    y: float
    radius: float


def prepare_panoramas(taken: Capture, nadir: float = 0.0) -> Capture:
    """Splits and masks a capture if it comes from a 360-degree camera.

    Args:
        taken: of any camera.
        nadir: degrees from straight down that are masked: tripod, hand, selfie stick; for pictures
            held upright.

    Returns:
        The same capture if it is of another camera and nothing is masked.

    Raises:
        InputError: the cap is out of range, or given for pictures that are no panoramas.
    """
    if not 0 <= nadir < 90:
        raise InputError(f"--nadir-cap must be from 0 to below 90 degrees, found {nadir:g}")
    advice = "" if nadir else _ADVICE
    width, height = taken.figures["size"]
    paths = [taken.path / row["path"] for row in taken.figures["frames"]]
    if _WIDTHS[0] * height <= width <= _WIDTHS[1] * height:
        brightest, seam = _examine_pictures(choose_evenly(paths))
        circles = [_find_circle(half) for half in np.hsplit(brightest[:, : width // 2 * 2], 2)]
        if None not in circles:
            return _split(taken, [c for c in circles if c is not None], nadir)
    if width != 2 * height:
        if nadir:
            raise InputError(
                "--nadir-cap is for 360-degree pictures, twice as wide as high; "
                f"these are {width} x {height}: draw masks instead (masks/NAME.png)"
            )
        return taken
    if not seam:
        return taken
    lens = Camera("equirectangular", [], width, height)
    note = "the pictures are 360-degree panoramas (equirectangular): their lens is known" + advice
    _write_mask(taken.path / MASK, lens, None, nadir)
    rows = [{**row, "mask": MASK} for row in taken.figures["frames"]]
    figures = {**taken.figures, "frames": rows, "lens": values_from_camera(lens)}
    figures["notes"] = [*(n for n in taken.notes if n != note), note]
    write_json(taken.path / CAPTURE, figures)
    return Capture(taken.path, figures)


def find_other_lens(videos: Sequence[Path]) -> Path | None:
    """Finds the video of the second lens of a 360-degree camera; None if there is none.

    Args:
        videos: one, whose second stream may be of that lens, or two, the second one's.

    Returns:
        The last of the videos if both lenses' frames are square with a bright circle and of equal
        number.
    """
    if len(videos) > 2:
        return None
    common = []
    for path, stream in ((videos[-1], 2 - len(videos)), (videos[0], 0)):
        start = read_stream_start(path, stream, ENOUGH_PICTURES)
        if start is None or start[0].shape[1] != start[0].shape[2]:
            return None
        if _find_circle(start[0].max(axis=(0, 3))) is None:
            return None
        common.append(start[1])
    if common[0] != common[1]:
        return None
    return videos[-1]


def _examine_pictures(paths: Sequence[Path]) -> tuple[np.ndarray, bool]:
    """Returns the brightest grey level of each pixel, and whether left and right edge join."""
    import cv2

    brightest: np.ndarray = np.zeros(0, np.uint8)
    ratios = []
    for path in paths:
        grey = read_picture(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        if grey is None:
            continue
        brightest = grey if not len(brightest) else np.maximum(brightest, grey)
        columns = grey.astype(np.float32)
        across = np.abs(columns[:, 0] - columns[:, -1]).mean()
        beside = np.abs(np.diff(columns[:, :: max(1, columns.shape[1] // 64)], axis=1)).mean()
        inside = np.abs(columns[:, 1:] - columns[:, :-1]).mean()
        ratios.append(across <= max(_SEAM * inside, 0.5) or across < 0.2 * beside)
    return brightest, bool(ratios) and sum(ratios) > len(ratios) / 2


def _find_circle(half: np.ndarray) -> _Circle | None:
    """Finds the bright circle in one half of a picture; None if there is none."""
    height, width = half.shape
    bright = half > _DARK
    rows, columns = np.flatnonzero(bright.any(axis=1)), np.flatnonzero(bright.any(axis=0))
    if not len(rows):
        return None
    left, right, top, bottom = columns[0], columns[-1] + 1, rows[0], rows[-1] + 1
    radius = max(right - left, bottom - top) / 2
    circle = _Circle((left + right) / 2, (top + bottom) / 2, radius)
    if not 0.35 * height <= radius <= 0.52 * height:
        return None
    y, x = np.mgrid[:height, :width] + 0.5
    away = np.hypot(x - circle.x, y - circle.y)
    outside = bright[away > 1.03 * radius]
    inside = bright[away < 0.9 * radius]
    if (outside.size and outside.mean() > 0.02) or inside.mean() < _BRIGHT_SHARE:
        return None
    return circle


def _split(taken: Capture, circles: Sequence[_Circle], nadir: float) -> Capture:
    """Writes the pictures of both lenses as a capture in a folder of its own."""
    folder = taken.path / _SPLIT
    key = {**taken.figures["key"], "nadir_cap": nadir}
    before = read_capture(folder)
    if before is not None and before["key"] == key:
        return Capture(folder, before)
    half = taken.figures["size"][0] // 2
    side = 2 * round(max(circle.radius for circle in circles))
    rows = []
    for number, name in enumerate(LENSES):
        (folder / IMAGES / name).mkdir(parents=True, exist_ok=True)
        circle, taken_names = circles[number], set[str]()
        corner = round(circle.x - side / 2), round(circle.y - side / 2)
        for row in taken.figures["frames"]:
            pixels = decode_image(taken.path / row["path"])[0][..., ::-1]
            part = _cut(pixels[:, number * half : (number + 1) * half], *corner, side)
            stem = to_file_name(row["name"].replace("/", "-").rpartition(".")[0])
            target = folder / IMAGES / name / claim_name(f"{stem}.jpg", taken_names)
            write_picture(target, part, JPEG_QUALITY)
            own = f"{name}/{target.name}"
            flow = _crop_flow(row.get("flow"), number * half + corner[0], corner[1], side)
            rows.append({**row, "name": own, "path": f"{IMAGES}/{own}", "mask": MASK, "flow": flow})
    radius = min(circle.radius for circle in circles)
    lens = _make_fisheye(side, radius)
    _write_mask(folder / MASK, lens, _RIM * radius, nadir)
    figures = {
        **taken.figures, "key": key, "size": [side, side], "frames": rows, "camera": "",
        "focal_px": None, "fisheye": values_from_camera(lens), "lenses": LENSES,
        "notes": [
            *taken.notes,
            f"each picture holds the circles of two lenses, which become {len(rows)} pictures"
            + ("" if nadir else _ADVICE),
        ],
    }  # fmt: skip
    write_json(folder / CAPTURE, figures)
    return Capture(folder, figures)


def _crop_flow(
    flow: list[list[float]] | None, left: int, top: int, side: int
) -> list[list[float]] | None:
    """Returns the flow within a square part of a picture, in the pixels of the part."""
    rows = [[x - left, y - top, *rates] for x, y, *rates in flow or ()]
    return [row for row in rows if 0 <= row[0] < side and 0 <= row[1] < side] or None


def _cut(pixels: np.ndarray, left: int, top: int, side: int) -> np.ndarray:
    """Cuts out a square part, black where it reaches beyond the picture."""
    out = np.zeros((side, side, 3), np.uint8)
    height, width = pixels.shape[:2]
    x0, y0, x1, y1 = max(0, left), max(0, top), min(width, left + side), min(height, top + side)
    out[y0 - top : y1 - top, x0 - left : x1 - left] = pixels[y0:y1, x0:x1]
    return out


def _make_fisheye(side: int, radius: float) -> Camera:
    """Returns an equidistant lens whose field fills the circle."""
    focal = radius / (_FIELD / 2)
    return Camera("kannala_brandt", [focal, focal, side / 2, side / 2, 0, 0, 0, 0], side, side)


def _write_mask(path: Path, lens: Camera, radius: float | None, nadir: float) -> None:
    """Writes an image that is white inside the circle and outside the cap."""
    rays, valid = lens.rays()
    mask = np.array(valid)
    down = np.degrees(np.arccos(np.clip(np.nan_to_num(rays[:, :, 1]), -1, 1)))
    if nadir:
        mask &= down > nadir
    if radius is not None:
        y, x = np.mgrid[: lens.height, : lens.width] + 0.5
        mask &= np.hypot(x - lens.width / 2, y - lens.height / 2) < radius
    write_picture(path, mask.astype(np.uint8) * 255)
