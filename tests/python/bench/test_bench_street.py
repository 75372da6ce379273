"""The made street: rays go through doors into the next room, and end in their own elsewhere."""

import numpy as np

import tolerances as tol
from gsut.demo.dataset import distances
from gsut.demo.hall import HALF_X, HALF_Y, make_hall
from tests.bench.street import DOOR_X, RoomsTracer, Street
from tests.bench.walk_film import walk


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


def test_walk_through_rooms_goes_through_their_doors():
    path = walk(10.0, rooms=3)
    times = np.linspace(0, 10, 2001)
    centers = path(times)[:, :3, 3]
    assert centers[0, 1] > -HALF_Y and centers[-1, 1] > 2 * 2 * HALF_Y
    for wall in (HALF_Y, 3 * HALF_Y):
        through = centers[np.abs(centers[:, 1] - wall).argmin()]
        assert abs(through[0] - DOOR_X) < 0.1 and through[2] < 2.1


def test_rooms_are_traced_each_by_itself_and_through_doors():
    tracer = RoomsTracer(2)
    origin = np.array([[[DOOR_X, 3.0, 1.9], [DOOR_X, 2 * HALF_Y - 3.0, 1.9]]])
    rays = np.array([[[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]])
    both = tracer.colors(origin, rays)
    # Through the door the same place is seen as from the room behind it.
    assert both.shape == (2, 3) and np.allclose(both[0], both[1], atol=1e-6)
    aside = tracer.colors(origin, np.array([[[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]]))
    assert not np.allclose(aside[0], aside[1], atol=1e-3)
