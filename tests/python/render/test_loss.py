"""Tests the photometric loss and the metrics from Python, against OpenCV and closed forms."""

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError, _core, metrics, set_num_threads
from gsut.machine import set_isa
from random_scenes import list_isas, relative_error

pytestmark = pytest.mark.quick

HEIGHT, WIDTH = 60, 52


@pytest.fixture
def pair(rng):
    """A textured target (uint8) and a float32 image that differs from it."""
    base = cv2.GaussianBlur(rng.random((HEIGHT, WIDTH, 3)), (0, 0), 2.0)
    base = (base - base.min()) / (base.max() - base.min())
    target = np.round(base * 255).astype(np.uint8)
    image = (base + 0.1 * rng.standard_normal(base.shape)).astype(np.float32)
    return target, image


def circle():
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return (y - HEIGHT / 2) ** 2 + (x - WIDTH / 2) ** 2 < 24.0**2


def test_ssim_whole_windows_agrees_with_opencv(pair):
    # OpenCV's quality module: same window and constants on the scale 0..255, borders reflected;
    # its map agrees wherever the window lies inside the image.
    target, image = pair
    a, b = target.astype(np.float64), np.clip(image, 0, 1).astype(np.float64) * 255
    _, quality_map = cv2.quality.QualitySSIM_compute(a, b)
    expected = quality_map[5:-5, 5:-5, :3].mean()
    assert metrics.ssim(a / 255, b / 255) == pytest.approx(expected, abs=tolerances.METRIC_ROUNDING)


def test_psnr_agrees_with_opencv(pair):
    target, image = pair
    b = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    assert metrics.psnr(target, b) == pytest.approx(
        cv2.PSNR(target, b), abs=tolerances.METRIC_ROUNDING
    )


def test_loss_value_is_composed_of_l1_and_dssim(pair):
    target, image = pair
    mask = circle()
    made = _core.PhotometricTarget(target, mask, window_rule="valid")
    loss, l1, dssim = made.value(image, ssim_weight=0.3)
    truth = target / 255.0
    assert loss == pytest.approx(0.7 * l1 + 0.3 * dssim, rel=tolerances.METRIC_ROUNDING)
    assert l1 == pytest.approx(np.abs(image - truth)[mask].mean(), rel=tolerances.LOSS_RELATIVE)
    assert dssim == pytest.approx(
        1 - metrics.ssim(image, target, mask), rel=tolerances.LOSS_RELATIVE
    )
    assert _core.photometric_loss(made, image, ssim_weight=0.3)[0] == loss


@pytest.mark.parametrize("rule", ["partial", "valid"])
def test_loss_of_two_greys_has_the_closed_form_and_of_equal_images_is_zero(rule):
    # No variance: SSIM is its luminance term alone, under any mask, rim or not.
    one, other = (np.full((HEIGHT, WIDTH, 3), grey) for grey in (0.3, 0.7))
    ssim = (2 * 0.3 * 0.7 + 1e-4) / (0.3**2 + 0.7**2 + 1e-4)
    loss, _ = _core.photometric_loss_reference(one, other, circle(), 0.2, rule)
    assert loss == pytest.approx(0.8 * 0.4 + 0.2 * (1 - ssim), abs=tolerances.METRIC_ROUNDING)
    assert metrics.ssim(one, other, circle(), rule) == pytest.approx(ssim, rel=1e-9)
    same = one.astype(np.float32)
    made = _core.PhotometricTarget(same, circle(), window_rule=rule)
    loss, gradient = _core.photometric_loss(made, same)
    assert loss == 0 and not gradient.any()


