"""Compaction: scores seen through lenses, methods, bad input, invariance, determinism."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gsut
import ray_model
import tolerances
from gsut import InputError, _core
from gsut.compact import compact, score_gaussians
from gsut.compact.method import METHODS
from gsut.compact.methods.lightgaussian import score_significance, sum_hits
from gsut.compact.methods.pup import score_sensitivity, sum_fisher_matrices
from gsut.compact.scores import SeenView, blend_weights, find_strongest
from gsut.gaussians import SH_C0, transform_gaussians
from gsut.render import place_about
from random_scenes import arrays_of, fisheye, gaussians_in_view, pinhole, random_pose

COUNT = 300


@pytest.fixture
def views(rng):
    """Two views through lenses that reach beyond a hemisphere and one pinhole, around one place."""
    made = []
    for camera in (fisheye(40), fisheye(40, degrees=150.0), pinhole(32)):
        pose = np.eye(4)
        pose[:3, 3] = 0.2 * rng.normal(size=3)
        made.append(SeenView(camera, pose, np.array(camera.rays()[1], bool)))
    return made


@pytest.fixture
def scene(rng, views):
    return gaussians_in_view(rng, views[0].camera, views[0].camera_from_world, COUNT)


def double_weights(g, views):
    """Blend weights by the double reference's gradient to the base colour of grey Gaussians."""
    sums = np.zeros(len(g))
    grey = gsut.Gaussians(
        g.means.astype(np.float64), g.quats, g.log_scales, g.opacity_logits,
        np.zeros((len(g), 1, 3)),
    )  # fmt: skip
    for view in views:
        result = gsut.render(grey, view.camera, view.camera_from_world, dtype="float64")
        dimage = np.zeros_like(result.image)
        dimage[..., 0] = view.mask
        sums += gsut.render_backward(result, dimage).gaussians.sh[:, 0, 0]
    return sums / SH_C0


def test_blend_weights_agree_with_the_double_reference(scene, views):
    found, expected = blend_weights(scene, views), double_weights(scene, views)
    assert np.count_nonzero(expected) > COUNT / 2
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error < tolerances.COMPACT_WEIGHTS


