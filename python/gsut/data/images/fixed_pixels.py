"""Finds pixels that show the same in all pictures while the scene moves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gsut.lens import Camera

COMPARED_SIDE = 400  # pixels of the longer side of compared pictures: a clock's frame is wider
FEWEST_COMPARED = 6  # pictures: fewer agree by chance
_SAME = 10  # grey levels: compression and noise of one colour
_LEAST_AREA = 1e-3  # of the picture: smaller marks cost little
# Width over the diagonal of the ring about a patch where the scene moves, and the largest share of
# the ring that most pictures agree in. A sky's edge differs from picture to picture, so that most
# of them agree about the patch that all agree in.
_RING = 0.015
_CALM = 0.35
_BLACK = 16  # grey levels: what a lens' circle and bars leave dark, with noise
# Share of the ring, over all pictures, in the patch's colour beyond which that is a background:
# beside a lens' circle and bars it is at most 0.09, in dark rooms too, about objects before black
# at least 0.14.
_GOES_ON = 0.11
_MOST_FIXED = 0.8  # of the picture: beyond that the camera stood still
# Share of the pictures from which a step of brightness stays in its place, and of the outline of a
# mark that such steps make.
_PERSISTS = 0.9
_FEW_PERSIST = 0.01  # share of the other pixels with such a step: fewer are few by chance
# Nats a pixel of the outline from which it is a mark's: 1.6 about still things at most, from 2.2 on
# about marks whose ring does not show them.
_SURE_OF_STEPS = 2.0
_FILLED = 0.25  # area of a hole, such as a clock's digits, over that of the patch around it


def describe_fixed_pixels(share: float) -> str:
    """Says that fixed pixels take this share of a picture; the sentence goes on with what is
    done about it."""
    return (
        f"{100 * share:.0f} % of the picture shows the same in all images while the scene "
        "moves, as the black around a lens' circle, bars or a logo do"
    )


def find_fixed_pixels(pictures: np.ndarray, far_moves: bool | None = None) -> np.ndarray:
    """Finds patches that are alike in all pictures while the scene moves.

    A patch ends at the same pixels in all pictures: right beside it most of them differ, or a step
    of brightness stays that stays nowhere else. Beside black that takes all corners it suffices
    that most are bright, as before a plain wall.

    Args:
        pictures: (N, H, W, 3) uint8.
        far_moves: whether what is far moves, as by a camera that turns; False: only black counts;
            None: not known, so that steps do not count.

    Returns:
        (H, W) bool, True where pixels are fixed.
    """
    middle = np.median(pictures, axis=0)
    apart = np.abs(pictures - middle).max(axis=3)
    alike = (apart.max(axis=0) <= _SAME).astype(np.uint8)
    mostly = np.median(apart, axis=0) <= _SAME
    is_bright = middle.max(axis=2) > _BLACK + _SAME
    fixed = np.zeros(alike.shape, bool)
    steps = _find_steps(pictures) if far_moves else np.zeros_like(fixed)
    patches = [*_list_patches(alike), *(_list_patches(alike, steps) if far_moves else ())]
    for patch, ring in patches if far_moves is not False else ():
        is_apart = mostly[ring].mean() < _CALM or (
            far_moves and _weigh_steps(steps, patch, alike) > _SURE_OF_STEPS
        )
        if is_apart and not _is_background(pictures, patch, ring):
            fixed |= patch
    dark = alike & (middle.max(axis=2) <= _BLACK)
    if _take_corners(dark).all():  # as about a circle and beside bars
        for patch, ring in _list_patches(dark):
            is_step = is_bright[ring].mean() > 1 - _CALM
            if _take_corners(patch).any() and is_step and not _is_background(pictures, patch, ring):
                fixed |= patch
    return fixed if fixed.mean() < _MOST_FIXED else np.zeros_like(fixed)


def _find_steps(pictures: np.ndarray) -> np.ndarray:
    """Finds (H, W) where brightness steps the same way in nearly all pictures."""
    import cv2

    smooth = np.stack([cv2.GaussianBlur(picture, (0, 0), 0.8) for picture in pictures])
    across, down = np.zeros((2, *smooth.shape), np.int16)
    across[:, :, 1:-1] = smooth[:, :, 2:].astype(np.int16) - smooth[:, :, :-2]
    down[:, 1:-1] = smooth[:, 2:].astype(np.int16) - smooth[:, :-2]
    right, below = across.mean(axis=0), down.mean(axis=0)
    length = np.maximum(np.hypot(right, below), 1.0)
    along = (across * right + down * below) / length
    return ((along > 2 * _SAME).mean(axis=0) > _PERSISTS).any(axis=2)


def _weigh_steps(steps: np.ndarray, patch: np.ndarray, alike: np.ndarray) -> float:
    """Returns nats, a pixel of a patch's outline, by which steps speak for a mark."""
    import cv2

    near = cv2.dilate(steps.astype(np.uint8), np.ones((3, 3))) > 0
    core = cv2.erode(patch.astype(np.uint8), np.ones((5, 5)), borderValue=1)
    outline = core > cv2.erode(core, np.ones((3, 3)), borderValue=1)
    others = (cv2.dilate(patch.astype(np.uint8), np.ones((9, 9))) == 0) & (alike == 0)
    if not (outline.any() and others.any()):
        return -np.inf
    stay = near[outline].mean()
    usual = float(np.clip(near[others].mean(), _FEW_PERSIST, _PERSISTS))
    with_mark = np.log([_PERSISTS / usual, (1 - _PERSISTS) / (1 - usual)])
    return float(with_mark @ [stay, 1 - stay])


