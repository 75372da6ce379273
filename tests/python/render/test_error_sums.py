"""What pixels charge the Gaussians with that they see: blend weight x error, summed in backward."""

import numpy as np
import pytest

import gsut
from gsut import _core
from gsut.gaussians import SH_C0
from random_scenes import fisheye, gaussians_in_view, list_isas, random_pose, relative_error, roll

SIZE = 70  # five tiles a side, the last one cut
RULE = gsut.BlendRule()


def passes(gaussians, camera, place, dimage, errors=None, **settings):
    """Gradients of one render, and the sums of errors, which begin at 1."""
    renderer, image = _core.Renderer(), np.zeros_like(dimage)
    renderer.render(gaussians, _core.RenderJob(camera, place, rule=RULE, sh_degree=0), image)
    gradients, touched = gaussians.make_zeros(), np.zeros(len(gaussians), np.uint8)
    sums = None if errors is None else np.ones(len(gaussians), np.float32)
    renderer.backward(
        dimage, gradients, touched, with_poses=False, errors=errors, error_sums=sums, **settings
    )
    return gradients, sums


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_sums_are_the_double_references_gradient_to_the_colour(rng, rolling):
    camera, pose = fisheye(SIZE), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 301, sh_degree=0).to_dtype(np.float32)
    g.sh[:] = np.abs(g.sh)  # colours above 0: all of their gradient arrives
    place = roll(pose) if rolling else pose
    errors = rng.uniform(size=(SIZE, SIZE)).astype(np.float32)
    charged = np.repeat(errors[..., None], 3, axis=2)  # a gradient that is the error
    exact = gsut.render(g.to_dtype(np.float64), camera, place, sh_degree=0, dtype="float64")
    expected = gsut.render_backward(exact, charged).gaussians.sh[:, 0, 0] / SH_C0
    dimage = rng.normal(size=charged.shape).astype(np.float32)
    plain, _ = passes(g, camera, place, dimage)
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        _, sums = passes(g, camera, place, dimage, errors)
        assert relative_error(sums - 1.0, expected) < 1e-4, isa
        assert np.all(sums[expected == 0] == 1.0)
    gsut.machine.set_isa("")
    gradients, again = passes(g, camera, place, dimage, errors)
    gsut.set_num_threads(1)
    assert np.array_equal(passes(g, camera, place, dimage, errors)[1], again)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        assert np.array_equal(getattr(gradients, name), getattr(plain, name)), name


def test_sums_without_errors_or_beside_lens_gradients_are_refused(rng):
    camera, pose = fisheye(SIZE), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 20, sh_degree=0).to_dtype(np.float32)
    dimage, errors = np.ones((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32)
    with pytest.raises(gsut.InputError, match="sums of errors need"):
        passes(g, camera, pose, dimage, errors, with_lens=True)
    with pytest.raises(gsut.InputError, match="errors must have shape"):
        passes(g, camera, pose, dimage, errors[1:])


def test_pixel_errors_are_of_the_photograph_in_its_light(rng):
    image = rng.uniform(size=(20, 30, 3)).astype(np.float32)
    photograph = rng.integers(0, 256, image.shape, dtype=np.uint8)
    mask = rng.integers(0, 2, image.shape[:2], dtype=np.uint8)
    gradient = rng.normal(size=image.shape).astype(np.float32)
    gradient[mask == 0] = 0.0
    gradient[3:5] = 0.0  # taken from the loss
    target = _core.PhotometricTarget(photograph, mask)
    target.set_light((0.5, 1.0, 2.0), None)
    errors = np.full(mask.shape, np.nan, np.float32)
    _core.pixel_errors(target, image, gradient, errors)
    lit, counts = photograph / 255.0 * [0.5, 1.0, 2.0], mask.astype(bool)
    counts[3:5] = False
    asked = np.flatnonzero(counts.ravel() & (np.arange(counts.size) % 11 == 0))
    near, there = lit.reshape(-1, 3)[asked], image.reshape(-1, 3)[asked]
    lit *= (there * there).sum(axis=0) / (near * there).sum(axis=0)
    expected = np.where(counts, np.abs(image - lit).mean(axis=2), 0.0)
    np.testing.assert_allclose(errors, expected, rtol=1e-5, atol=1e-6)
    darker, again = (0.7 * image).astype(np.float32), np.empty_like(errors)
    _core.pixel_errors(target, darker, gradient, again)
    np.testing.assert_allclose(again, 0.7 * expected, rtol=1e-4, atol=1e-6)  # no error of light
