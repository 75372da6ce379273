"""Tries hypotheses about what is given: a table of rows over one rating."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from gsut.lens import Camera

_FINEST = 1 / 16  # of the first step: where a climb ends


@dataclasses.dataclass(frozen=True, eq=False)
class Dataset:
    """What a hypothesis may change.

    Args:
        poses: (V, B, 4, 4) world_from_camera, one a view or one for each of B moments of a readout.
        cameras: the lenses.
        lens: (V,) index of each view's lens.
        file_axes: (3, 3) camera axes in which the dataset's file names poses.
        paths: views in the order of time, a list for each camera.
    """

    poses: np.ndarray
    cameras: tuple[Camera, ...]
    lens: np.ndarray
    file_axes: np.ndarray
    paths: list[list[int]]

    def move(self, rotation: np.ndarray, center: np.ndarray) -> Dataset:
        """Returns the dataset with other poses, of rotations (V, B, 3, 3) and centres."""
        poses = self.poses.copy()
        poses[..., :3, :3], poses[..., :3, 3] = rotation, center
        return dataclasses.replace(self, poses=poses)

    def place(self, poses: np.ndarray) -> Dataset:
        """Returns the dataset with other poses (V, B, 4, 4)."""
        return dataclasses.replace(self, poses=poses)

    def equip(self, cameras: Sequence[Camera | None]) -> Dataset | None:
        """Returns the dataset with other lenses; None if one is missing, or none differs."""
        known = tuple(camera for camera in cameras if camera is not None)
        if len(known) < len(self.cameras) or known == self.cameras:
            return None
        return dataclasses.replace(self, cameras=known)


Numbers = Sequence[float] | np.ndarray
# Scores of a dataset (G,): nats a match, of each group of images.
Rate = Callable[[Dataset], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Variant:
    """What a hypothesis supposes.

    Args:
        words, edit: fill the braces of the hypothesis's sentence and cure.
        data: the dataset, if it is so.
    """

    words: str
    edit: str
    data: Dataset


Variants = Iterator[Variant]


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """One way in which a dataset may be wrong.

    Args:
        sentence: completes "the photographs fit ...".
        cure: the edit that mends the data.
        subject: "poses" or "lens".
        suppose: yields what may have been meant; may climb by the rating that it gets.
        is_gross: if it is so, the given dataset explains little.
        is_everywhere: if it is so, every group of images that it touches fits better by it; where
            some do not, only much that it explains shows it, or another hypothesis.
        free: number of the numbers that it estimates.
    """

    sentence: str
    cure: str
    subject: str
    suppose: Callable[[Dataset, Rate], Iterable[Variant]]
    is_gross: bool = False
    is_everywhere: bool = False
    free: int = 0


def climb(
    suppose: Callable[[np.ndarray], Dataset | None],
    rate: Rate,
    starts: Iterable[Numbers],
    steps: Numbers,
) -> np.ndarray:
    """Searches the numbers with which a dataset scores best, by ever smaller steps.

    Args:
        suppose: makes the dataset of numbers (N,); None: there is none.
        rate: scores it.
        starts: the best of them is where the search starts.
        steps: (N,) the first steps.
    """

    def rate_numbers(x: np.ndarray) -> float:
        data = suppose(x)
        return -np.inf if data is None else float(np.mean(rate(data)))

    tried = [(rate_numbers(np.array(start, float)), tuple(start)) for start in starts]
    best, x = max(tried)[0], np.array(max(tried)[1], float)
    size = 1.0
    while size >= _FINEST:
        before = best
        for axis in range(len(x)):
            for sign in (-size, size):
                trial = x.copy()
                trial[axis] += sign * steps[axis]
                found = rate_numbers(trial)
                if found > best:
                    best, x = found, trial
        if best == before:
            size /= 2
    return x


def find_best_variants(
    hypotheses: Sequence[Hypothesis], given: Dataset, rate: Rate, is_poor: bool
) -> Iterator[tuple[Hypothesis, Variant]]:
    """Yields the best variant of each hypothesis that scores better than what is given.

    Args:
        hypotheses: the rows.
        given: the dataset.
        rate: scores a dataset.
        is_poor: the given dataset explains so little that gross mistakes are possible.
    """
    base = float(np.mean(rate(given)))
    for hypothesis in hypotheses:
        if is_poor or not hypothesis.is_gross:
            rated = [
                (float(np.mean(rate(variant.data))), variant)
                for variant in hypothesis.suppose(given, rate)
            ]
            value, best = max(rated, key=lambda each: each[0], default=(base, None))
            if best is not None and value > base:
                yield hypothesis, best