def make_case(rng, height, width, kind, noise=0.1):
    """A smooth target of 8 bits with texture, an image off by noise; a mask or None."""
    y, x, channel = np.indices((height, width, 3))
    smooth = 0.5 + 0.4 * np.sin(0.07 * x + 0.3 * channel) * np.cos(0.05 * y)
    texture = rng.uniform(-0.1, 0.1, smooth.shape)
    target = (np.round(255 * np.clip(smooth + texture, 0, 1)) / 255).astype(np.float32)
    image = (target + noise * rng.standard_normal(target.shape)).astype(np.float32)
    if kind == "none":
        return target, image, None
    mask = np.zeros((height, width), bool)
    if kind == "circle":
        mask |= np.hypot((y + 0.5) / height - 0.5, (x + 0.5) / width - 0.5)[..., 0] < 0.48
    if kind == "random":
        mask |= rng.random((height, width)) < 0.8
    mask.flat[height * width // 2] = True
    return target, image, mask


@pytest.mark.parametrize("rule", ["partial", "valid"])
@pytest.mark.parametrize("kind", ["none", "random", "circle"])
@pytest.mark.parametrize("size", [(16, 14), (4, 9)])
def test_gradient_of_the_reference_matches_central_differences(rng, size, kind, rule):
    target, image, mask = make_case(rng, *size, kind)
    target, image, step = target.astype(float), image.astype(float), tolerances.LOSS_STEP

    def loss():
        return _core.photometric_loss_reference(target, image, mask, 0.6, rule)

    gradient = loss()[1]
    chosen = np.flatnonzero(np.abs(image - target).ravel() > 10 * step)[::5]  # not the kink of L1
    differences = []
    for index in chosen:
        kept, sides = image.flat[index], []
        for sign in (1, -1):
            image.flat[index] = kept + sign * step
            sides.append(loss()[0])
        image.flat[index] = kept
        differences.append((sides[0] - sides[1]) / (2 * step))
    assert len(chosen) > 15
    assert relative_error(gradient.flat[chosen], differences) < tolerances.LOSS_DIFFERENCES


@pytest.mark.parametrize("rule", ["partial", "valid"])
@pytest.mark.parametrize("kind", ["none", "circle", "random", "one pixel"])
def test_every_instruction_set_matches_the_reference(rng, kind, rule):
    sizes = ((1, 1), (5, 7), (11, 11), (12, 30), (67, 29), (70, 530), (40, 40))
    for height, width in sizes:
        target, image, mask = make_case(rng, height, width, kind, 1e-3 if height == 40 else 0.1)
        reference, expected = _core.photometric_loss_reference(
            target.astype(float), image.astype(float), mask, 0.2, rule
        )
        for isa in gsut.machine.available_isas():
            set_isa(isa)
            made = _core.PhotometricTarget(target, mask, window_rule=rule)
            loss, gradient = _core.photometric_loss(made, image, ssim_weight=0.2)
            windows = (height - 10) * (width - 10) if rule == "valid" else made.pixels
            many = min(windows, made.pixels) >= tolerances.LOSS_MANY_PIXELS
            single = tolerances.LOSS_SINGLE_WINDOW
            assert abs(loss / reference - 1) < (tolerances.LOSS_RELATIVE if many else single)
            error = relative_error(gradient, expected)
            assert error < (tolerances.LOSS_GRADIENT_RELATIVE if many else single), (isa, width)
            assert made.value(image, ssim_weight=0.2)[0] == loss


def test_loss_has_the_same_bits_on_any_number_of_threads_and_with_kept_statistics(rng):
    target, image, mask = make_case(rng, 150, 600, "circle")
    found = []
    for threads in (1, 2, 8):
        set_num_threads(threads)
        for keep in (False, True):
            photograph = np.round(255 * target).astype(np.uint8)
            made = _core.PhotometricTarget(photograph, mask, keep_statistics=keep)
            loss, gradient = _core.photometric_loss(made, image)
            found.append((loss, gradient.tobytes()))
    assert len(found) == 6 and len(set(found)) == 1


def test_pixels_without_the_mask_may_hold_anything_and_get_no_gradient(rng):
    target, image, mask = make_case(rng, 60, 50, "circle")
    loss, clean = _core.photometric_loss(_core.PhotometricTarget(target, mask), image)
    target[~mask] = image[~mask] = np.nan
    again, found = _core.photometric_loss(_core.PhotometricTarget(target, mask), image)
    assert (~mask).sum() > 100 and not clean[~mask].any()
    assert loss == again
    np.testing.assert_array_equal(found, clean)


def test_loss_gradient_is_written_into_the_given_buffer(pair):
    target, image = pair
    made = _core.PhotometricTarget(target)
    buffer = np.full_like(image, np.nan)
    _, gradient = _core.photometric_loss(made, image, buffer)
    assert gradient is buffer
    np.testing.assert_array_equal(buffer, _core.photometric_loss(made, image)[1])


def test_loss_descent_along_gradient_lowers_it(pair):
    target, image = pair
    made = _core.PhotometricTarget(target, circle())
    first, gradient = _core.photometric_loss(made, image)
    step = 1e-3 / np.abs(gradient).max()
    assert made.value(image - np.float32(step) * gradient)[0] < first


def test_target_memory_is_that_of_its_bytes(pair):
    target, _ = pair
    lean = _core.PhotometricTarget(target)
    kept = _core.PhotometricTarget(target, keep_statistics=True)
    assert lean.nbytes < target.nbytes + 4 * (HEIGHT + WIDTH) + 1
    assert kept.nbytes - lean.nbytes == 24 * HEIGHT * WIDTH


def test_mask_of_any_integer_type_is_read_as_nonzero(pair):
    target, _ = pair
    mask = circle()
    kinds = (mask, mask.astype(np.uint8) * 255, mask.astype(np.int32) * 256)
    for kind in kinds:
        assert _core.PhotometricTarget(target, kind).pixels == np.count_nonzero(mask)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, i: _core.PhotometricTarget(t[..., :2]), r"image must have shape"),
        (lambda t, i: _core.PhotometricTarget(t.astype(np.uint16)), r"uint8"),
        (lambda t, i: _core.PhotometricTarget(t.astype(np.float32)), r"give finite values"),
        (lambda t, i: _core.PhotometricTarget(t, np.zeros((HEIGHT, WIDTH), bool)), r"no pixel"),
        (lambda t, i: _core.PhotometricTarget(t, np.ones((WIDTH, HEIGHT), bool)), r"mask must"),
        (lambda t, i: _core.PhotometricTarget(t, np.ones((HEIGHT, WIDTH))), r"bool or integers"),
        (lambda t, i: _core.PhotometricTarget(t, window_rule="same"), r"partial, valid"),
        (lambda t, i: _core.photometric_loss(_core.PhotometricTarget(t), i[1:]), r"image must"),
        (
            lambda t, i: _core.photometric_loss(_core.PhotometricTarget(t), i.astype(np.uint8)),
            r"floating point",
        ),
        (lambda t, i: _core.photometric_loss(_core.PhotometricTarget(t), i, i), r"itself"),
        (
            lambda t, i: _core.photometric_loss(_core.PhotometricTarget(t), i, ssim_weight=-1),
            r"ssim_weight",
        ),
        (lambda t, i: metrics.psnr(t, i[1:]), r"b must have shape"),
        (lambda t, i: metrics.psnr(t[..., 0], i), r"a must have shape"),
        (lambda t, i: metrics.ssim(t, i, np.zeros((HEIGHT, WIDTH), bool)), r"no pixel"),
        (lambda t, i: metrics.ring_psnr(t, i, np.zeros((2, 2))), r"angles must"),
        (
            lambda t, i: metrics.ring_psnr(t, i, np.zeros((HEIGHT, WIDTH)), (30, 30)),
            r"increasing",
        ),
        (
            lambda t, i: metrics.weighted_psnr(t, i, np.full((HEIGHT, WIDTH), np.nan)),
            r"pixel weights",
        ),
    ],
)
def test_wrong_input_raises_one_clear_sentence(pair, change, message):
    with pytest.raises(InputError, match=message):
        change(*pair)


