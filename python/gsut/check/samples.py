"""How much of a dataset the doctor's checks examine, and what they trust."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_VIEWS = 16  # that are examined: enough for a median
FEWEST = 30  # samples of which a median is trusted
POINTS = 20_000  # that are examined: more take longer and change nothing
SIDE = 640  # pixels of the images on which pixels and lenses are checked


def choose_views(views: Sequence[int]) -> list[int]:
    """Chooses some views evenly, first and last among them."""
    places = np.linspace(0, len(views) - 1, min(len(views), _VIEWS)).round().astype(int)
    return [views[place] for place in places]
