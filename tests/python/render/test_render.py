"""The tiled float renderer against the double reference, on every lens and instruction set."""

import dataclasses
import os

import numpy as np
import pytest

import flips
import gsut
import tolerances
from gsut import InputError, _core
from random_scenes import (
    every_lens,
    fisheye,
    gaussians_in_view,
    list_isas,
    pinhole,
    random_pose,
    random_weights,
    roll,
)

LENSES = every_lens(width=48)
PARITIES = (None, "gsplat", "3dgrut")
FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))
RANDOM_SCENES = max(3, -(-36 // len(LENSES))) * len(LENSES)  # each lens by each rule


BACKGROUND = (0.3, 0.1, 0.6)


def test_render_float_random_scenes_every_lens_and_isa_match_double():
    pixels, flipped, seen = 0, 0, set()
    for seed in range(RANDOM_SCENES):
        rng = np.random.default_rng([seed, 7])
        name, camera = LENSES[seed % len(LENSES)]
        pose = random_pose(rng)
        g = gaussians_in_view(
            rng, camera, pose, 150, sh_degree=seed % 4, sizes=(0.01, 0.3), opacity=0.5
        )
        parity = PARITIES[seed // len(LENSES) % len(PARITIES)]
        options = {"parity": parity, "background": BACKGROUND}
        expected = gsut.render(g, camera, pose, dtype="float64", **options)
        assert (expected.alpha > 0.2).mean() > 0.1, name
        weights = random_weights(rng, camera)
        flipped += flips.assert_isas_match(expected, weights, camera, pose, explain=True, **options)
        pixels += len(list_isas()) * expected.alpha.size
        seen.add((name, parity))
    print(f"{pixels} pixels; of these flipped: {flipped}")
    assert flipped <= tolerances.RENDER_FLIPS_A_PIXEL * pixels
    assert len(seen) == len(LENSES) * len(PARITIES)


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
def test_render_float_every_isa_runs_its_own_kernels(rng, rolling):
    # Fused or not, and in vectors of 4, 8 or 16: sums differ in their last bits.
    camera, pose = fisheye(64), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 100)
    place = roll(pose) if rolling else pose
    weights, bits = random_weights(rng, camera), {}
    for isa in gsut.machine.available_isas():
        gsut.machine.set_isa(isa)
        assert gsut.machine.active_isa() == isa
        found = gsut.render_backward(gsut.render(g, camera, place), *weights)
        bits[isa] = found.gaussians.means.tobytes()
    assert len(set(bits.values())) == len(bits)


MISS_ROUNDS = {"ordinary": 12, "needles": 12, "close": 10, "huge": 3, "tiny": 1}
# (Gaussian, camera) pairs in all, however many lenses there are.
MISS_PAIRS = 100_000 if os.environ.get("GSUT_EVERY_LENS") else 25_000
GAUSSIANS_A_CAMERA = -(-MISS_PAIRS // (sum(MISS_ROUNDS.values()) * len(LENSES)))


@pytest.mark.filterwarnings("ignore:.* as long as wide:RuntimeWarning")
@pytest.mark.parametrize("kind", flips.SHAPES)
def test_render_float_misses_no_gaussian_that_double_sees(rng, kind):
    width = 400 if kind == "tiny" else 36  # where a splat's ellipse alone bounds it
    pairs = seen = 0
    for _ in range(MISS_ROUNDS[kind]):
        for name, camera in every_lens(width):
            pose = random_pose(rng)
            shape = {"sh_degree": 0, "opacity": -2.0, **flips.SHAPES[kind]}
            g = gaussians_in_view(rng, camera, pose, GAUSSIANS_A_CAMERA, **shape)
            g.means[::10] += rng.normal(size=g.means[::10].shape) * 3  # some out of view
            pairs += len(g)
            seen += flips.assert_none_missed(g, camera, pose, name)
    print(f"{kind}: none missed of {seen} seen in {pairs} (Gaussian, camera) pairs")
    assert pairs == MISS_ROUNDS[kind] * len(LENSES) * GAUSSIANS_A_CAMERA
    assert seen > pairs / 15  # tiny ones mostly fall between pixels


def test_render_harmonics_above_the_degree_are_ignored_and_have_no_gradient(rng):
    camera, pose = pinhole(32), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 30, sh_degree=3)
    weights = random_weights(rng, camera)
    for dtype in ("float32", "float64"):
        for degree in range(4):
            k = (degree + 1) ** 2
            cut = gsut.Gaussians(*(getattr(g, f) for f in FIELDS[:-1]), g.sh[:, :k])
            whole = gsut.render(g, camera, pose, sh_degree=degree, dtype=dtype)
            short = gsut.render(cut, camera, pose, dtype=dtype)
            assert np.array_equal(whole.image, short.image)
            of_whole = gsut.render_backward(whole, *weights).gaussians.sh
            of_short = gsut.render_backward(short, *weights).gaussians.sh
            assert np.array_equal(of_whole[:, :k], of_short)
            assert np.all(of_whole[:, k:] == 0)


def test_render_pose_object_with_a_matrix_is_taken(rng):
    class Placed:
        matrix = random_pose(rng)

    camera = pinhole(20)
    g = gaussians_in_view(rng, camera, Placed.matrix, 10)
    for dtype in ("float32", "float64"):
        by_object = gsut.render(g, camera, Placed(), dtype=dtype)
        assert np.array_equal(
            by_object.image, gsut.render(g, camera, Placed.matrix, dtype=dtype).image
        )
        projected = gsut.project(g, camera, Placed(), dtype=dtype)
        assert np.array_equal(
            projected.depths, gsut.project(g, camera, Placed.matrix, dtype=dtype).depths
        )


def test_render_backward_touched_marks_what_a_pixel_saw(rng):
    camera, pose = pinhole(32), np.eye(4)
    g = gaussians_in_view(rng, camera, pose, 40, opacity=2.0)
    g.means[20:, 2] *= -1  # behind the camera
    result = gsut.render(g, camera, pose)
    found = gsut.render_backward(result, *random_weights(rng, camera))
    assert found.touched[:20].sum() > 10
    assert not found.touched[20:].any()
    for field in FIELDS:
        assert np.all(getattr(found.gaussians, field)[~found.touched] == 0)
    statistics = result.get_statistics()
    assert statistics["num_visible"] <= 20
    assert 0 < statistics["num_contributing_pairs"] <= statistics["num_pairs"]
    assert gsut.render(g, camera, pose, dtype="float64").get_statistics() == {}


def test_renderer_reused_for_other_sizes_gives_the_same_bits_as_a_new_one(rng):
    renderer, pose = _core.Renderer(), random_pose(rng)
    for size, count in ((40, 50), (100, 300), (33, 3), (1, 1), (70, 0), (40, 50)):
        camera = fisheye(size)
        g = gaussians_in_view(rng, camera, pose, count)
        image = np.full((size, size, 3), np.nan, np.float32)
        renderer.render(g, _core.RenderJob(camera, pose), image)
        expected = gsut.render(g, camera, pose)
        assert np.array_equal(image, expected.image)
        weights = random_weights(rng, camera)
        gradients = gsut.render_backward(expected, weights[0])
        out, touched = g.copy(), np.zeros(len(g), np.uint8)
        dpose = renderer.backward(weights[0].astype(np.float32), out, touched)
        assert np.array_equal(dpose, gradients.pose)
        assert np.array_equal(out.means, gradients.gaussians.means)
        assert np.array_equal(touched, gradients.touched)


def test_renderer_backward_without_what_it_needs_is_refused(rng):
    camera, pose = pinhole(16), np.eye(4)
    g = gaussians_in_view(rng, camera, pose, 5)
    image = np.zeros((16, 16, 3), np.float32)
    depth = np.zeros((16, 16), np.float32)
    touched = np.zeros(5, np.uint8)
    renderer = _core.Renderer()
    with pytest.raises(InputError):
        renderer.backward(image, g.copy(), touched)
    renderer.render(g, _core.RenderJob(camera, pose, keep=False), image)
    with pytest.raises(InputError, match="keep_for_backward"):
        renderer.backward(image, g.copy(), touched)
    renderer.render(g, _core.RenderJob(camera, pose), image)
    with pytest.raises(InputError, match="depth"):
        renderer.backward(image, g.copy(), touched, ddepth=depth)
    with pytest.raises(InputError):
        renderer.backward(image, g[:4].copy(), touched[:4].copy())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"parity": "inria"}, "gsplat, 3dgrut"),
        ({"parity": "gsplat", "blend": gsut.BlendRule()}, "parity or blend"),
        ({"background": (0.0, 1.0)}, "3 finite numbers, found"),
        ({"camera_from_world": np.diag([1.0, 1, -1, 1])}, "determinant"),
        ({"camera_from_world": np.eye(4)[:3]}, "camera_from_world"),
        ({"dtype": "float16"}, "float32, float64"),
        ({"order": "random"}, "distance, z, ray, integral"),
        ({"response": "beta"}, "maximum, extinction, density"),
        ({"order": "ray", "blend": gsut.BlendRule()}, "order or blend"),
    ],
)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_render_bad_argument_is_refused_with_what_to_do(rng, arguments, message, dtype):
    g = gaussians_in_view(rng, pinhole(), np.eye(4), 3)
    arguments = {"camera_from_world": np.eye(4), "dtype": dtype, **arguments}
    with pytest.raises(InputError, match=message):
        gsut.render(g, pinhole(), **arguments)


