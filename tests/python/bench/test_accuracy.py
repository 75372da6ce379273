"""What ./run bench compares with: the scalar baseline, the sampled double reference, the scenes."""

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut import _core
from tests.bench import accuracy, measure, scenes

ALL_TILES = 10_000
# The extents' factor with which the baseline's tiles hold every footprint of the scenes below.
WIDE = 4.0
# parity of the blend rule; 3dgrut and gsplat stop after and before, and order by z.
RULES = ("", "gsplat", "3dgrut")


@pytest.fixture
def fisheye():
    return scenes.scene_from_arrays("synthetic_2k_64x48")


@pytest.fixture
def pinhole():
    return scenes.scene_from_arrays("peer_1k_48x32")


# The scalar baseline.


@pytest.mark.parametrize("parity", RULES)
def test_scalar_renderer_against_double_reference_agrees(fisheye, pinhole, parity):
    rule = gsut.BlendRule(parity)
    for scene in (fisheye, pinhole):
        truth = accuracy.make_truth(scene, rule, tiles=ALL_TILES)
        assert truth.smooth.mean() > 0.9
        run = measure.ScalarRun(scene, rule, WIDE)
        run.once(truth.dimage)
        errors = accuracy.errors_of(truth, run.image, run.gradients)
        assert errors.image_rms <= tol.SCALAR_IMAGE_RMS
        assert sorted(errors.gradients) == sorted(accuracy.PARAMETERS)
        assert errors.gradient_relative <= tol.SCALAR_GRADIENT_RELATIVE


def test_scalar_renderer_on_one_and_two_threads_gives_the_same_bits(fisheye):
    images, gradients = [], []
    before = _core.num_threads()
    for threads in (1, 2):
        _core.set_num_threads(threads)
        run = measure.ScalarRun(fisheye, gsut.BlendRule())
        run.once()
        images.append(run.image)
        gradients.append(run.gradients)
    _core.set_num_threads(before)
    assert np.array_equal(*images)
    for name in accuracy.PARAMETERS:
        assert np.array_equal(getattr(gradients[0], name), getattr(gradients[1], name))


def test_scalar_renderer_with_unscented_extents_lists_fewer_pairs(fisheye):
    pairs = []
    for widen in (1.0, WIDE):
        run = measure.ScalarRun(fisheye, gsut.BlendRule(), widen)
        run.once()
        statistics = run.renderer.statistics()
        assert 0 < statistics["num_blended"] <= statistics["num_evaluated"]
        pairs.append(statistics["num_pairs"])
    assert pairs[0] < pairs[1]


def test_scalar_renderer_backward_before_render_is_refused(pinhole):
    renderer = measure.scalar_baseline.ScalarRenderer()
    with pytest.raises(gsut.InputError, match="needs a render before it"):
        renderer.backward(
            np.zeros((0, 0, 3), np.float32), accuracy.empty_gradients(pinhole.gaussians)
        )


# The double reference on a sample.


def test_reference_on_chosen_pixels_equals_the_whole_there(pinhole, rng):
    g = pinhole.gaussians.to_dtype(np.float64)
    size = (pinhole.camera.height, pinhole.camera.width)
    chosen = (rng.uniform(size=size) < 0.3).astype(np.uint8)
    job = _core.RenderJob(
        pinhole.camera, pinhole.camera_from_world, background=(0.2, 0.3, 0.4), sh_degree=0
    )
    whole = _core.render_reference(g, job)
    part = _core.render_reference(g, job, chosen)
    for of_all, of_chosen in zip(whole, part, strict=True):
        assert np.array_equal(of_chosen[chosen != 0], of_all[chosen != 0])
        assert not of_chosen[chosen == 0].any()
    dimage = rng.normal(size=(*size, 3))
    of_chosen, of_all = accuracy.empty_gradients(g), accuracy.empty_gradients(g)
    masked = dimage * chosen[..., None]
    _core.render_reference_backward(g, job, dimage, of_chosen, pixels=chosen)
    _core.render_reference_backward(g, job, masked, of_all)
    for name in accuracy.PARAMETERS:
        assert np.allclose(
            getattr(of_chosen, name), getattr(of_all, name), rtol=0, atol=tol.BENCH_ROUNDING
        )


