"""The made street: rays go through doors into the next room, and end in their own elsewhere."""

import numpy as np

import tolerances as tol
from gsut.demo.dataset import distances
from gsut.demo.hall import HALF_X, make_hall
from tests.bench.street import Street


def test_rays_go_through_doors_and_end_at_walls():
    street = Street(2)
    start, rays = np.array([3.0, 1.05, 1.4]), np.array([[1.0, 0, 0], [0, 0, 1], [0.8, -0.6, 0]])
    light, found = street.trace(0, np.tile(start, (3, 1)), rays)
    pose = np.eye(4)
    pose[:3, 3] = start
    alone = distances(make_hall(0), pose, rays, 0.0)
    assert np.allclose(found[1:], alone[1:], atol=tol.STREET_METRES)
    assert abs(alone[0] - (HALF_X - 3.0)) < tol.STREET_METRES
    assert found[0] > alone[0] + 0.1  # the door at y = 1.05 leads into room 1
    assert (light > 0).all()
    beyond = start + (found[0] + 0.0) * rays[0] - street.center(1)
    assert -HALF_X < beyond[0] <= HALF_X + tol.STREET_METRES


def test_rooms_of_one_stand_alone():
    street = Street(1)
    start, ray = np.array([[3.0, 1.05, 1.4]]), np.array([[1.0, 0.0, 0.0]])
    assert abs(street.trace(0, start, ray)[1][0] - (HALF_X - 3.0)) < tol.STREET_METRES
