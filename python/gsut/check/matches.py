"""Matches photographs taken one after another: what poses and lens must explain."""

from __future__ import annotations

import concurrent.futures
import dataclasses

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.data import Scene
from gsut.data.images import decode_mask
from gsut.data.scene import order_frames, split_last_number
from gsut.judge import SURE
from gsut.sfm import PosesOptions
from gsut.sfm.matches import ENOUGH_MATCHES, MAX_DISTANCE, PREVIEW_FEATURES
from gsut.sfm.photographs import Features, detect_features

_ANCHORS = 9  # places along the dataset at which neighbours are compared
_STEPS = ((0, 1), (0, 2), (1, 2))  # of a pair: how many places after an anchor both images lie
_OPTIONS = PosesOptions(max_features=PREVIEW_FEATURES, max_megapixels=0.14, threads=0)
_MAX_RATIO = 0.75  # of descriptors' distances: few wrong matches rather than many right ones
_JUMPS = 6  # places of a path that are examined where its steps change most: three a far pose
_FEWEST = 16  # matches of a pair: fewer may be chance; small pictures give few more
# Of the diagonal: about a pixel of the small images that features are sought in.
NOISE = 1.5e-3


@dataclasses.dataclass(frozen=True)
class ImagePair:
    """Matched pixels of two images.

    Args:
        first, second: views of the scene.
        pixels: (2, M, 2) float64, at the size of the scene's images.
    """

    first: int
    second: int
    pixels: np.ndarray


def match_neighbours(scene: Scene) -> list[ImagePair]:
    """Matches some images with the next ones of the same camera, in the order of their names.

    Args:
        scene: some of its images are decoded and stay in its cache.

    Returns:
        Pairs with enough matches; empty where images show too little, or not the same.
    """
    wanted = choose_pairs(scene)
    used, rows = np.unique(np.array(wanted, np.int64).reshape(-1, 2), return_inverse=True)
    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
        features = list(threads.map(lambda index: _find_features(scene, index), used.tolist()))
    rows = rows.reshape(-1, 2)
    descriptors = [each.descriptors for each in features]
    matched = _core.match_pairs(descriptors, rows, _MAX_RATIO, MAX_DISTANCE)
    pairs = []
    for (first, second), (a, b), matches in zip(wanted, rows, matched, strict=True):
        pixels = np.stack([features[a].pixels[matches[:, 0]], features[b].pixels[matches[:, 1]]])
        camera = scene.camera(first)
        moved = np.linalg.norm(pixels[1] - pixels[0], axis=1)
        # What moves no more than matches err, in a pair that moves, is on the lens.
        moves = moved > SURE * NOISE * np.hypot(camera.width, camera.height)
        if np.count_nonzero(moves) >= _FEWEST:
            pixels = pixels[:, moves]
        if pixels.shape[1] >= _FEWEST:
            pairs.append(ImagePair(first, second, pixels[:, :ENOUGH_MATCHES]))
    return pairs


def order_in_time(scene: Scene) -> list[list[int]]:
    """Groups views by camera and name without its number, and sorts each group by this number."""
    groups: dict[tuple[str, int], list[int]] = {}
    for index, view in enumerate(scene.views):
        before, number, rest = split_last_number(view.name)
        before = before if number else rest
        groups.setdefault((before, view.camera_index), []).append(index)
    names = {key: [scene.views[index].name for index in group] for key, group in groups.items()}
    return [
        [group[place] for place in np.argsort(order_frames(names[key]), kind="stable")]
        for key, group in groups.items()
    ]


def choose_pairs(scene: Scene) -> list[tuple[int, int]]:
    groups = order_in_time(scene)
    total = sum(len(group) for group in groups)
    centers = np.array([view.camera_center for view in scene.views])
    turns = np.array([view.camera_from_world[:3, :3] for view in scene.views])
    pairs = []
    for group in groups:
        anchors = max(1, round(_ANCHORS * len(group) / total))
        even = np.linspace(0, len(group) - 2, anchors).astype(int)
        moved = np.linalg.norm(np.diff(centers[group], axis=0), axis=1)
        turned = np.linalg.norm(np.diff(turns[group], axis=0), axis=(1, 2))
        for place in np.unique([*even, *_find_jumps(moved), *_find_jumps(turned)]):
            for one, two in _STEPS:
                if place >= 0 and place + two < len(group):
                    pairs.append((group[place + one], group[place + two]))
    return list(dict.fromkeys(pairs))


def _find_jumps(steps: np.ndarray) -> list[int]:
    """Lists the places before those where the steps of a path change most: poses may not fit."""
    return np.argsort(-np.abs(np.diff(steps)), kind="stable")[:_JUMPS].tolist()


def _find_features(scene: Scene, index: int) -> Features:
    """Finds features wherever the dataset's mask allows, also where the lens has no ray.

    The lens is under test, so it must not hide pixels.
    """
    view = scene.views[index]
    try:
        pixels = scene.image(index)
        valid = view.valid if view.mask_path is None else decode_mask(view.mask_path)
    except InputError:  # reported by the checks of the files
        pixels, valid = np.zeros((8, 8, 3), np.uint8), None
    return detect_features(pixels, valid, _OPTIONS)