def _list_patches(
    alike: np.ndarray, steps: np.ndarray | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Lists the connected patches of pixels (H, W), and the ring about each, both (H, W) bool.

    steps: (H, W) bool that divide patches.
    """
    import cv2

    pixels = alike if steps is None else alike & ~steps
    width = max(2, round(_RING * np.hypot(*pixels.shape)))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1, 2 * width + 1))
    edge = cv2.getStructuringElement(cv2.MORPH_RECT, (5, 5))  # blurred by lens and compression
    count, labels, rows, _ = cv2.connectedComponentsWithStats(pixels)
    for number in range(1, count):
        area = rows[number, cv2.CC_STAT_AREA]
        if area < _LEAST_AREA * pixels.size:
            continue
        patch = (labels == number).astype(np.uint8)
        if steps is not None:  # which are as wide as what they are found by
            patch |= cv2.dilate(patch, np.ones((5, 5))) & alike
        patch = _fill_holes(patch, _FILLED * area)
        near = cv2.dilate(patch, edge)
        ring = (cv2.dilate(near, disk) > 0) & (near == 0)
        if ring.any():
            yield near > 0, ring


def _is_background(pictures: np.ndarray, patch: np.ndarray, ring: np.ndarray) -> bool:
    """Returns whether a patch at the corners goes on beside itself in many pictures, as behind an
    object that was taken before a plain background."""
    colors = np.median(pictures[:, patch], axis=1, keepdims=True)  # exposures differ
    goes_on = np.abs(pictures[:, ring] - colors).max(axis=2) <= 2 * _SAME
    return bool(_take_corners(patch).any() and goes_on.mean() > _GOES_ON)


def _take_corners(picture: np.ndarray) -> np.ndarray:
    return picture[[0, 0, -1, -1], [0, -1, 0, -1]]


def _fill_holes(patch: np.ndarray, largest: float) -> np.ndarray:
    """Fills the holes of a patch up to this area in pixels."""
    import cv2

    _, labels, rows, _ = cv2.connectedComponentsWithStats(1 - patch)
    small = np.flatnonzero(rows[:, cv2.CC_STAT_AREA] <= largest)
    return patch | np.isin(labels, small[small > 0]).astype(np.uint8)


def is_shown(camera: Camera, fixed: np.ndarray) -> bool:
    """Returns whether most fixed pixels have a ray: otherwise the lens leaves them out."""
    has_ray = np.asarray(camera.resize(*fixed.shape[::-1]).rays()[1])
    return bool(2 * np.count_nonzero(fixed & has_ray) >= np.count_nonzero(fixed))