def test_blend_weights_of_masked_pixels_do_not_count(scene, views):
    half = views[0].mask.copy()
    half[:, : half.shape[1] // 2] = False
    left = dataclasses.replace(views[0], mask=views[0].mask & ~half)
    right = dataclasses.replace(views[0], mask=half)
    parts = blend_weights(scene, [left]) + blend_weights(scene, [right])
    whole = blend_weights(scene, [views[0]])
    assert np.linalg.norm(parts - whole) < tolerances.COMPACT_WEIGHTS * np.linalg.norm(whole)


@pytest.mark.parametrize("score", [blend_weights, sum_hits, sum_fisher_matrices])
def test_scores_of_gaussians_about_an_origin_equal_those_about_zero(scene, views, score):
    origin = np.array([40.0, -7.0, 12.0])
    moved = [
        dataclasses.replace(v, camera_from_world=place_about(v.camera_from_world, -origin))
        for v in views
    ]
    expected, found = score(scene, views), score(scene.translate(origin), moved)
    assert np.abs(expected).max() > 0
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error < tolerances.COMPACT_WEIGHTS


def blended_by_hand(g, view):
    """(pixels, N) alpha and transmittance in front, 0 where not drawn, by the second renderer."""
    rule, pose = _core.BlendRule(), view.camera_from_world
    seen = view.mask & np.asarray(view.camera.rays()[1], bool)
    traced = ray_model.trace(
        g.to_dtype(np.float64), view.camera, pose, rule, pixels=np.argwhere(seen)
    )
    alphas = np.where(traced.alpha >= rule.alpha_min, traced.alpha, 0.0)
    order = np.argsort(traced.keys.astype(np.float32), kind="stable")
    front = np.cumprod(1 - alphas[:, order], axis=1)
    transmittance = np.ones_like(alphas)
    transmittance[:, order[1:]] = front[:, :-1]
    drawn = (alphas > 0) & (transmittance >= rule.transmittance_min)
    return np.where(drawn, alphas, 0.0), np.where(drawn, transmittance, 0.0)


def test_hit_sums_are_opacity_times_transmittance_of_the_rays_that_hit(scene, views):
    opacity = 1 / (1 + np.exp(-scene.opacity_logits.astype(float)))
    expected = sum(blended_by_hand(scene, view)[1].sum(axis=0) for view in views) * opacity
    assert np.count_nonzero(expected) > COUNT / 2
    found = sum_hits(scene, views)
    # A pixel at a Gaussian's cut-off counts in one and not in the other.
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error < tolerances.COMPACT_HITS
    assert np.all(found >= blend_weights(scene, views) * (1 - 1e-4) - 1e-3)


def test_lightgaussian_scores_are_hits_times_a_power_of_volume(scene, views):
    volume = np.exp(scene.log_scales.astype(np.float64).sum(axis=1))
    factor = np.minimum(volume / np.percentile(volume, 90), 1.0) ** 0.1
    expected = sum_hits(scene, views) * factor
    np.testing.assert_allclose(
        score_significance(scene, views), expected, rtol=tolerances.COMPACT_SCORE, atol=1e-12
    )


def test_winners_have_the_largest_blend_weight_of_their_pixels(scene, views):
    for view in views:
        winner, point = find_strongest(scene, view)
        alpha, transmittance = blended_by_hand(scene, view)
        weights = alpha * transmittance
        chosen = view.mask & np.asarray(view.camera.rays()[1], bool)
        assert np.all(winner[~chosen] == -1)
        of_winner = np.where(
            winner[chosen] >= 0, weights[np.arange(len(weights)), winner[chosen]], 0.0
        )
        # Of two equally strong ones either may win.
        assert np.all(of_winner >= weights.max(axis=1) - tolerances.COMPACT_WINNER)
        seen = winner >= 0
        # The point lies on the pixel's ray, as near to the mean as the ray comes.
        pose = view.camera_from_world
        rays = np.asarray(view.camera.rays()[0])[seen] @ pose[:3, :3]
        from_center = point[seen] + pose[:3, :3].T @ pose[:3, 3]
        off = np.linalg.norm(np.cross(rays, from_center), axis=1)
        assert off.max() < tolerances.COMPACT_WINNER_POINT
        largest = np.exp(scene.log_scales[winner[seen]].max(axis=1))
        assert np.all(np.linalg.norm(point[seen] - scene.means[winner[seen]], axis=1) < 4 * largest)
        assert np.all(point[~seen] == 0)


def three_places(size):
    """Seen from one place, size and distance cannot be told apart."""
    camera, poses = pinhole(size), []
    for place in ((0.0, 0.0), (0.8, 0.0), (0.0, 0.8)):
        pose = np.eye(4)
        pose[:2, 3] = place
        poses.append(pose)
    return [SeenView(camera, pose, np.ones((size, size), bool)) for pose in poses]


def test_fisher_matrices_agree_with_gradients_pixel_by_pixel(rng):
    size = 12
    views = three_places(size)
    g = gaussians_in_view(
        rng, views[0].camera, views[0].camera_from_world, 3,
        distances=(2.0, 3.0), sizes=(0.2, 0.3), opacity=1.0,
    )  # fmt: skip
    double = g.to_dtype(np.float64)
    scales = np.exp(double.log_scales)
    expected = np.zeros((3, 6, 6))
    for view in views:
        result = gsut.render(double, view.camera, view.camera_from_world, dtype="float64")
        for pixel in np.ndindex(size, size, 3):
            dimage = np.zeros((size, size, 3))
            dimage[pixel] = 1.0
            gradient = gsut.render_backward(result, dimage).gaussians
            j = np.concatenate([gradient.means, gradient.log_scales / scales], axis=1)
            expected += j[:, :, None] * j[:, None, :]
    found = sum_fisher_matrices(g, views)
    error = np.linalg.norm(found - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
    assert error.max() < tolerances.COMPACT_FISHER
    scores = np.linalg.slogdet(expected)[1]
    assert np.abs(score_sensitivity(g, views) - scores).max() < tolerances.COMPACT_LOG_DET


def test_pup_scores_of_what_is_not_seen_are_the_least(scene, views):
    hidden = scene.copy()
    hidden.means[:5] = 1e4
    scores = score_sensitivity(hidden, views)
    assert np.all(np.isneginf(scores[:5]))
    assert np.isfinite(scores).sum() > COUNT / 2


@pytest.mark.parametrize("method", METHODS)
def test_compact_keeps_the_number_asked_for_with_the_same_bits_on_any_threads(scene, views, method):
    results = []
    for threads in (1, 2, 5):
        gsut.set_num_threads(threads)
        results.append(compact(scene, 0.2, method=method, views=views).gaussians)
    if method == "ghap-paper":  # rounded in each block
        assert abs(len(results[0]) - 60) <= 30
    else:
        assert len(results[0]) == 60
    assert results[0].sh_degree == scene.sh_degree
    for other in results[1:]:
        assert arrays_of(other) == arrays_of(results[0])


@pytest.mark.parametrize("method", ["lightgaussian", "pup"])
def test_pruning_keeps_rows_as_they_are(scene, views, method):
    kept = compact(scene, count=100, method=method, views=views).gaussians
    rows = {scene.means[i].tobytes(): i for i in range(COUNT)}
    indices = [rows[mean.tobytes()] for mean in kept.means]
    assert len(set(indices)) == 100
    assert arrays_of(kept) == arrays_of(scene[np.array(indices)])


def test_compact_to_all_is_a_copy(scene, views):
    same = compact(scene, 1.0, views=views).gaussians
    assert arrays_of(same) == arrays_of(scene)
    assert not np.shares_memory(same.means, scene.means)


@pytest.mark.parametrize("method", ["lightgaussian", "pup"])
def test_compact_scores_without_views_are_refused(scene, method):
    with pytest.raises(InputError, match="what views see"):
        compact(scene, 0.5, method=method)


def test_compact_neither_keep_nor_count_is_refused(scene):
    with pytest.raises(InputError, match=r"keep .* or count"):
        compact(scene)
    with pytest.raises(InputError, match="at least one"):
        compact(scene, count=0)


@pytest.mark.parametrize("method", METHODS)
def test_compact_one_gaussian_stays(scene, views, method):
    one = compact(scene[:1], 0.1, method=method, views=views).gaussians
    assert arrays_of(one) == arrays_of(scene[:1])


@pytest.mark.parametrize("method", METHODS)
def test_compact_drops_and_counts_rows_that_are_not_finite(scene, views, method):
    bad = scene.copy()
    bad.means[3, 1] = np.nan
    bad.sh[7, 0, 0] = np.inf
    bad.opacity_logits[9] = -np.inf
    result = compact(bad, 0.5, method=method, views=views)
    assert result.dropped == 3
    for field in dataclasses.fields(result.gaussians):
        assert np.isfinite(getattr(result.gaussians, field.name)).all()


@pytest.mark.parametrize("method", METHODS)
def test_compact_duplicates_and_zero_opacity_give_finite_results(scene, views, method):
    same = scene[np.zeros(COUNT, int)]
    same.opacity_logits[::2] = -200.0
    same.log_scales[:, 2] = -12.0
    made = compact(same, 0.1, method=method, views=views).gaussians
    assert 1 <= len(made) <= 60
    if method == "ghap-paper":  # which keeps eigenvalues above a floor
        assert made.log_scales.min() >= np.log(1e-3) - 1e-5
    for field in dataclasses.fields(made):
        assert np.isfinite(getattr(made, field.name)).all()


def test_merging_duplicates_changes_the_picture_little(rng):
    """Each Gaussian twice, half as opaque: merging to half must give back the picture."""
    camera, pose = fisheye(64), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 150, sizes=(0.02, 0.05), opacity=0.5)
    half = 1 - np.sqrt(1 - 1 / (1 + np.exp(-g.opacity_logits.astype(np.float64))))
    twice = g[np.tile(np.arange(150), 2)]
    twice.opacity_logits[:] = np.tile(np.log(half / (1 - half)), 2)
    merged = compact(twice, 0.5).gaussians
    before = gsut.render(g, camera, pose).image
    after = gsut.render(merged, camera, pose).image
    assert np.sqrt(np.mean((before - after) ** 2)) < tolerances.COMPACT_DUPLICATES


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_ghap_turns_and_scales_with_the_scene(rng, factor):
    camera, pose = fisheye(96), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 2000, sh_degree=0, opacity=1.0)
    rotation = random_pose(rng)[:3, :3]
    moved = transform_gaussians(g, rotation, factor)
    moved_pose = pose.copy()
    moved_pose[:3, :3] = pose[:3, :3] @ rotation.T
    moved_pose[:3, 3] *= factor
    mask = np.array(camera.rays()[1], bool)
    truth = gsut.render(g, camera, pose).image
    figures = []
    for each, at in ((g, pose), (moved, moved_pose)):
        small = compact(each, 0.2, views=[SeenView(camera, at, mask)]).gaussians
        figures.append(gsut.psnr(gsut.render(small, camera, at).image, truth, mask))
    assert abs(figures[0] - figures[1]) < tolerances.COMPACT_INVARIANCE_DB


