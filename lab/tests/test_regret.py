"""What automatic choices cost: figures of a row."""

from lab.proving.regret import find_regret


def test_regret_is_of_the_best_other_value():
    row = {"regret": {"automatic": 30.0, "degree": {"0": 29.0, "3": 30.25}, "steps": {}}}
    assert find_regret(row, "degree") == 0.25
    assert find_regret(row, "steps") is None
    assert find_regret({}, "gaussians") is None
