"""Features beside the colour, any number of them, and scales and opacities as they are."""

import dataclasses

import numpy as np
import pytest

import gsut
import tolerances
from gsut.gaussians import SH_C0
from random_scenes import (
    central_differences,
    fisheye,
    gaussians_in_view,
    list_isas,
    open_rule,
    pinhole,
    pose_differences,
    random_pose,
    random_weights,
    relative_error,
    roll,
)

SIZE = 70  # five tiles a side, the last one cut
FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))


def place_of(rng, rolling):
    """A pose, and how the camera is there: still, or moving with a rolling shutter."""
    pose = random_pose(rng)
    return pose, roll(pose) if rolling else pose


def make_scene(rng, camera, pose, count=150, **options):
    return gaussians_in_view(rng, camera, pose, count, sh_degree=1, **options).to_dtype(np.float32)


def to_linear(g):
    opacities = 1 / (1 + np.exp(-g.opacity_logits))
    return gsut.LinearGaussians(g.means, g.quats, np.exp(g.log_scales), opacities, g.sh)


def backward(result, weights, dfeatures, **options):
    dimage, dalpha, ddepth = weights
    return gsut.render_backward(result, dimage, dalpha, ddepth, dfeatures=dfeatures, **options)


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_features_equal_to_the_colours_are_the_image_bit_by_bit(rng, rolling):
    # Without features a camera that stands still has kernels of its own, which round differently.
    camera = fisheye(SIZE)
    pose, place = place_of(rng, rolling)
    g = make_scene(rng, camera, pose)
    g.sh[:, 1:] = 0
    g.sh[:, 0] = rng.integers(0, 64, (len(g), 3)) / 64  # 0.5 + SH_C0 x sh is then one rounding
    colors = (np.float32(0.5) + np.float32(SH_C0) * g.sh[:, 0]).astype(np.float32)
    g.sh[:, 0] = 0
    colors[:] = 0.5
    values = np.concatenate([colors, np.ones((len(g), 1))], axis=1)
    rules = ("", "gsplat", "3dgrut")
    isas = list_isas()
    for isa in isas:
        gsut.machine.set_isa(isa)
        for parity in rules:
            found = gsut.render(g, camera, place, features=values, parity=parity)
            plain = gsut.render(g, camera, place, parity=parity)
            for name in ("image", "alpha", "depth"):
                same, off = getattr(plain, name), getattr(found, name) - getattr(plain, name)
                if rolling:
                    assert np.array_equal(getattr(found, name), same), (isa, parity, name)
                assert np.sqrt(np.mean(off**2)) < tolerances.RENDER_IMAGE_RMS, (isa, parity, name)
            assert found.alpha.max() > 0.5
            assert np.array_equal(found.features[..., :3], found.image), (isa, parity)
            error = np.abs(found.features[..., 3] - found.alpha).max()
            assert error < 4 * tolerances.RENDER_FLOAT_ROUNDING
    gsut.machine.set_isa("")
    assert len(isas) > 0