def test_psnr_nan_in_image_is_not_a_plausible_number(pair):
    target, image = pair
    image[3, 4] = np.nan
    assert np.isnan(metrics.psnr(target, image))
    assert np.isfinite(metrics.psnr(target, image, ~np.isnan(image[..., 0])))


def test_ring_psnr_rings_are_disjoint_and_cover_the_mask(pair):
    target, image = pair
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    angles = np.radians(3.8 * np.hypot(y - HEIGHT / 2, x - WIDTH / 2))
    angles[0, 0] = np.nan
    rings = metrics.ring_psnr(target, image, angles, mask=circle())
    assert [ring["from_degrees"] for ring in rings] == [0, 30, 60, 80]
    assert [ring["to_degrees"] for ring in rings] == [30, 60, 80, 180]
    assert sum(ring["pixels"] for ring in rings) == np.count_nonzero(circle())
    inner = circle() & (np.degrees(angles) < 30)
    assert rings[0]["psnr"] == metrics.psnr(target, image, inner)


def test_ring_psnr_empty_ring_has_no_number(pair):
    target, image = pair
    rings = metrics.ring_psnr(target, image, np.zeros((HEIGHT, WIDTH)))
    assert [ring["psnr"] is None for ring in rings] == [False, True, True, True]


def test_weighted_psnr_equal_weights_is_psnr(pair):
    target, image = pair
    weights = np.full((HEIGHT, WIDTH), 1e-3)
    assert metrics.weighted_psnr(target, image, weights) == pytest.approx(
        metrics.psnr(target, image), abs=tolerances.METRIC_ROUNDING
    )
    # Half the weight on equal pixels: 3 dB more.
    one, other = np.full((2, 2, 3), 0.5), np.full((2, 2, 3), 0.6)
    other[0] = 0.5
    assert metrics.weighted_psnr(one, other, np.ones((2, 2))) == pytest.approx(23.0103, abs=1e-4)
    with pytest.raises(InputError, match="pixel weights"):
        metrics.weighted_psnr(one, other, np.array([[1.0, -1.0], [1.0, 1.0]]))


def test_color_corrected_psnr_undoes_an_affine_change(pair):
    target, _ = pair
    truth = target / 255.0 * 0.6 + 0.2
    matrix = np.array([[0.8, 0.1, 0.0], [0.0, 0.9, 0.05], [0.1, 0.0, 0.7]])
    changed = truth @ matrix.T + 0.03
    assert metrics.psnr(changed, truth) < 30
    assert metrics.color_corrected_psnr(changed, truth, circle()) > tolerances.EXACT_PSNR


