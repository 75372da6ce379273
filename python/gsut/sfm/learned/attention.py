"""Matches learned features of two pictures by the attention network LighterGlue.

Source: Lindenberger, Sarlin and Pollefeys, "LightGlue: Local Feature Matching at Light Speed", ICCV
2023, with the weights that Potje et al. trained for XFeat: six layers, one head of 96 channels.
"""

from __future__ import annotations

import math

import numpy as np

from gsut.sfm.learned.network import ALONE
from gsut.sfm.learned.weights import VARIANCE_FLOOR, Weights
from gsut.sfm.photographs import Features

MOST_MATCHED = 1000  # features of a picture, the best: the cost grows with the square
_LEAST_CERTAINTY = 0.1  # of a match: the probability at which the authors cut
# Rows, columns and inner terms of a block of a product; see `ALONE`.
_BLOCK = round(ALONE ** (1 / 3))


def match_by_attention(
    weights: Weights, one: Features, other: Features, turns: tuple[int, int] = (0, 0)
) -> np.ndarray:
    """Matches the best MOST_MATCHED learned features of two pictures.

    Args:
        weights: of the matcher.
        one, other: learned features, best first.
        turns: quarter turns counter-clockwise that put each picture upright.

    Returns:
        (M, 2) int32, feature of the one and of the other picture, most certain first.
    """
    if min(len(one), len(other)) < 2:
        return np.zeros((0, 2), np.int32)
    both = one, other
    x = [_apply(weights, _restore_values(each), "input_proj") for each in both]
    waves = [_encode_places(weights, e, turn) for e, turn in zip(both, turns, strict=True)]
    layers = weights.count_layers("transformers")
    for layer in range(layers):
        name = f"transformers.{layer}"
        x = [
            _add_self_attention(weights, *each, f"{name}.self_attn")
            for each in zip(x, waves, strict=True)
        ]
        x = _add_cross_attention(weights, x, f"{name}.cross_attn")
    return _assign(weights, x, f"log_assignment.{layers - 1}")


def _restore_values(features: Features) -> np.ndarray:
    """Returns (N, 64) descriptors of unit length, of their positive and negative parts."""
    positive, negative = np.split(features.descriptors[:MOST_MATCHED].astype(np.float32), 2, axis=1)
    values = positive - negative
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


def _encode_places(weights: Weights, features: Features, turns: int) -> np.ndarray:
    """Returns the cosines and sines (2, N, 96) that turn pairs of channels by their place.

    Attention depends on differences of places only, in units of half the picture's longer side,
    which is that of the box around the features.
    """
    at = features.pixels[:MOST_MATCHED]
    x, y = ((at - at.mean(axis=0)) / (0.5 * max(np.ptp(at, axis=0).max(), 1.0))).T
    for _ in range(turns % 4):
        x, y = y, -x
    angles = _multiply(np.stack([x, y], axis=1).astype(np.float32), weights.read("posenc.Wr", 2).T)
    return np.repeat(np.stack([np.cos(angles), np.sin(angles)]), 2, axis=2)


def _add_self_attention(
    weights: Weights, x: np.ndarray, waves: np.ndarray, name: str
) -> np.ndarray:
    """Adds to features (N, 96) what they learn of the others in their picture."""
    query, key, value = np.moveaxis(_apply(weights, x, f"{name}.Wqkv").reshape(*x.shape, 3), 2, 0)
    query, key = (_rotate(each, waves) for each in (query, key))
    share = _compute_softmax(_multiply(query, key.T) / np.float32(math.sqrt(x.shape[1])))
    message = _apply(weights, _multiply(share, value), f"{name}.out_proj")
    return _add_message(weights, x, message, name)


def _add_cross_attention(weights: Weights, x: list[np.ndarray], name: str) -> list[np.ndarray]:
    """Adds to features of both pictures what they learn of those of the other."""
    one, other = (_apply(weights, each, f"{name}.to_qk") for each in x)
    values = [_apply(weights, each, f"{name}.to_v") for each in x]
    likeness = _multiply(one, other.T) / np.float32(math.sqrt(one.shape[1]))
    shares = _compute_softmax(likeness), _compute_softmax(likeness.T)
    read = [_multiply(shares[0], values[1]), _multiply(shares[1], values[0])]
    return [
        _add_message(weights, own, _apply(weights, each, f"{name}.to_out"), name)
        for own, each in zip(x, read, strict=True)
    ]


