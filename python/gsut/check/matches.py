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
from gsut.sfm import PosesOptions
from gsut.sfm.matches import MAX_DISTANCE
from gsut.sfm.photographs import Features, detect_features


@dataclasses.dataclass(frozen=True)
class _Look:
    """How closely photographs are examined.

    Args:
        anchors: number of places along the dataset at which neighbours are compared.
        steps: of each pair, how many places after an anchor both images lie.
        most: matches kept of a pair.
        loops: most pairs of images that are far apart on the path and see the same.
        options: of the features.
    """

    anchors: int
    steps: tuple[tuple[int, int], ...]
    most: int
    loops: int
    options: PosesOptions


_QUICK = _Look(9, ((0, 1), (0, 2), (1, 2)), 250, 0, PosesOptions(
    max_features=700, max_megapixels=0.14, threads=0
))  # fmt: skip
_CLOSE = _Look(24, ((0, 1), (1, 2), (0, 3), (3, 6), (0, 6)), 600, 12, PosesOptions(
    max_features=1500, max_megapixels=0.8, threads=0
))  # fmt: skip
_CONTRAST = 0.01  # threshold of SIFT: even surfaces are not needed here
_MAX_RATIO = 0.75  # of descriptors' distances: few wrong matches rather than many right ones
_JUMPS = 2  # longest steps of a path that are examined: one pose far away makes two
_LOOP = 0.25  # of a path's length in frames, from which a pair that sees the same closes a loop
_SAME_DIRECTION = np.cos(np.radians(40.0))  # between optical axes of images that see the same
_LOOPS_A_VIEW = 2  # so that loops are spread over the path
_FEWEST = 16  # matches of a pair: fewer may be chance
_STILL = 0.004  # of the image's diagonal: what moves less, in a pair that moves, is on the lens


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


def match_neighbours(scene: Scene, closely: bool = False) -> list[ImagePair]:
    """Matches some images with the next ones of the same camera, in the order of their names.

    Args:
        scene: some of its images are decoded and stay in its cache.
        closely: more images, larger ones: for errors of a fraction of a pixel, in several times the
            time.

    Returns:
        Pairs with enough matches; empty where images show too little, or not the same.
    """
    look = _CLOSE if closely else _QUICK
    wanted = _choose_pairs(scene, look)
    used = sorted({index for pair in wanted for index in pair})
    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as threads:
        features = dict(
            zip(
                used,
                threads.map(lambda i: _find_features(scene, i, look.options), used),
                strict=True,
            )
        )
    place = {index: number for number, index in enumerate(used)}
    rows = np.array([[place[a], place[b]] for a, b in wanted], np.int64).reshape(-1, 2)
    descriptors = [features[index].descriptors for index in used]
    matched = _core.match_pairs(descriptors, rows, _MAX_RATIO, MAX_DISTANCE)
    pairs = []
    for (a, b), matches in zip(wanted, matched, strict=True):
        pixels = np.stack([features[a].pixels[matches[:, 0]], features[b].pixels[matches[:, 1]]])
        camera = scene.cameras[scene.views[a].camera_index]
        moved = np.linalg.norm(pixels[1] - pixels[0], axis=1)
        still = moved < _STILL * np.hypot(camera.width, camera.height)
        if np.count_nonzero(~still) >= _FEWEST:
            pixels = pixels[:, ~still]
        if pixels.shape[1] >= _FEWEST:
            pairs.append(ImagePair(a, b, pixels[:, : look.most]))
    return pairs


def order_in_time(scene: Scene) -> list[list[int]]:
    """Groups views by camera and name without its number, and sorts each group by this number."""
    groups: dict[tuple[str, int], list[int]] = {}
    for index, view in enumerate(scene.views):
        before, number, rest = split_last_number(view.name)
        before = before if number else rest
        groups.setdefault((before, view.camera_index), []).append(index)
    ordered = []
    for group in groups.values():
        times = order_frames([scene.views[index].name.rpartition("/")[2] for index in group])
        ordered.append([group[place] for place in np.argsort(times, kind="stable")])
    return ordered


def _choose_pairs(scene: Scene, look: _Look) -> list[tuple[int, int]]:
    groups = order_in_time(scene)
    total = sum(len(group) for group in groups)
    centers = np.array([view.camera_center for view in scene.views])
    pairs = []
    for group in groups:
        anchors = max(1, round(look.anchors * len(group) / total))
        even = np.linspace(0, len(group) - 2, anchors).astype(int)
        for place in np.unique([*even, *_find_jumps(centers[group])]):
            for one, two in look.steps:
                if place >= 0 and place + two < len(group):
                    pairs.append((group[place + one], group[place + two]))
        pairs += _find_loops(scene, group, {view for pair in pairs for view in pair}, look)
    return list(dict.fromkeys(pairs))


def is_loop(first: int, second: int, count: int) -> bool:
    """Returns whether two places of a path of `count` images are far apart on it."""
    return abs(second - first) >= max(2, _LOOP * count)


def _find_loops(
    scene: Scene, group: list[int], used: set[int], look: _Look
) -> list[tuple[int, int]]:
    """Finds images far apart on the path that stand near each other and look the same way.

    Near is what neighbours on the path are that the look compares: so far they see the same. Errors
    that grow along a path, too small between neighbours, are large between these.
    """
    longest = max(two for _, two in look.steps)
    places = [place for place, view in enumerate(group) if view in used]
    if not look.loops or len(group) <= longest:
        return []
    centers = np.array([scene.views[view].camera_center for view in group])
    axes = np.array([scene.views[view].camera_from_world[2, :3] for view in group])
    reach = float(np.median(np.linalg.norm(centers[longest:] - centers[:-longest], axis=1)))
    near = []
    for number, a in enumerate(places):
        for b in places[number + 1 :]:
            distance = float(np.linalg.norm(centers[b] - centers[a]))
            same = axes[a] @ axes[b] > _SAME_DIRECTION
            if is_loop(a, b, len(group)) and same and distance <= reach:
                near.append((distance, a, b))
    count = dict.fromkeys(places, 0)
    found: list[tuple[int, int]] = []
    for _, a, b in sorted(near):
        if len(found) < look.loops and max(count[a], count[b]) < _LOOPS_A_VIEW:
            found.append((group[a], group[b]))
            count[a], count[b] = count[a] + 1, count[b] + 1
    return found


def _find_jumps(centers: np.ndarray) -> list[int]:
    """Lists the places before and at the longest steps of a path: where poses may not fit."""
    steps = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    longest = np.argsort(-steps, kind="stable")[:_JUMPS]
    return [int(place) for step in longest for place in (step - 1, step) if place >= 0]


def _find_features(scene: Scene, index: int, options: PosesOptions) -> Features:
    """Finds features wherever the dataset's mask allows, also where the lens has no ray.

    The lens is under test, so it must not hide pixels.
    """
    view = scene.views[index]
    try:
        pixels = scene.image(index)
        valid = view.valid if view.mask_path is None else decode_mask(view.mask_path)
    except InputError:  # reported by the checks of the files
        pixels, valid = np.zeros((8, 8, 3), np.uint8), None
    return detect_features(pixels, valid, options, _CONTRAST)
