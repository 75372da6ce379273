"""Two places that look alike are not taken for one; thin overlap holds where the camera turns."""

import dataclasses

import numpy as np
import pytest

import tolerances
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.solution import measure_agreement, measure_contradiction
from gsut.sfm.solution.solver import solve_poses
from gsut.sfm.world.comparison import compare_poses
from made_flight import fly_again
from synthetic_walk import Synthetic


@pytest.mark.parametrize(("aside", "share"), [(0.0, 0.0), (20.0, 1.0)])
def test_pair_contradicts_poses_where_rays_miss_each_other_not_where_they_meet_elsewhere(
    aside, share
):
    run = fly_again(1, relief=0.3, turn=0.5)
    one, two = run.solved.camera_from_world[:2]
    camera, seen = run.solved.cameras[0], run.features[0]
    rays = camera.unproject(seen.pixels)[0]
    nearer = (6.0 * rays - one[:3, 3]) @ one[:3, :3]  # than the ground: along the epipolar line
    pixels, valid = camera.project(nearer @ two[:3, :3].T + two[:3, 3])
    other = run.features[1]
    moved = dataclasses.replace(seen, pixels=pixels + aside)
    features = [seen, other.join(moved), *run.features[2:]]
    rows = np.flatnonzero(valid)
    matches = np.stack([rows, len(other) + rows], axis=1).astype(np.int32)
    alike = dataclasses.replace(run.pairs[0], matches=matches)
    pairs = [alike, *run.pairs[1:]]
    assert measure_agreement(run.solved, pairs).rejected.sum() == 1
    of_pairs, found = measure_contradiction(run.solved, features, pairs, 2.0)
    assert of_pairs == pytest.approx(share / len(pairs))
    others = [
        sum(len(p.matches) for p in pairs[1:] if image in (p.first, p.second)) for image in (0, 1)
    ]
    expected = share * len(matches) / (len(matches) + np.array(others))
    np.testing.assert_allclose(found[:2], expected, rtol=1e-12)
    assert not found[2:].any()


@pytest.mark.parametrize(("few", "all_placed"), [(5, True), (2, False)])
def test_image_that_shares_few_points_is_placed_by_its_neighbour(rng, few, all_placed):
    scene = Synthetic(rng)
    joint = 4
    verified = {(p.first, p.second): p for p in scene.verified()}
    between = verified[joint - 1, joint].matches
    # Of what both see, half is seen by no other of the first images, and of the rest few are left.
    own = set(between[::2, 0].tolist())
    shared = np.concatenate([between[::2], between[1 : 2 * few : 2]])
    pairs = [dataclasses.replace(verified[joint - 1, joint], matches=shared)]
    for (first, second), pair in verified.items():
        if second == joint - 1:
            kept = np.array([int(m[1]) not in own for m in pair.matches])
            assert kept.any() and not kept.all()
            pair = dataclasses.replace(pair, matches=pair.matches[kept])
        if (first < joint) == (second < joint):
            pairs.append(pair)
    assert len(pairs[0].matches) > 60
    found = solve_poses(scene.images(), pairs, PosesOptions())
    assert found.registered.all() == all_placed
    if not all_placed:
        assert found.num_registered <= joint + 1  # one half
        return
    errors = compare_poses(found.camera_from_world, np.array(scene.poses))
    assert errors.rotation_degrees.max() < tolerances.SFM_THIN_DEGREES
    assert errors.ate_percent < tolerances.SFM_THIN_ATE_PERCENT
