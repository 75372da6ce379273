"""What poses found by colours are worth: two halves of the pixels, and the start they hold."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from disturbances import Disturbance, disturb_pose, disturb_scene
from gsut import TrainOptions
from gsut.refine.trust import Halves, select_half, weigh_lens, weigh_poses
from gsut.sfm.world.comparison import compare_poses
from random_scenes import fisheye, random_pose
from room_dataset import write_room

VIEWS = 40


def poses_off(rng, poses, degrees, distance):
    return np.array([disturb_pose(rng, pose, degrees, distance) for pose in poses])


def start_of(rng):
    return np.array([random_pose(rng) for _ in range(VIEWS)]), np.zeros(VIEWS, bool)


def test_halves_share_no_pixel_and_cover_all():
    first, second = (select_half(70, 113, half) for half in (0, 1))
    assert not (first & second).any()
    assert (first | second).all()
    assert abs(first.mean() - 0.5) < 0.05
    assert first[:7, :7].all()  # blocks, not single pixels
    assert second[:7, 7:14].all()


def test_colours_that_agree_far_away_are_followed(rng):
    start, tracked = start_of(rng)
    true = poses_off(rng, start, 2.0, 0.08)
    halves = Halves(*(poses_off(rng, true, 0.05, 0.002) for _ in range(2)))
    trust = weigh_poses(halves, start, tracked, None)
    assert trust.weights.min() > 0.99
    assert trust.list_rejected([str(view) for view in range(VIEWS)]) == []
    # The halves' errors were 0.05 degrees; what they share is counted, too.
    assert 0.02 < trust.errors[0] < 0.2


def test_colours_that_only_scatter_about_the_start_are_not(rng):
    start, tracked = start_of(rng)
    halves = Halves(*(poses_off(rng, start, 0.2, 0.01) for _ in range(2)))
    trust = weigh_poses(halves, start, tracked, None)
    assert trust.weights.max() == 0.0
    assert len(trust.list_rejected([str(view) for view in range(VIEWS)])) == VIEWS


def test_a_turn_alone_counts_as_much_as_a_move(rng):
    start, tracked = start_of(rng)
    turned = poses_off(rng, start, 2.0, 0.0)
    halves = Halves(*(poses_off(rng, turned, 0.05, 0.002) for _ in range(2)))
    assert weigh_poses(halves, start, tracked, None).weights.min() > 0.9


def test_a_view_whose_halves_disagree_is_named(rng):
    start, tracked = start_of(rng)
    true = poses_off(rng, start, 0.5, 0.02)
    first, second = (poses_off(rng, true, 0.05, 0.002) for _ in range(2))
    first[7] = disturb_pose(rng, first[7], 5.0, 0.2)
    trust = weigh_poses(Halves(first, second), start, tracked, None)
    (rejected,) = trust.list_rejected([f"{view}.png" for view in range(VIEWS)])
    assert rejected["name"] == "7.png"
    assert rejected["weight"] < 0.2
    note = trust.note([f"{view}.png" for view in range(VIEWS)])
    assert note.startswith("1 of 40 training views stay near") and note.endswith(" 7.png")
    assert np.delete(trust.weights, 7).min() > 0.8


def test_tracks_and_colours_are_weighed_by_their_variances(rng):
    start, tracked = start_of(rng)
    tracked[1:] = True
    # Halves differ by 2 x 0.08 degrees: errors of 2.5 x 0.08 with what they share.
    first, second = (
        np.array([gsut.exp_pose([0, 0, 0, np.radians(a), 0, 0]) @ pose for pose in start])
        for a in (0.08, -0.08)
    )
    trust = weigh_poses(Halves(first, second), start, tracked, 0.4)
    assert trust.errors[0] == pytest.approx(0.2, rel=1e-6)
    np.testing.assert_allclose(trust.weights[1:], 0.8, rtol=1e-6)  # 0.4^2 : 0.2^2
    assert trust.weights[0] == 0.0  # unknown start, colours that only scatter
    # Colours that lead beyond what both can err by are believed less.
    far = np.array([gsut.exp_pose([0, 0, 0, np.radians(2.0), 0, 0]) @ pose for pose in first])
    other = np.array([gsut.exp_pose([0, 0, 0, np.radians(2.0), 0, 0]) @ pose for pose in second])
    weights = weigh_poses(Halves(far, other), start, tracked, 0.4).weights
    np.testing.assert_allclose(weights[1:], (0.4 / 2.0) ** 2, rtol=0.05)


def test_lenses_are_weighed_by_where_rays_go():
    camera = fisheye(96)
    params = np.array(camera.params)

    def longer(factor):
        changed = params.copy()
        changed[:2] *= factor
        return camera.with_params(changed)

    weight, error = weigh_lens(longer(1.019), longer(1.021), camera)
    assert weight > 0.98
    assert 0.01 < error < 0.2
    assert weigh_lens(longer(0.99), longer(1.01), camera)[0] == 0.0


@pytest.mark.slow
def test_true_poses_stay_where_colours_alone_would_worsen_them(tmp_path, monkeypatch):
    """A young scene misplaces views: before there were halves, poses only got worse."""
    scene = gsut.load_dataset(write_room(tmp_path / "data", np.random.default_rng(7)))
    options = TrainOptions(
        steps=100, max_gaussians=400, checkpoint_every=0, seed=3, refine_poses=True
    )

    def errors(start):
        found = gsut.train(start, options, progress=False)
        poses = [each.poses(scene.train_indices) for each in (found.scene, scene)]
        return compare_poses(*poses), found.metrics

    guarded, metrics = errors(scene)
    names = [row["name"] for row in metrics["refinement"]["rejected"]]
    assert names == [scene.views[index].name for index in scene.train_indices]
    assert "For 12 of 12 training views colours count less" in metrics["refinement"]["note"]
    off = disturb_scene(scene, Disturbance("x", degrees=1.0, distance=0.05), 5)
    back, moved = errors(off)
    assert moved["refinement"]["rejected"] == []

    from gsut.refine import refiner as refine_training

    def believed(*arguments):
        trust = weigh_poses(*arguments)
        return dataclasses.replace(trust, weights=np.ones_like(trust.weights))

    monkeypatch.setattr(refine_training, "weigh_poses", believed)
    free, _ = errors(scene)
    print([np.median(e.rotation_degrees) for e in (guarded, free, back)])
    assert np.median(free.rotation_degrees) > 0.1
    assert np.median(guarded.rotation_degrees) < tolerances.REFINED_KEPT_SHARE * np.median(
        free.rotation_degrees
    )
    assert guarded.ate < tolerances.REFINED_KEPT_SHARE * free.ate
