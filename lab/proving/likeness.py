"""Compares made captures with real ones, statistic by statistic."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gsut.capture.frames import extract_frames
from gsut.capture.photographs import find_photograph_files
from gsut.capture.video import is_video
from gsut.data.images import decode_image
from gsut.files import write_picture
from lab.proving.capture import capture
from lab.proving.commands import run_gsut
from lab.proving.score import find_given
from lab.proving.writing import make_capture

_PIXELS = 60_000  # of the pictures that are compared, as made ones have them
_MOST = 40  # pictures of a real capture, as many as made ones have
_PAIRS = 4  # of pictures that follow each other, which are measured
_SEEN = 3  # grey levels: what is darker lies outside the circle of a lens
_DARK = 32
_RATIO = 0.7  # of a match's distance over the second best's
_LEAST = 20  # matches that tell a gain
HEADING = (
    "statistic of a capture", "real, made captures", "real: least", "real: median", "real: most",
    "made: a tenth below", "made: median", "made: a tenth above", "KS",
    "made outside the real range",
)  # fmt: skip
# Key, what it is called, and factor of the key's unit.
_STATISTICS = (
    ("features", "SIFT features a megapixel", 1.0),
    ("sharpness", "sharpness: standard deviation of the Laplacian, grey levels", 1.0),
    ("dark", "pixels darker than 32, %", 100.0),
    ("gain", "brightness of matched features from picture to picture, stops", 1.0),
    ("agreement", "verified matches that fit the poses, %", 100.0),
    ("track_length", "images a point", 1.0),
    ("residual", "median residual in a picture of 60,000 pixels, px", 1.0),
)
Row = dict[str, Any]


def measure_made(row: Row) -> Row:
    """Measures a made capture: what gsut is given of it, and its poses in a row of a run."""
    made = capture(row["seed"])
    with tempfile.TemporaryDirectory(prefix="gsut-prove-") as work:
        paths = _list_pictures(find_given(made, make_capture(made)), Path(work))
        measured = measure_pictures([_read_small(path) for path in paths])
    if "residual_px" in row:
        scale = math.sqrt(_PIXELS / (row["width"] * row["height"]))
        measured |= {"agreement": row["agreement"], "track_length": row["track_length"],
                     "residual": scale * row["residual_px"]}  # fmt: skip
    return measured


def measure_real(source: Path) -> Row:
    """Measures a film or a folder of photographs, after reducing it to the size of made ones."""
    with tempfile.TemporaryDirectory(prefix="gsut-prove-") as name:
        work, small = Path(name), Path(name) / "small"
        small.mkdir()
        pictures = [_read_small(path) for path in _list_pictures(source, work)]
        for number, picture in enumerate(pictures):
            write_picture(small / f"{number:03d}.png", picture[..., ::-1])
        measured = measure_pictures(pictures)
        outcome = run_gsut("poses", small, "-o", work / "poses", "--quiet", work=work)
        if outcome.status == 0:
            figures = json.loads((work / "poses/poses.json").read_text("utf-8"))
            measured |= {"agreement": figures["matches_in_points"],
                         "track_length": figures["mean_track_length"],
                         "residual": figures["reprojection_error_px"]["median"]}  # fmt: skip
    return measured


def _list_pictures(source: Path, work: Path) -> list[Path]:
    """Lists pictures of a film or a folder, along all of it."""
    if is_video(source):
        source = extract_frames(source, work / "frames", count=_MOST).path
    paths = list(find_photograph_files([source]).values())
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(_MOST, len(paths))).round())
    return [paths[number] for number in chosen.astype(int)]


def _read_small(path: Path) -> np.ndarray:
    image = decode_image(path)[0]
    scale = min(1.0, math.sqrt(_PIXELS / (image.shape[0] * image.shape[1])))
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def measure_pictures(pictures: Sequence[np.ndarray]) -> Row:
    """Measures neighbours along a capture, RGB: the medians."""
    firsts = np.unique(np.linspace(0, max(0, len(pictures) - 2), _PAIRS).round()).astype(int)
    greys = [cv2.cvtColor(each, cv2.COLOR_RGB2GRAY) for each in pictures]
    found = {number: _find_features(greys[number])
             for number in sorted({*firsts, *(firsts + 1)}) if number < len(greys)}  # fmt: skip
    features, sharpness, dark = [], [], []
    for number, (places, _, _) in found.items():
        seen = greys[number] >= _SEEN
        inner = cv2.erode(seen.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        features.append(1e6 * len(places) / max(1, seen.sum()))
        sharpness.append(cv2.Laplacian(greys[number], cv2.CV_64F)[inner].std())
        dark.append((greys[number][seen] < _DARK).mean())
    gains = [_measure_gain(found[one], found[one + 1]) for one in firsts if one + 1 in found]
    known = [abs(gain) for gain in gains if gain is not None]
    return {
        "features": float(np.median(features)), "sharpness": float(np.median(sharpness)),
        "dark": float(np.median(dark)), "gain": float(np.median(known)) if known else None,
    }  # fmt: skip


_Features = tuple[np.ndarray, np.ndarray, np.ndarray]  # places, descriptors, brightness around


def _find_features(grey: np.ndarray) -> _Features:
    seen = (grey >= _SEEN).astype(np.uint8)
    points, descriptors = cv2.SIFT_create().detectAndCompute(grey, seen)
    places = np.array([point.pt for point in points], np.float32).reshape(-1, 2)
    soft = cv2.GaussianBlur(grey, (0, 0), 2.0).astype(np.float32)
    light = cv2.remap(soft, places[None], None, cv2.INTER_LINEAR)[0] if points else np.zeros(0)
    return places, descriptors, light


def _measure_gain(first: _Features, second: _Features) -> float | None:
    """Measures by how many stops the same features are brighter in the second picture."""
    if min(len(first[0]), len(second[0])) < _LEAST:
        return None
    nearest = cv2.BFMatcher().knnMatch(first[1], second[1], k=2)
    pairs = [(one.queryIdx, one.trainIdx) for one, other in nearest
             if one.distance < _RATIO * other.distance]  # fmt: skip
    if len(pairs) < _LEAST:
        return None
    before, after = (np.maximum(light[list(numbers)], 1.0) for light, numbers in
                     zip((first[2], second[2]), zip(*pairs, strict=True), strict=True))  # fmt: skip
    return float(np.median(np.log2(after / before)))


def compare_distributions(real: Iterable[Row], made: Iterable[Row]) -> list[tuple[object, ...]]:
    """Compares both: a row of `HEADING` a statistic.

    KS is the largest distance of the two distributions (Kolmogorov and Smirnov).
    """
    table: list[tuple[object, ...]] = []
    rows = list(real), list(made)
    for key, name, factor in _STATISTICS:
        values = [factor * np.sort([row[key] for row in own if row.get(key) is not None])
                  for own in rows]  # fmt: skip
        theirs, ours = values
        if not len(theirs) or not len(ours):
            continue
        both = np.concatenate(values)
        shares = [np.searchsorted(each, both, side="right") / len(each) for each in values]
        outside = 100 * float(((ours < theirs[0]) | (ours > theirs[-1])).mean())
        spread = (theirs[0], np.median(theirs), theirs[-1], *np.quantile(ours, [0.1, 0.5, 0.9]))
        table.append((
            name, f"{len(theirs)}, {len(ours)}", *(_format(value) for value in spread),
            f"{np.abs(shares[0] - shares[1]).max():.2f}", f"{outside:.0f} %",
        ))  # fmt: skip
    return table


def _format(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"
