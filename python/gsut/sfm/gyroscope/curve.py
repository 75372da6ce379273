"""Integrates recorded rates: how the sensor is turned at any time, and what its errors change."""

from __future__ import annotations

import dataclasses

import numpy as np

from gsut.gaussians import rotations_from_quaternions


@dataclasses.dataclass(frozen=True)
class Turns:
    """How the sensor turned between pairs of times.

    Attributes:
        rotations: (P, 3, 3) sensor at the end from sensor at the beginning; NaN: not recorded.
        by_bias: (P, 3, 3) derivative of a turn (exp(d) rotation) by a bias of the rates.
        by_offset: (P, 3) the same by a delay of both times.
    """

    rotations: np.ndarray
    by_bias: np.ndarray
    by_offset: np.ndarray


class TurnCurve:
    """Orientations of a sensor over time: its rates, less a bias, integrated.

    Args:
        rates: (N, 4) seconds and rad/s, each of which holds until the next row; NaN: not known.
        bias: (3,) rad/s.
    """

    def __init__(self, rates: np.ndarray, bias: np.ndarray) -> None:
        self._times = rates[:, 0]
        known = np.isfinite(rates).all(axis=1)
        self._rates = np.where(known[:, None], rates[:, 1:] - bias, 0.0)
        self._unknown = np.concatenate([[0], np.cumsum(~known[:-1])])
        steps = np.diff(self._times)
        # Quaternions multiplied up in log2(N) rounds over all rows.
        self._turned = np.zeros((len(rates), 4))
        self._turned[:, 0] = 1.0
        self._turned[1:] = exp_quaternions(self._rates[:-1] * steps[:, None])
        reach = 1
        while reach < len(rates):
            self._turned[reach:] = multiply(self._turned[:-reach], self._turned[reach:])
            reach *= 2
        middle = multiply(self._turned[:-1], exp_quaternions(self._rates[:-1] * steps[:, None] / 2))
        by_bias = np.cumsum(rotations_from_quaternions(middle) * steps[:, None, None], axis=0)
        self._by_bias = np.concatenate([np.zeros((1, 3, 3)), by_bias])

    def find_turns(self, begin: np.ndarray, end: np.ndarray) -> Turns:
        """Finds the turns between pairs of times (P,) in seconds."""
        (row_a, world_a, bias_a), (row_b, world_b, bias_b) = map(self._look_up, (begin, end))
        back = world_b.transpose(0, 2, 1)
        rotations = back @ world_a
        known = self._unknown[row_b + 1] == self._unknown[row_a]
        known &= (begin >= self._times[0]) & (end <= self._times[-1]) & (begin < end)
        rotations = np.where(known[:, None, None], rotations, np.nan)
        by_offset = np.einsum("pij,pj->pi", rotations, self._rates[row_a]) - self._rates[row_b]
        return Turns(rotations, back @ (bias_b - bias_a), by_offset)

    def _look_up(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Finds rows of times, and there world_from_sensor and its integral."""
        row = np.clip(np.searchsorted(self._times, times, "right") - 1, 0, len(self._times) - 2)
        part = times - self._times[row]
        turned = multiply(self._turned[row], exp_quaternions(self._rates[row] * part[:, None]))
        share = np.clip(part / np.diff(self._times)[row], 0, 1)[:, None, None]
        integral = self._by_bias[row] + share * (self._by_bias[row + 1] - self._by_bias[row])
        return row, rotations_from_quaternions(turned), integral


def exp_quaternions(vectors: np.ndarray) -> np.ndarray:
    """Converts rotation vectors (N, 3) to quaternions (N, 4) w, x, y, z."""
    half = np.linalg.norm(vectors, axis=1, keepdims=True) / 2
    return np.concatenate([np.cos(half), np.sinc(half / np.pi) * vectors / 2], axis=1)


def multiply(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Multiplies quaternions (N, 4) row by row."""
    w, x, y, z = first.T
    a, b, c, d = second.T
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=1,
    )