def make_linear(g):
    opacities = 1 / (1 + np.exp(-g.opacity_logits))
    return gsut.LinearGaussians(g.means, g.quats, np.exp(g.log_scales), opacities, g.sh)


DOUBLE, VIEW = "float64", (pinhole(8), np.eye(4))
REFUSED = {
    "integral in float32": (lambda g: gsut.render(g, *VIEW, order="integral"), "float64"),
    "density in float32": (lambda g: gsut.render(g, *VIEW, response="density"), "float64"),
    "response of linear ones": (
        lambda g: gsut.render(make_linear(g), *VIEW, response="extinction"), "logits",
    ),
    "density of triangles": (
        lambda g: gsut.render(dataclasses.replace(g, primitive="triangle", response="density"),
                              *VIEW, dtype=DOUBLE), "has no density along a ray",
    ),
    "integral of triangles": (
        lambda g: gsut.render(dataclasses.replace(g, primitive="triangle"), *VIEW, dtype=DOUBLE,
                              order="integral"), 'primitive "triangle" has no density along a ray',
    ),
    "surface in double": (
        lambda g: gsut.render_surface(gsut.render(g, *VIEW, dtype=DOUBLE)), "float32",
    ),
    "median along the ray": (
        lambda g: gsut.rendering.measure_depth(gsut.render(g, *VIEW, order="ray"), "median"),
        r"order \"ray\".*distance",
    ),
    "tiles of another shape": (
        lambda g: _core.Renderer().render(
            g, _core.RenderJob(*VIEW, tiles=np.ones((7, 6), "u1")), np.zeros((8, 8, 3), "f4")
        ), "tiles",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_render_of_what_does_not_go_together_is_refused(rng, name):
    call, message = REFUSED[name]
    with pytest.raises(InputError, match=message):
        call(gaussians_in_view(rng, *VIEW, 3))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_render_backward_wrong_shape_is_refused_with_its_name(rng, dtype):
    camera = pinhole(20, 10)
    g = gaussians_in_view(rng, camera, np.eye(4), 3)
    result = gsut.render(g, camera, np.eye(4), dtype=dtype)
    dimage = np.zeros((10, 20, 3))
    for wrong, name in (
        ((np.zeros((20, 10, 3)),), "dimage"),
        ((dimage, np.zeros((20, 10))), "dalpha"),
        ((dimage, None, np.zeros((10, 20, 1))), "ddepth"),
    ):
        with pytest.raises(InputError, match=name):
            gsut.render_backward(result, *wrong)


def test_render_image_too_small_for_its_field_is_refused_in_float_only(rng):
    # One tile of 8 x 8 pixels over 300 degrees has no plane of its own.
    camera = fisheye(8, degrees=300)
    g = gaussians_in_view(rng, camera, np.eye(4), 5)
    with pytest.raises(InputError, match="float64"):
        gsut.render(g, camera, np.eye(4))
    assert gsut.render(g, camera, np.eye(4), dtype="float64").alpha.max() > 0
