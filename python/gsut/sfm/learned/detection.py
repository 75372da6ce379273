"""Finds learned features in a picture: keypoints and descriptors of the network's maps."""

from __future__ import annotations

import numpy as np

from gsut.sfm.learned.network import CELL, MULTIPLE, Maps, run_network
from gsut.sfm.learned.weights import Weights
from gsut.sfm.photographs import DESCRIPTOR_SCALE, Features, PosesOptions

LONGEST_SIDE = 800  # pixels of the picture that the network sees
_LEAST_SCORE = 0.05  # of a keypoint: the probability that the network was trained to cut at
_SUPPRESSED = 5  # pixels, side of the square in which only the best keypoint stays
_BICUBIC = -0.75  # parameter of the cubic that the descriptors were trained with


def detect_learned(
    weights: Weights,
    pixels: np.ndarray,
    valid: np.ndarray | None = None,
    turns: int = 0,
    most: int = PosesOptions.max_features,
) -> Features:
    """Finds the learned features of a picture.

    Args:
        weights: of the network.
        pixels: (H, W, 3) uint8, red, green, blue.
        valid: (H, W) bool, where features may lie; None: everywhere.
        turns: quarter turns counter-clockwise that put the picture upright for the network; the
            features are those of the picture as it is.
        most: number of features, the best.

    Returns:
        The features, best first, all of one size. Descriptors hold the positive parts of the
        network's 64 values, then the negative parts, so that all are positive like SIFT's, and
        differ by less than the values only where signs do.
    """
    import cv2

    upright = np.ascontiguousarray(np.rot90(pixels, turns))
    scale = min(1.0, LONGEST_SIDE / max(upright.shape))
    tall, wide = (
        max(MULTIPLE, round(scale * side / MULTIPLE) * MULTIPLE) for side in upright.shape[:2]
    )
    maps = run_network(weights, cv2.resize(upright, (wide, tall), interpolation=cv2.INTER_AREA))
    at, scores, offsets = find_keypoints(maps)
    # The network's pixel (0, 0) is the centre of the top-left one.
    inside = (at + offsets + 0.5) * np.array(upright.shape[1::-1]) / np.array([wide, tall])
    height, width = pixels.shape[:2]
    own = _turn_back(inside, turns, width, height)
    corner = np.clip(own.astype(int), 0, [width - 1, height - 1])
    if valid is not None:
        scores = np.where(valid[corner[:, 1], corner[:, 0]], scores, 0)
    best = np.argsort(-scores, kind="stable")[: min(most, np.count_nonzero(scores))]
    values = sample_descriptors(maps, at[best])
    split = np.maximum(np.concatenate([values, -values], axis=1), 0)
    return Features(
        own[best],
        np.full(len(best), CELL / scale, np.float32),
        np.minimum(np.rint(DESCRIPTOR_SCALE * split), 255).astype(np.uint8),
        pixels[corner[best, 1], corner[best, 0]],
        np.ones(len(best), bool),
    )


def find_keypoints(maps: Maps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds the keypoints of the maps.

    Returns:
        (N, 2) int pixels, x and y from 0, row by row; (N,) float32 scores, the product of the
        keypoint's probability and the reliability there; and (N, 2) the offset of the maximum of a
        parabola through the logarithms of the probabilities of the pixel and its neighbours.
    """
    import cv2

    logits = maps.keypoints
    share = np.exp(logits - logits.max(axis=0))
    share = (share / share.sum(axis=0))[:-1]
    _, rows, columns = share.shape
    split = share.reshape(CELL, CELL, rows, columns).transpose(2, 0, 3, 1)
    heat = np.ascontiguousarray(split.reshape(CELL * rows, CELL * columns))
    highest = cv2.dilate(heat, np.ones((_SUPPRESSED, _SUPPRESSED), np.uint8))
    y, x = np.nonzero((heat == highest) & (heat > _LEAST_SCORE))
    at = np.stack([x, y], axis=1)
    trust = _sample(maps.reliability[None], at, _weigh_linear)[:, 0]
    logarithm = np.pad(np.log(np.maximum(heat, 1e-12)), 1, mode="edge")
    x, y = x + 1, y + 1
    offsets = np.stack(
        [
            _find_peak(logarithm[y, x - 1], logarithm[y, x], logarithm[y, x + 1]),
            _find_peak(logarithm[y - 1, x], logarithm[y, x], logarithm[y + 1, x]),
        ],
        axis=1,
    )
    return at, heat[y - 1, x - 1] * trust, offsets


def _find_peak(before: np.ndarray, here: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Returns the place, within half a step of 0, of a parabola's maximum given at -1, 0 and 1."""
    curvature = before + after - 2 * here
    peak = 0.5 * (before - after) / np.where(curvature < 0, curvature, -np.inf)
    return np.clip(peak, -0.5, 0.5)


def sample_descriptors(maps: Maps, at: np.ndarray) -> np.ndarray:
    """Returns (N, 64) descriptors of unit length at pixels (N, 2)."""
    each = np.linalg.norm(maps.descriptors, axis=0)
    values = _sample(maps.descriptors / np.maximum(each, 1e-12), at, _weigh_cubic)
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


def _sample(maps: np.ndarray, at: np.ndarray, weigh) -> np.ndarray:
    """Samples maps (C, H, W) at pixels (N, 2) of the picture; (N, C). Beyond the edge is 0.

    The last pixel lies one whole picture behind the first, as in training.
    """
    _, height, width = maps.shape
    size = np.array([width, height])
    place = at * (size / (CELL * size - 1)) - 0.5
    first = np.floor(place).astype(int)
    weights = weigh(place - first)  # (K, N, 2)
    reach = len(weights) // 2
    padded = np.pad(maps, ((0, 0), (reach, reach), (reach, reach)))
    total = np.zeros((len(at), len(maps)), np.float32)
    for row, by_row in enumerate(weights):
        for column, by_column in enumerate(weights):
            x, y = (first + np.array([column, row]) + 1).T
            total += (by_row[:, 1] * by_column[:, 0])[:, None] * padded[:, y, x].T
    return total


def _weigh_linear(t: np.ndarray) -> np.ndarray:
    """Returns the weights (2, ...) of the neighbours at 0 and 1 of places t in [0, 1)."""
    return np.stack([1 - t, t])


def _weigh_cubic(t: np.ndarray) -> np.ndarray:
    """Returns the weights (4, ...) of the neighbours at -1, 0, 1 and 2 of places t in [0, 1).

    Source: Keys, "Cubic convolution interpolation for digital image processing", 1981.
    """
    a = _BICUBIC

    def weigh_near(s: np.ndarray) -> np.ndarray:
        return ((a + 2) * s - (a + 3)) * s * s + 1

    def weigh_far(s: np.ndarray) -> np.ndarray:
        return ((a * s - 5 * a) * s + 8 * a) * s - 4 * a

    return np.stack([weigh_far(1 + t), weigh_near(t), weigh_near(1 - t), weigh_far(2 - t)])


def _turn_back(at: np.ndarray, turns: int, width: int, height: int) -> np.ndarray:
    """Converts pixels (N, 2) of a picture turned counter-clockwise to those of the picture."""
    x, y = at.T
    turned = [(x, y), (width - y, x), (width - x, height - y), (y, height - x)][turns % 4]
    return np.stack(turned, axis=1)