# Widths of every rest of a slice; one scene has more pairs a tile than a segment holds.
@pytest.mark.parametrize(("width", "count"), [(1, 60), (6, 60), (28, 60), (65, 60), (2, 700)])
@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_features_through_forward_and_backward_match_the_double_reference(
    rng, rolling, width, count
):
    camera = fisheye(40)
    pose, place = place_of(rng, rolling)
    g = make_scene(rng, camera, pose, count)
    features = rng.normal(size=(len(g), width)).astype(np.float32)
    behind = rng.normal(size=width)
    weights = random_weights(rng, camera)
    dfeatures = rng.normal(size=(40, 40, width))
    options = {"features": features, "features_background": behind, "background": (0.2, 0.5, 0.9)}
    exact = gsut.render(g, camera, place, dtype="float64", **options)
    truth = backward(exact, weights, dfeatures, with_lens=True)
    found = gsut.render(g, camera, place, **options)
    rms = np.sqrt(np.mean((found.features - exact.features) ** 2))
    assert rms < tolerances.RENDER_IMAGE_RMS * np.abs(features).max()
    gradients = backward(found, weights, dfeatures, with_lens=True)
    for field in FIELDS:
        error = relative_error(getattr(gradients.gaussians, field), getattr(truth.gaussians, field))
        assert error < tolerances.RENDER_GRADIENT, field
    assert relative_error(gradients.features, truth.features) < tolerances.RENDER_GRADIENT
    assert np.any(truth.features != 0)
    assert relative_error(gradients.pose, truth.pose) < tolerances.RENDER_POSE_GRADIENT
    assert relative_error(gradients.lens, truth.lens) < tolerances.RENDER_POSE_GRADIENT


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_gradients_of_linear_gaussians_and_features_are_central_differences(rng, rolling):
    camera = pinhole(12)
    pose, place = place_of(rng, rolling)
    g = to_linear(make_scene(rng, camera, pose, 12).to_dtype(np.float64))
    g.opacities[:4] = (0.0, 1.0, 0.5, 1.0)
    features = rng.normal(size=(len(g), 5))
    weights = random_weights(rng, camera)
    dfeatures = rng.normal(size=(12, 12, 5))
    rule = open_rule()
    rule.alpha_max = 1 - 1e-9  # an opacity of 1 has a slope: it is not clamped away

    def loss(place=place):
        result = gsut.render(
            g, camera, place, features=features, features_background=np.arange(5), blend=rule,
            dtype="float64",
        )  # fmt: skip
        dimage, dalpha, ddepth = weights
        return float(
            np.sum(dimage * result.image) + np.sum(dalpha * result.alpha)
            + np.sum(ddepth * result.depth) + np.sum(dfeatures * result.features)
        )  # fmt: skip

    result = gsut.render(
        g, camera, place, features=features, features_background=np.arange(5), blend=rule,
        dtype="float64",
    )  # fmt: skip
    gradients = backward(result, weights, dfeatures)
    inside = g.opacities.copy()
    for name in ("means", "quats", "scales", "opacities", "sh"):
        array = getattr(g, name)
        chosen = range(4, 12) if name == "opacities" else range(0, array.size, 5)
        expected = central_differences(loss, array, chosen)
        slopes = getattr(gradients.gaussians, name).reshape(-1)[list(chosen)]
        assert relative_error(slopes, expected) < tolerances.RENDER_DIFFERENCES, name
    assert np.array_equal(g.opacities, inside)
    expected = central_differences(loss, features)
    assert relative_error(gradients.features, expected) < tolerances.RENDER_DIFFERENCES
    if not rolling:
        expected = pose_differences(loss, pose)
        assert relative_error(gradients.pose, expected) < tolerances.RENDER_DIFFERENCES


def test_gradient_to_an_opacity_of_exactly_one_is_one_sided_and_not_zero(rng):
    camera, pose = pinhole(12), np.eye(4)
    g = gsut.LinearGaussians([[0, 0, 4]], [[1, 0, 0, 0]], [[0.4, 0.4, 0.4]], [1.0])
    ones = np.ones((1, 1))

    def total(dtype):
        result = gsut.render(g, camera, pose, features=ones, dtype=dtype)
        zeros = np.zeros((12, 12, 3))
        slope = gsut.render_backward(result, zeros, dfeatures=np.ones((12, 12, 1)))
        return float(result.features.sum()), float(slope.gaussians.opacities[0])

    for dtype in ("float32", "float64"):
        g.opacities[0] = 1.0
        full, slope = total(dtype)
        g.opacities[0] = 0.999
        less, _ = total(dtype)
        assert slope > 0
        assert abs((full - less) / 0.001 - slope) < 0.01 * slope
        g.opacities[0] = 0.0
        assert total(dtype) == (0.0, 0.0)


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_linear_gaussians_match_logarithms_and_logits_in_image_and_gradients(rng, rolling):
    camera = fisheye(SIZE)
    pose, place = place_of(rng, rolling)
    g = make_scene(rng, camera, pose)
    linear = to_linear(g.to_dtype(np.float64)).to_dtype(np.float32)
    weights = random_weights(rng, camera)
    plain, found = gsut.render(g, camera, place), gsut.render(linear, camera, place)
    assert np.sqrt(np.mean((plain.image - found.image) ** 2)) < tolerances.RENDER_IMAGE_RMS
    old = backward(plain, weights, None).gaussians
    new = backward(found, weights, None).gaussians
    opacities = linear.opacities.astype(np.float64)
    pairs = {
        "means": (new.means, old.means),
        "quats": (new.quats, old.quats),
        "sh": (new.sh, old.sh),
        "scales": (new.scales * linear.scales, old.log_scales),
        "opacities": (new.opacities * opacities * (1 - opacities), old.opacity_logits),
    }
    for name, (slopes, expected) in pairs.items():
        assert relative_error(slopes, expected) < tolerances.RENDER_GRADIENT, name
    surfaces = [gsut.render_surface(result).normals for result in (plain, found)]
    assert np.sqrt(np.mean((surfaces[0] - surfaces[1]) ** 2)) < tolerances.RENDER_IMAGE_RMS


