"""Numbers as compressed formats keep them: bytes, small rotations, codebooks, an order in space."""

from __future__ import annotations

import math

import numpy as np

# Stands for the logit of opacities 0 and 1, as in `load_ply`.
_MOST_LOGIT = 20.0
_SQRT2 = math.sqrt(2.0)
# The components beside the largest one, whichever that is.
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def opacity_from_logits(logits: np.ndarray) -> np.ndarray:
    """Converts logits to float32 opacities in [0, 1]."""
    return (1.0 / (1.0 + np.exp(-logits.astype(np.float64)))).astype(np.float32)


def logits_from_opacity(opacities: np.ndarray) -> np.ndarray:
    """Converts opacities to float32 logits of at most 20 in size."""
    values = np.clip(opacities.astype(np.float64), 0.0, 1.0)
    with np.errstate(divide="ignore"):
        logits = np.log(values) - np.log1p(-values)
    return np.clip(logits, -_MOST_LOGIT, _MOST_LOGIT).astype(np.float32)


def to_bytes(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Rounds values on a scale of 0 to 255 to uint8 and counts those outside it."""
    rounded = np.rint(values)
    beyond = int(np.count_nonzero((rounded < 0) | (rounded > 255)))
    return np.clip(rounded, 0, 255).astype(np.uint8), beyond


def normalize_quats(quats: np.ndarray) -> np.ndarray:
    """Normalizes quaternions (N, 4) to norm 1 and w >= 0."""
    q = quats.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0, -q, q)


def drop_largest(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Encodes a rotation by the index of its largest component and the other three times sqrt 2.

    Args:
        quats: (N, 4) in any order of the components, any norm > 0.

    Returns:
        (N,) the place, 0 to 3; (N, 3) the others in their order, in [-1, 1], for the sign that
        makes the largest one positive.
    """
    q = normalize_quats(quats)
    largest = np.argmax(np.abs(q), axis=1)
    rows = np.arange(len(q))
    q *= np.where(q[rows, largest] < 0, -1.0, 1.0)[:, None]
    return largest, np.clip(q[rows[:, None], _OTHERS[largest]] * _SQRT2, -1.0, 1.0)


def restore_largest(largest: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Decodes float32 unit quaternions (N, 4) from `drop_largest`."""
    q = np.empty((len(others), 4))
    rest = others / _SQRT2
    rows = np.arange(len(q))
    q[rows[:, None], _OTHERS[largest]] = rest
    q[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - np.sum(rest * rest, axis=1)))
    return q.astype(np.float32)


def build_codebook(values: np.ndarray) -> np.ndarray:
    """Builds the best 256 values to represent many (Lloyd's algorithm in one dimension).

    Args:
        values: of any shape, at least one.

    Returns:
        (256,) float32, rising; starts from equal shares of values and of their range.
    """
    data = np.sort(values.astype(np.float64), axis=None)
    shares = data[np.linspace(0, len(data) - 1, 128).astype(np.int64)]
    centers = np.sort(np.concatenate([shares, np.linspace(data[0], data[-1], 128)]))
    sums = np.concatenate([[0.0], np.cumsum(data)])
    for _ in range(20):
        ends = np.searchsorted(data, 0.5 * (centers[1:] + centers[:-1]))
        bounds = np.concatenate([[0], ends, [len(data)]])
        counts = np.diff(bounds)
        means = np.diff(sums[bounds]) / np.maximum(counts, 1)
        moved = np.where(counts > 0, means, centers)
        if np.array_equal(moved, centers):
            break
        centers = np.sort(moved)
    return centers.astype(np.float32)


def find_nearest_entries(values: np.ndarray, book: np.ndarray) -> np.ndarray:
    """Finds the uint8 index of the nearest entry of a rising codebook for each value."""
    middles = 0.5 * (book[1:].astype(np.float64) + book[:-1])
    return np.searchsorted(middles, values.astype(np.float64)).astype(np.uint8)