def _add_message(weights: Weights, x: np.ndarray, message: np.ndarray, name: str) -> np.ndarray:
    """Adds to features (N, 96) what two layers make of them and a message."""
    hidden = _apply(weights, np.concatenate([x, message], axis=1), f"{name}.ffn.0")
    hidden -= hidden.mean(axis=1, keepdims=True)
    hidden /= np.sqrt(hidden.var(axis=1, keepdims=True) + VARIANCE_FLOOR)
    scale, bias = weights.read(f"{name}.ffn.1", 1)[:, 0], weights.read_bias(f"{name}.ffn.1")
    hidden = hidden * scale + bias
    hidden *= 0.5 * (1 + _compute_erf(hidden * np.float32(math.sqrt(0.5))))
    return x + _apply(weights, hidden, f"{name}.ffn.3")


def _assign(weights: Weights, x: list[np.ndarray], name: str) -> np.ndarray:
    """Returns the features of both that are each other's most certain match."""
    one, other = (
        _apply(weights, each, f"{name}.final_proj") / np.float32(each.shape[1] ** 0.25)
        for each in x
    )
    can = [-np.logaddexp(0, -_apply(weights, each, f"{name}.matchability")) for each in x]
    likeness = _multiply(one, other.T)
    certainty = 2 * likeness - _sum_logarithms(likeness, 1) - _sum_logarithms(likeness, 0)
    certainty += can[0] + can[1].T
    best, back = certainty.argmax(axis=1), certainty.argmax(axis=0)
    first = np.flatnonzero(back[best] == np.arange(len(best)))
    sure = certainty[first, best[first]]
    order = np.argsort(-sure, kind="stable")[: np.count_nonzero(sure > math.log(_LEAST_CERTAINTY))]
    return np.stack([first[order], best[first[order]]], axis=1).astype(np.int32)


def _apply(weights: Weights, x: np.ndarray, name: str) -> np.ndarray:
    """Applies a linear layer to features (N, C)."""
    return _multiply(x, weights.read(name, x.shape[1]).T) + weights.read_bias(name)


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the product (n, m) of a (n, k) and b (k, m), block by block."""
    n, m = len(a), b.shape[1]
    rows, columns = -(-n // _BLOCK), -(-m // _BLOCK)
    total = np.zeros((rows, columns, _BLOCK, _BLOCK), np.float32)
    for at in range(0, a.shape[1], _BLOCK):
        part = slice(at, at + _BLOCK)
        left = np.zeros((rows * _BLOCK, a[:, part].shape[1]), np.float32)
        right = np.zeros((len(b[part]), columns * _BLOCK), np.float32)
        left[:n], right[:, :m] = a[:, part], b[part]
        by_columns = right.reshape(-1, columns, _BLOCK).transpose(1, 0, 2)
        total += left.reshape(rows, 1, _BLOCK, -1) @ np.ascontiguousarray(by_columns)
    return total.transpose(0, 2, 1, 3).reshape(rows * _BLOCK, columns * _BLOCK)[:n, :m]


def _rotate(x: np.ndarray, waves: np.ndarray) -> np.ndarray:
    """Turns pairs of neighbouring channels of x (N, 96) by their angles."""
    across = np.stack([-x[:, 1::2], x[:, ::2]], axis=2).reshape(x.shape)
    return x * waves[0] + across * waves[1]


def _compute_softmax(x: np.ndarray) -> np.ndarray:
    """Returns the exponentials of the rows of x, over their sums."""
    share = np.exp(x - x.max(axis=1, keepdims=True))
    return share / share.sum(axis=1, keepdims=True)


def _sum_logarithms(x: np.ndarray, axis: int) -> np.ndarray:
    """Returns the logarithm of the sum of the exponentials of x along an axis, which stays."""
    most = x.max(axis=axis, keepdims=True)
    return most + np.log(np.exp(x - most).sum(axis=axis, keepdims=True))


def _compute_erf(x: np.ndarray) -> np.ndarray:
    """Returns the error function to 1.5e-7 (Abramowitz and Stegun, 7.1.26)."""
    t = 1 / (1 + np.float32(0.3275911) * np.abs(x))
    series = np.zeros_like(x)
    for factor in (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592):
        series = (series + np.float32(factor)) * t
    return np.copysign(1 - series * np.exp(-x * x), x)
