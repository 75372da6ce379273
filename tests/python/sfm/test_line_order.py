"""The order in which lines are read, by the matches that it explains."""

import dataclasses

import numpy as np
import pytest

from gsut import Shutter
from gsut.sfm.shutter.agreement import find_better_order
from gsut.sfm.solution import Adjustment, ReadoutMotion, adjust_registered
from made_flight import DOWN, fly_again

UP = Shutter("bottom_to_top")
WAYS = [DOWN, Shutter("left_to_right")]


def find(flight, speed):
    """Finds the order in a flight whose images are moved by `speed` along x while they are read."""
    rates = np.tile([speed, 0, 0, 0, 0, 0], (12, 1))
    still = dataclasses.replace(flight.solved, shutter=None, velocities=None)

    def adjust(shutter):
        motion = None if shutter is None else ReadoutMotion(shutter, 1.0, rates, 0.0)
        adjustment = Adjustment(covariances=False, motion=motion)
        return adjust_registered(
            still, flight.features, flight.pairs, flight.options, adjustment=adjustment
        )

    return find_better_order(adjust, flight.features, flight.pairs, WAYS)


@pytest.mark.parametrize(("speed", "order"), [(0.2, DOWN), (-0.2, UP)])
def test_order_of_lines_is_the_one_that_explains_matches(speed, order):
    flight = fly_again(3, relief=0.3, turn=0.3, speed=0.2)
    shutter, share = find(flight, speed)
    assert shutter.direction == order.direction
    assert 0.5 < share <= 1


def test_order_of_lines_read_at_once_is_not_found():
    flight = fly_again(3, relief=0.3, turn=0.3)
    assert find(flight, 0.2) is None
