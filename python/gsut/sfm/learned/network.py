"""Runs the feature network XFeat by products of matrices.

Source: Potje, Cadar, Araujo, Martins and Nascimento, "XFeat: Accelerated Features for Lightweight
Image Matching", CVPR 2024.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.sfm.learned.weights import VARIANCE_FLOOR, Weights

CELL = 8  # pixels of a cell of the maps
MULTIPLE = 32  # of which the sides of a picture are multiples: the coarsest level has one cell each
# Multiplications up to which OpenBLAS uses one thread, and so gives the same bits on any number.
ALONE = 2**18


@dataclasses.dataclass(frozen=True)
class Maps:
    """What the network says of a picture of H x W pixels, by cells of CELL x CELL.

    Args:
        descriptors: (64, H / 8, W / 8) float32, of any length.
        keypoints: (65, H / 8, W / 8) float32 logits: of each pixel of the cell, row by row, and of
            no keypoint.
        reliability: (H / 8, W / 8) float32 in [0, 1], how well a descriptor will match.
    """

    descriptors: np.ndarray
    keypoints: np.ndarray
    reliability: np.ndarray


def run_network(weights: Weights, picture: np.ndarray) -> Maps:
    """Runs the network.

    Args:
        weights: of the network.
        picture: (H, W, 3) of any numeric type, red, green, blue; H and W multiples of MULTIPLE.

    Returns:
        The maps; the same bits on any number of threads.
    """

    def apply(x: np.ndarray, name: str, strides: tuple[int, ...]) -> np.ndarray:
        for layer, stride in enumerate(strides):
            x = _convolve(x, *weights.read_layer(f"{name}.{layer}", len(x)), stride)
            np.maximum(x, 0, out=x)
        return x

    def apply_last(x: np.ndarray, name: str) -> np.ndarray:
        return _convolve(x, *weights.read_layer(name, len(x)), 1)

    grey = picture.astype(np.float32).mean(axis=2)
    grey = (grey - grey.mean()) / np.sqrt(grey.var() + VARIANCE_FLOOR)
    quarter = _split_cells(grey, 4).mean(axis=0)[None]
    fine = apply(grey[None], "block1", (1, 2, 1, 2)) + apply_last(quarter, "skip1.1")
    eighth = apply(apply(fine, "block2", (1, 1)), "block3", (2, 1, 1))
    sixteenth = apply(eighth, "block4", (2, 1, 1))
    coarse = apply(sixteenth, "block5", (2, 1, 1, 1))
    joined = eighth + _scale_up(sixteenth, 2) + _scale_up(coarse, 4)
    descriptors = apply_last(apply(joined, "block_fusion", (1, 1)), "block_fusion.2")
    trust = apply_last(apply(descriptors, "heatmap_head", (1, 1)), "heatmap_head.2")
    keypoints = apply(_split_cells(grey, CELL), "keypoint_head", (1, 1, 1))
    return Maps(descriptors, apply_last(keypoints, "keypoint_head.3"), 1 / (1 + np.exp(-trust[0])))


def _convolve(x: np.ndarray, kernels: np.ndarray, bias: np.ndarray, stride: int) -> np.ndarray:
    """Convolves (C, H, W) with (O, C, K, K); zeros around, so that stride 1 keeps the size."""
    size = kernels.shape[2]
    margin = size // 2
    padded = np.pad(x, ((0, 0), (margin, margin), (margin, margin)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size), (1, 2))
    windows = windows[:, ::stride, ::stride]
    height, width = windows.shape[1:3]
    columns = windows.transpose(0, 3, 4, 1, 2).reshape(kernels[0].size, -1)
    product = _multiply(kernels.reshape(len(kernels), -1), columns)
    return (product + bias[:, None]).reshape(len(kernels), height, width)


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the product (i, k) of a (i, j) and b (j, k), in parts of `ALONE`."""
    product = np.empty((len(a), b.shape[1]), np.float32)
    step = max(1, ALONE // a.size)
    for at in range(0, b.shape[1], step):
        product[:, at : at + step] = a @ b[:, at : at + step]
    return product


def _split_cells(grey: np.ndarray, cell: int) -> np.ndarray:
    """Stacks the pixels (H, W) of each cell row by row: (cell * cell, H / cell, W / cell)."""
    height, width = grey.shape
    split = grey.reshape(height // cell, cell, width // cell, cell)
    return split.transpose(1, 3, 0, 2).reshape(cell * cell, height // cell, width // cell)


def _scale_up(x: np.ndarray, factor: int) -> np.ndarray:
    """Interpolates channels (C, H, W) bilinearly at `factor` times their size."""
    import cv2

    size = (factor * x.shape[2], factor * x.shape[1])
    return np.stack([cv2.resize(channel, size, interpolation=cv2.INTER_LINEAR) for channel in x])
