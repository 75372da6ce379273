"""Covariances of poses that are added afterwards, or never, change nothing else."""

import numpy as np

from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.solution import Adjustment, solve_poses
from synthetic_walk import Synthetic


def _solve(scene, adjustment):
    return solve_poses(scene.images(), scene.verified(), PosesOptions(), adjustment=adjustment)


def test_deferred_covariances_have_the_bits_of_those_at_once(rng):
    scene = Synthetic(rng)
    at_once = _solve(scene, Adjustment())
    deferred = _solve(scene, Adjustment(defer_covariances=True))
    assert not deferred.covariances.any()
    for name in ("camera_from_world", "points", "observations", "residuals"):
        assert np.array_equal(getattr(at_once, name), getattr(deferred, name))
    later = deferred.add_covariances(scene.images().features)
    assert np.array_equal(later.covariances, at_once.covariances)
    assert later.add_covariances(scene.images().features) is later
