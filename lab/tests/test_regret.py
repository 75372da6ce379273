"""What the chosen degree costs: figures of a row."""

import pytest

from lab.proving.regret import find_regret


def test_regret_is_of_the_mean_of_the_seeds():
    row = {"regret": {"chosen": 1, "degrees": {"1": [29.0, 30.0], "3": [30.0, 29.5]}}}
    assert find_regret(row) == pytest.approx(0.25)
    assert find_regret({}) is None