_PEAK = """
import sys
import numpy as np
import gsut
from gsut.compact.compaction import compact

def peak():  # of this process alone: getrusage's would begin with its parent's
    with open("/proc/self/status") as lines:
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

def gaussians(n):
    normal = lambda *shape: np.random.default_rng(n).standard_normal(shape, np.float32)
    return gsut.Gaussians(normal(n, 3), normal(n, 4), normal(n, 3) - 5, normal(n), normal(n, 1, 3))

compact(gaussians(2000), 0.1)
before, n = peak(), int(sys.argv[1])
compact(gaussians(n), 0.1)
print((peak() - before) / n)
"""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="peak memory as Linux gives it")
@pytest.mark.parametrize("count", [20_000, pytest.param(80_000, marks=pytest.mark.slow)])
def test_compact_takes_the_same_memory_for_each_gaussian(count):
    done = subprocess.run(
        [sys.executable, "-c", _PEAK, str(count)], capture_output=True, text=True, check=True
    )
    given = 4 * (3 + 4 + 3 + 1 + 3)  # bytes of one: that the peak was measured at all
    assert given < float(done.stdout) < tolerances.COMPACT_BYTES


def test_merge_pairs_refuses_wrong_weights(scene):
    with pytest.raises(InputError, match="weights must have shape"):
        _core.merge_pairs(scene, 10, np.zeros(3, np.float32))


