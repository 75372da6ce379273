"""Gains of views that were not compared, from those of their neighbours in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.data.scene import split_last_number


def interpolate_gains(
    log_gains: np.ndarray, known: Sequence[int], names: Sequence[str], groups: Sequence[int]
) -> np.ndarray:
    """Interpolates the log-gains of unknown views between their neighbours in time.

    Args:
        log_gains: (V, 3); rows of `known` count.
        known: views.
        names: of the V views, whose numbers give their order in time.
        groups: (V,) the camera of each view: only views of one camera are neighbours. A view
            without any has a gain of 1.

    Returns:
        (V, 3).
    """
    out = np.zeros_like(log_gains)
    cameras = np.asarray(groups)
    for camera in np.unique(cameras):
        rows = np.flatnonzero(cameras == camera)
        sources = np.array([view for view in known if cameras[view] == camera], int)
        if not len(sources):
            continue
        place = np.zeros(len(names))
        place[rows] = _rank_in_time([names[int(row)] for row in rows])
        sources = sources[np.argsort(place[sources])]
        for channel in range(log_gains.shape[1]):
            out[rows, channel] = np.interp(place[rows], place[sources], log_gains[sources, channel])
    return out


def _rank_in_time(names: Sequence[str]) -> np.ndarray:
    """Ranks views (V,) in time: by the number at the end of each name, if all have one."""
    stems = [name.rsplit("/", 1)[-1].rsplit(".", 1)[0] for name in names]
    numbers = [split_last_number(stem)[1] for stem in stems]
    keys = [int(number) if all(numbers) else 0 for number in numbers]
    place = np.zeros(len(names))
    for rank, view in enumerate(sorted(range(len(names)), key=lambda v: (keys[v], names[v]))):
        place[view] = rank
    return place