def test_features_in_slices_and_on_one_thread_have_the_same_bits(rng):
    camera = fisheye(SIZE)
    pose, place = place_of(rng, False)
    g = make_scene(rng, camera, pose, 300)
    features = rng.normal(size=(len(g), 70)).astype(np.float32)
    dfeatures = rng.normal(size=(SIZE, SIZE, 70)).astype(np.float32)
    dimage = np.zeros((SIZE, SIZE, 3), np.float32)

    def passes(first=0, last=70):
        result = gsut.render(g, camera, place, features=features[:, first:last])
        slopes = gsut.render_backward(result, dimage, dfeatures=dfeatures[..., first:last])
        return result.features, slopes.features, slopes.gaussians.means

    whole = passes()
    slices = [passes(0, 33), passes(33, 70)]
    assert np.array_equal(np.concatenate([part[0] for part in slices], axis=2), whole[0])
    assert np.array_equal(np.concatenate([part[1] for part in slices], axis=1), whole[1])
    error = relative_error(slices[0][2] + slices[1][2], whole[2])
    assert error < tolerances.RENDER_GRADIENT
    gsut.set_num_threads(1)
    again = passes()
    gsut.set_num_threads(0)
    assert all(np.array_equal(a, b) for a, b in zip(whole, again, strict=True))


def test_features_or_linear_gaussians_that_cannot_be_are_refused(rng):
    camera, pose = pinhole(16), np.eye(4)
    g = make_scene(rng, camera, pose, 5)
    with pytest.raises(gsut.InputError, match=r"features must have shape \(5, D\)"):
        gsut.render(g, camera, pose, features=np.ones((4, 2)))
    with pytest.raises(gsut.InputError, match=r"features_background must have shape \(2,\)"):
        gsut.render(g, camera, pose, features=np.ones((5, 2)), features_background=[1.0])
    with pytest.raises(gsut.InputError, match="features must be finite"):
        gsut.render(g, camera, pose, features=np.full((5, 2), np.nan))
    plain = gsut.render(g, camera, pose)
    with pytest.raises(gsut.InputError, match="dfeatures needs a render with features"):
        backward(plain, (np.zeros((16, 16, 3)), None, None), np.zeros((16, 16, 1)))
    values = np.ones((5, 2), np.float32)
    result = gsut.render(g, camera, pose, features=values)
    values[0] = 2.0
    with pytest.raises(gsut.InputError, match="have changed since they were rendered"):
        backward(result, (np.zeros((16, 16, 3)), None, None), np.zeros((16, 16, 2)))
    with pytest.raises(gsut.InputError, match="opacities must lie from 0 to 1"):
        gsut.LinearGaussians(g.means, g.quats, np.exp(g.log_scales), g.opacity_logits + 9)
    with pytest.raises(gsut.InputError, match="scales must lie from 0"):
        gsut.LinearGaussians(g.means, g.quats, g.log_scales - 9, np.ones(5))


def test_render_that_nothing_watches_has_the_gradients_of_the_gaussians_as_they_are(rng):
    camera, pose = pinhole(16), np.eye(4)
    g = make_scene(rng, camera, pose, 5)
    ones = np.ones((16, 16, 3))
    expected = gsut.render_backward(gsut.render(g, camera, pose), ones).gaussians.means
    unwatched = gsut.render(g, camera, pose, watch=False)
    assert np.array_equal(gsut.render_backward(unwatched, ones).gaussians.means, expected)
    g.log_scales += 0.1
    gsut.render_backward(unwatched, ones)  # not noticed
