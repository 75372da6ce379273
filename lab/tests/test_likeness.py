"""Statistics of made captures beside those of real ones."""

import numpy as np
import pytest

import lab_tolerances as tol
from lab.proving.likeness import HEADING, compare_distributions, measure_pictures


def test_gain_of_pictures_is_that_of_their_features():
    rng = np.random.default_rng(0)
    grey = np.kron(rng.integers(60, 120, (30, 40)), np.ones((6, 6))).astype(np.uint8)
    first = np.dstack([grey] * 3)
    row = measure_pictures([first, 2 * first])
    assert row["gain"] == pytest.approx(1.0, abs=tol.PROVING_GAIN)
    assert row["features"] > 1000
    assert row["dark"] == 0
    assert measure_pictures([first])["gain"] is None


def test_distributions_are_compared_by_their_largest_distance():
    real = [{"features": value} for value in (1000.0, 2000.0, 3000.0, 4000.0)]
    made = [{"features": value, "residual": None} for value in (500.0, 1500.0, 2500.0, 5000.0)]
    (line,) = compare_distributions(real, made)
    spread = ("1,000", "2,500", "4,000", "800", "2,000", "4,250")
    assert line == ("SIFT features a megapixel", "4, 4", *spread, "0.25", "50 %")
    assert len(line) == len(HEADING)
