"""A disturbed lens and poses come back within their covariance; bad input is named."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.lens import find_refinable_params
from gsut.sfm.lens.covariance import estimate_lens_sigmas
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.solution import FEATURE_VARIANCE, Adjustment
from gsut.sfm.solution.solver import adjust_poses
from synthetic_walk import Synthetic

IMAGES, NOISE_PX = 8, 0.2
# Focal length 2 % off, centre 3 and 2 px, k1 by 20 %.
OFF = np.array([1.02, 1.02, 1, 1, 1.2, 1, 1, 1])


def disturbed_lens(lens: gsut.Camera) -> gsut.Camera:
    params = lens.params * OFF + [0, 0, 3, -2, 0, 0, 0, 0]
    return gsut.Camera(lens.model, params, lens.width, lens.height)


def disturbed_poses(scene: Synthetic, rng) -> list[np.ndarray]:
    """By 0.2 degrees and 1 cm of a walk of 2 m."""
    return [_core.exp_pose(rng.normal(0, [0.01] * 3 + [0.0035] * 3)) @ p for p in scene.poses]


def find_sigmas(solution, free) -> np.ndarray:
    """Finds standard deviations of the lens where features err independently."""
    return estimate_lens_sigmas(solution, free)[0] / np.sqrt(FEATURE_VARIANCE)


def test_refine_of_a_splined_lens_holds_its_surface(rng):
    _, params, width, height = gsut._core.camera_examples("splined_stereographic")[0]
    lens = gsut.Camera("splined_stereographic", params, width, height)
    scene = Synthetic(rng, images=6, points=400, noise=NOISE_PX, camera=lens)
    start = lens.params.copy()
    start[4:8] += [2.0, 2.5, 2.0, -1.0]  # fx fy cx cy
    free = find_refinable_params(lens)
    assert np.flatnonzero(free).tolist() == [4, 5, 6, 7]
    found = adjust_poses(
        scene.images(lens.with_params(start)), scene.verified(), scene.poses, PosesOptions(),
        adjustment=Adjustment(free),
    )  # fmt: skip
    after = found.cameras[0].params
    assert np.array_equal(after[~free], lens.params[~free])
    errors = (after - lens.params)[free] / find_sigmas(found, free)[free]
    assert np.abs(errors).max() < tolerances.REFINED_LENS_SIGMAS


@pytest.mark.slow
def test_lens_covariance_is_that_of_many_draws():
    z = []
    for seed in range(100, 116):
        rng = np.random.default_rng(seed)
        scene = Synthetic(rng, images=IMAGES, points=700, noise=NOISE_PX)
        found = adjust_poses(
            scene.images(disturbed_lens(scene.camera)), scene.verified(),
            disturbed_poses(scene, rng), PosesOptions(), adjustment=Adjustment(np.ones(8, bool)),
        )  # fmt: skip
        sigmas = find_sigmas(found, np.ones(8, bool))
        z.append((found.cameras[0].params - scene.camera.params) / sigmas)
    low, high = tolerances.REFINED_SIGMA_RATIO
    assert low < np.sqrt(np.mean(np.square(z))) < high


def test_refine_from_poses_of_other_images_says_that_they_disagree(rng):
    scene = Synthetic(rng, images=4, points=200)
    poses = [_core.exp_pose(rng.normal(0, 1, 6)) for _ in scene.poses]
    with pytest.raises(_core.SolveError, match="points agree with the poses"):
        adjust_poses(
            scene.images(), scene.verified(), poses, PosesOptions(),
            adjustment=Adjustment(np.ones(8, bool)),
        )  # fmt: skip


def test_refine_structure_needs_one_pose_an_image(rng):
    scene = Synthetic(rng, images=2, points=50)
    pixels = [f.pixels for f in scene.features]
    with pytest.raises(gsut.InputError, match="found 1 poses of 2 images"):
        _core.refine_structure([scene.camera], [0, 0], pixels, [], scene.poses[:1], {}, None)
    with pytest.raises(gsut.InputError, match="names camera 1 of 1"):
        _core.refine_structure([scene.camera], [0, 1], pixels, [], scene.poses, {}, None)