def test_truth_of_a_sample_leaves_no_gaussian_out(fisheye):
    rule = gsut.BlendRule()
    truth = accuracy.make_truth(fisheye, rule, tiles=3, with_gradients=False)
    image, _, _, blended, _ = _core.render_reference(
        fisheye.gaussians.to_dtype(np.float64),
        _core.RenderJob(fisheye.camera, fisheye.camera_from_world, rule=rule),
    )
    inside = truth.pixels != 0
    assert 0 < len(truth.rows) < len(fisheye.gaussians)
    assert 0 < inside.sum() <= 3 * 256
    assert np.array_equal(truth.image, image[inside])
    assert truth.pairs_per_pixel == blended[inside].mean()


def test_errors_of_a_disturbed_result_are_those_of_the_disturbance(pinhole):
    truth = accuracy.make_truth(pinhole, gsut.BlendRule(), tiles=ALL_TILES)
    gradients = accuracy.empty_gradients(pinhole.gaussians.to_dtype(np.float64))
    for name in accuracy.PARAMETERS:
        getattr(gradients, name)[truth.rows] = 1.5 * getattr(truth.gradients, name)
    image = np.zeros((*truth.pixels.shape, 3))
    image[truth.pixels != 0] = truth.image + 0.25
    errors = accuracy.errors_of(truth, image, gradients)
    assert errors.image_rms == pytest.approx(0.25, abs=tol.BENCH_ROUNDING)
    assert errors.image_max == pytest.approx(0.25, abs=tol.BENCH_ROUNDING)
    assert len(errors.gradients) == 5
    for error in errors.gradients.values():
        assert error == pytest.approx(0.5, abs=tol.BENCH_ROUNDING)


def test_errors_of_gradients_to_unseen_gaussians_count(pinhole):
    truth = accuracy.make_truth(pinhole, gsut.BlendRule(), tiles=1)
    gradients = accuracy.empty_gradients(pinhole.gaussians.to_dtype(np.float64))
    for name in accuracy.PARAMETERS:
        getattr(gradients, name)[truth.rows] = getattr(truth.gradients, name)
    (unseen,) = np.setdiff1d(np.arange(len(gradients)), truth.rows)[:1]
    image = np.zeros((*truth.pixels.shape, 3))
    assert accuracy.errors_of(truth, image, gradients).gradients["means"] == 0.0
    gradients.means[unseen] = np.linalg.norm(truth.gradients.means) / np.sqrt(3)
    error = accuracy.errors_of(truth, image, gradients).gradients["means"]
    assert error == pytest.approx(1.0, abs=tol.BENCH_ROUNDING)


# Scenes.


def test_scene_of_an_unknown_name_lists_the_known():
    with pytest.raises(gsut.InputError) as refused:
        scenes.scene_from_arrays("garden")
    assert [name for name in scenes.KNOWN_SCENES if name not in str(refused.value)] == []


def test_peer_scene_follows_the_shared_recipe():
    scene = scenes.scene_from_arrays("peer_10k_480x480")
    rng = np.random.default_rng(0)
    means = rng.uniform([-2, -1.5, 2.5], [2, 1.5, 5.5], (10_000, 3))
    scales = 0.6 / 10_000 ** (1 / 3) * np.exp(rng.normal(0, 0.4, (10_000, 3)))
    assert np.array_equal(scene.gaussians.means, means.astype(np.float32))
    assert np.array_equal(scene.gaussians.log_scales, np.log(scales).astype(np.float32))
    assert list(scene.camera.params) == [432.0, 432.0, 240.0, 240.0]
    assert scene.gaussians.sh.shape == (10_000, 1, 3)