def test_color_corrected_psnr_of_a_flat_image_leaves_it_unchanged():
    flat = np.full((8, 8, 3), 0.5)
    assert metrics.color_corrected_psnr(flat, flat) == np.inf


@pytest.mark.parametrize("keep_statistics", [False, True])
@pytest.mark.parametrize("with_falloff", [False, True])
def test_loss_of_a_photograph_in_its_light_matches_reference(
    pair, rng, keep_statistics, with_falloff
):
    photograph, image = pair
    mask = circle()
    gain = np.array([1.3, 0.8, 1.05], np.float32)
    falloff = rng.uniform(0.8, 1.6, photograph.shape).astype(np.float32)
    light = gain * falloff if with_falloff else gain
    reference, expected = _core.photometric_loss_reference(photograph / 255.0 * light, image, mask)
    for isa in list_isas():
        set_isa(isa)
        target = _core.PhotometricTarget(photograph, mask, "partial", keep_statistics)
        plain, _ = _core.photometric_loss(target, image)
        plane = _core.FalloffPlane(falloff) if with_falloff else None
        target.set_light(gain, plane)
        loss, gradient = _core.photometric_loss(target, image)
        target.set_light(gain, plane)  # stated again: now with statistics of it
        assert _core.photometric_loss(target, image)[0] == loss
        assert loss == pytest.approx(reference, rel=tolerances.LOSS_RELATIVE)
        error = np.linalg.norm(gradient - expected) / np.linalg.norm(expected)
        assert error < tolerances.LOSS_GRADIENT_RELATIVE
        target.set_light([1.0, 1.0, 1.0])  # and back
        assert _core.photometric_loss(target, image)[0] == plain


def test_light_sums_give_the_gain_of_what_is_neither_black_nor_saturated(pair, rng):
    _, image = pair
    image = np.clip(image, 0.01, 1.0)
    gain = np.array([0.7, 0.5, 0.6], np.float32)
    photograph = (image * gain).astype(np.float32)
    bins = rng.integers(0, 5, image.shape[:2]).astype(np.uint8)
    tc, cc = _core.PhotometricTarget(photograph, circle()).light_sums(image, bins, 5)
    rows = np.zeros(image.shape[:2], bool)
    rows[::4] = True
    used = circle() & rows & (photograph > 0.02).all(axis=2) & (photograph < 0.96).all(axis=2)
    for b in range(5):
        chosen = image[used & (bins == b)].astype(np.float64)
        np.testing.assert_allclose(cc[b], (chosen**2).sum(axis=0), rtol=tolerances.LIGHT_SUMS)
        np.testing.assert_allclose(tc[b] / cc[b], gain, rtol=tolerances.LIGHT_SUMS)


def test_light_that_is_none_is_refused(pair):
    photograph, image = pair
    target = _core.PhotometricTarget(photograph)
    with pytest.raises(InputError, match="inverse_gain holds 0"):
        target.set_light([1.0, 0.0, 1.0])
    with pytest.raises(InputError, match="give three for each of"):
        target.set_light([1.0, 1.0, 1.0], _core.FalloffPlane(np.ones((3, 4, 3), np.float32)))
    with pytest.raises(InputError, match="inverse_falloff holds 0"):
        _core.FalloffPlane(np.zeros((*photograph.shape[:2], 3), np.float32))
    with pytest.raises(InputError, match="from num_bins on, which is 2"):
        target.light_sums(image, np.full(image.shape[:2], 2, np.uint8), 2)


def test_trimming_takes_areas_that_differ_and_leaves_edges(pair, rng):
    image = rng.random((HEIGHT, WIDTH, 3), np.float32)
    photograph = np.clip(image + 0.01 * rng.standard_normal(image.shape), 0, 1).astype(np.float32)
    photograph[20:45, 15:40] = 1 - image[20:45, 15:40]  # an area
    photograph[5] = 1 - image[5]  # an edge
    made = []
    for threads in (1, 2, 8):
        set_num_threads(threads)
        gradient = np.ones_like(image)
        count = _core.trim_gradient(_core.PhotometricTarget(photograph), image, gradient)
        gone = (gradient == 0).all(axis=2)
        assert count == gone.sum() and gone[24:41, 19:36].all()
        assert not gone[:12].any() and not gone[50:].any() and not gone[:, :10].any()
        made.append(gradient.tobytes())
    assert len(set(made)) == 1
    # What differs only by its light does not differ.
    target = _core.PhotometricTarget(0.5 * image)
    target.set_light([2.0, 2.0, 2.0])
    assert _core.trim_gradient(target, image, np.ones_like(image)) == 0
