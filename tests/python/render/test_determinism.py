"""The same bits of image and gradients on any number of threads, repeated, in any size."""

import dataclasses

import numpy as np
import pytest

import gsut
from random_scenes import (
    every_lens,
    fisheye,
    gaussians_in_view,
    list_isas,
    no_gaussians,
    pinhole,
    random_pose,
    random_weights,
    roll,
)

FIELDS = tuple(field.name for field in dataclasses.fields(gsut.Gaussians))
# The second time on eight threads: repeated with the buffers and caches of the first.
THREADS = (1, 2, 8, 8)


def bits_of(g, camera, pose, weights, **options):
    """Bytes of every output: image, alpha, depth, gradients, pose, touched, projection."""
    result = gsut.render(g, camera, pose, **options)
    found = gsut.render_backward(result, *weights)
    arrays = [result.image, result.alpha, result.depth, found.pose]
    arrays += [getattr(found.gaussians, name) for name in g.list_arrays()]
    if found.touched is not None:
        arrays.append(found.touched)
    projected = gsut.project(g, camera, pose, dtype=options.get("dtype", "float32"))
    arrays += [getattr(projected, f.name) for f in dataclasses.fields(projected)]
    return [array.tobytes() for array in arrays]


def assert_same_on_any_threads(g, camera, pose, weights, **options):
    ran = []
    for threads in THREADS:
        gsut.set_num_threads(threads)
        assert gsut.num_threads() == threads
        ran.append(bits_of(g, camera, pose, weights, **options))
    assert len(ran) == 4
    assert all(bits == ran[0] for bits in ran[1:])


# A 1 x 1 image, sizes that are no multiple of a tile, and one of several tiles.
@pytest.mark.parametrize("size", [(1, 1), (17, 3), (33, 65), (100, 70)])
@pytest.mark.parametrize("count", [0, 1, 17, 400])
def test_render_any_size_and_count_same_bits_on_1_2_and_8_threads(rng, size, count):
    camera, pose = pinhole(*size), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, count) if count else no_gaussians(1)
    weights = random_weights(rng, camera)
    for dtype in ("float32", "float64"):
        assert_same_on_any_threads(g, camera, pose, weights, dtype=dtype)


@pytest.mark.parametrize("parity", [None, "gsplat", "3dgrut"])
def test_render_every_isa_and_rule_same_bits_on_1_2_and_8_threads(rng, parity):
    camera, pose = fisheye(70), random_pose(rng)
    # More than a chunk of Gaussians (2048): sums over chunks are taken in order.
    g = gaussians_in_view(rng, camera, pose, 5000, sizes=(0.01, 0.05), opacity=-1.0)
    weights = random_weights(rng, camera)
    for isa in list_isas():
        gsut.machine.set_isa(isa)
        assert_same_on_any_threads(g, camera, pose, weights, parity=parity)


@pytest.mark.parametrize("rolling", [False, True], ids=["still", "rolling"])
@pytest.mark.parametrize(
    "kind",
    [
        {},
        {"order": "ray"},
        {"response": "extinction"},
        *({"primitive": name} for name in gsut.Gaussians.PRIMITIVES[1:]),
    ],
    ids=lambda kind: "".join(kind.values()),
)
def test_render_every_kind_same_bits_on_1_2_and_8_threads(rng, kind, rolling):
    camera, pose = fisheye(70), random_pose(rng)
    g = dataclasses.replace(gaussians_in_view(rng, camera, pose, 2500), **kind)
    place = roll(pose) if rolling else pose
    assert_same_on_any_threads(g, camera, place, random_weights(rng, camera))


def test_render_every_lens_same_bits_on_1_2_and_8_threads(rng):
    for _, camera in every_lens():
        pose = random_pose(rng)
        g = gaussians_in_view(rng, camera, pose, 200)
        assert_same_on_any_threads(g, camera, pose, random_weights(rng, camera))


def test_render_equal_depths_are_blended_by_index_on_any_threads(rng):
    # 3000 Gaussians at one distance in two colours: what lies in front is known from the index.
    camera, pose = pinhole(40), np.eye(4)
    g = gaussians_in_view(rng, camera, pose, 3000, sh_degree=0, sizes=(0.01, 0.1))
    g.means[:] = (0, 0, 2)
    weights = random_weights(rng, camera)
    for parity in (None, "gsplat"):
        assert_same_on_any_threads(g, camera, pose, weights, parity=parity)
        found = gsut.render(g, camera, pose, parity=parity).image
        expected = gsut.render(g, camera, pose, parity=parity, dtype="float64").image
        backwards = gsut.render(g[::-1].copy(), camera, pose, parity=parity).image
        assert np.abs(found - expected).max() < 1e-3
        assert np.abs(found - backwards).max() > 1e-2


def test_render_permuted_gaussians_with_distinct_depths_same_image(rng):
    camera, pose = fisheye(50), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 3000, sizes=(0.01, 0.05))
    order = rng.permutation(3000)
    distances = gsut.project(g, camera, pose).depths
    assert len(np.unique(distances)) > 2990
    g = g[np.unique(distances, return_index=True)[1]]
    order = rng.permutation(len(g))
    first, second = (gsut.render(part, camera, pose) for part in (g, g[order]))
    for name in ("image", "alpha", "depth"):
        assert np.array_equal(getattr(first, name), getattr(second, name))
    weights = random_weights(rng, camera)
    slopes, permuted = (gsut.render_backward(result, *weights) for result in (first, second))
    for field in FIELDS:
        rows = getattr(slopes.gaussians, field)[order]
        assert np.array_equal(rows, getattr(permuted.gaussians, field))


def test_render_gaussians_out_of_view_change_no_bit(rng):
    camera, pose = pinhole(50), np.eye(4)
    g = gaussians_in_view(rng, camera, pose, 500, sizes=(0.01, 0.05))
    behind = g.copy()
    behind.means[:, 2] *= -1
    both = gsut.Gaussians(
        *(
            np.stack([getattr(behind, f), getattr(g, f)], axis=1).reshape(
                -1, *getattr(g, f).shape[1:]
            )
            for f in FIELDS
        )
    )
    alone, among = gsut.render(g, camera, pose), gsut.render(both, camera, pose)
    assert np.array_equal(alone.image, among.image)
    weights = random_weights(rng, camera)
    slopes = gsut.render_backward(alone, *weights).gaussians
    found = gsut.render_backward(among, *weights).gaussians
    for field in FIELDS:
        assert np.array_equal(getattr(found, field)[1::2], getattr(slopes, field))
        assert np.all(getattr(found, field)[::2] == 0)