def test_hit_sums_behind_a_rolling_shutter_that_stands_still_are_the_same(scene, views):
    """The same rays by two kinds of tiles."""
    pose = views[0].camera_from_world
    almost = pose.copy()
    almost[0, 3] += 1e-9
    still = gsut.CameraMotion(pose, almost, gsut.Shutter("top_to_bottom"))
    moving = dataclasses.replace(views[0], camera_from_world=still)
    for function, bound in (
        (sum_hits, tolerances.COMPACT_HITS),
        (sum_fisher_matrices, tolerances.COMPACT_FISHER),
    ):
        expected = function(scene, [views[0]])
        error = np.linalg.norm(function(scene, [moving]) - expected) / np.linalg.norm(expected)
        assert error < bound


def test_blend_weights_behind_a_rolling_shutter_add_up_to_alpha(scene, views):
    start, end = views[0].camera_from_world.copy(), views[0].camera_from_world.copy()
    end[0, 3] += 0.3
    motion = gsut.CameraMotion(start, end, gsut.Shutter("top_to_bottom"))
    moving = dataclasses.replace(views[0], camera_from_world=motion)
    whole = float(gsut.render(scene, moving.camera, motion).alpha[moving.mask].sum())
    found = blend_weights(scene, [moving])
    assert abs(found.sum() - whole) < tolerances.COMPACT_WEIGHTS * whole
    still = blend_weights(scene, [views[0]])
    assert np.abs(found - still).max() > 0.01 * still.max()


@pytest.mark.parametrize("method", METHODS)
def test_compact_with_scores_found_before_gives_the_same_bits(scene, views, method):
    bad = scene.copy()
    bad.means[3, 1] = np.nan
    scores = score_gaussians(bad, method, views)
    assert (scores is None) == (method == "ghap-paper")
    for keep in (0.2, 0.5):
        one = compact(bad, keep, method=method, views=views)
        two = compact(bad, keep, method=method, views=views, scores=scores)
        assert arrays_of(one.gaussians) == arrays_of(two.gaussians)
        assert one.dropped == two.dropped == 1
    with pytest.raises(InputError, match="one a finite Gaussian"):
        compact(scene, 0.2, method="ghap", views=views, scores=np.ones(3))
