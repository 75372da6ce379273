"""How two renderers' pictures are compared."""

import numpy as np
import pytest

from lab.proving.second_opinion import compare


def test_pictures_are_compared_by_the_median_ratio_where_both_have_light():
    picture = np.random.default_rng(0).uniform(0.2, 1.0, (72, 96, 3))
    where = np.ones((72, 96), bool)
    twice = picture * 2
    twice[:10] = 0.0  # dark in one: no ratio
    ratio, stops = compare(picture, twice, where)
    assert ratio == pytest.approx(0.5)
    assert stops == pytest.approx(0.0, abs=1e-12)
    assert compare(picture, twice, np.zeros_like(where)) is None
