"""Gaussians of several degrees of harmonics: same bits as with zeros stored, less memory."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import InputError, TrainOptions
from gsut.compact.harmonics import drop_harmonics
from gsut.compact.methods.pup import sum_fisher_matrices
from gsut.compact.scores import SeenView, sum_bases
from gsut.gaussians.packed_harmonics import (
    MixedGaussians,
    find_used_degrees,
    pack_harmonics,
    to_mixed,
)
from gsut.training.tuning.finetuning import finetune, finetune_options
from random_scenes import every_lens, fisheye, gaussians_in_view, random_pose
from rendered_dataset import write_dataset

COUNT = 400
GEOMETRY = ("means", "quats", "log_scales", "opacity_logits")


def with_degrees(rng, g, degrees):
    """Gaussians whose coefficients above these degrees are 0."""
    cut = g.copy()
    for degree in range(g.sh_degree):
        cut.sh[degrees == degree, (degree + 1) ** 2 :] = 0.0
    return cut


@pytest.fixture
def scene(rng):
    camera, pose = fisheye(64), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, COUNT, sh_degree=3, opacity=0.8)
    return with_degrees(rng, g, rng.integers(0, 4, COUNT)), camera, pose


def test_mixed_has_the_same_values_in_falling_order_of_degree(scene):
    g = scene[0]
    packed, degrees = to_mixed(g), find_used_degrees(g)
    back = packed.to_gaussians()
    order = np.argsort(-degrees.astype(int), kind="stable")
    for field in dataclasses.fields(g):
        assert np.array_equal(getattr(back, field.name), getattr(g, field.name)[order])
    counts = [np.count_nonzero(degrees >= degree) for degree in range(4)]
    for end, count in zip(packed.degree_ends, counts, strict=True):
        assert count <= end < count + 16
    assert packed.nbytes < sum(getattr(g, f.name).nbytes for f in dataclasses.fields(g)) * 0.7
    assert sum(len(band) for _, band in packed.split_bands()) == COUNT


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_mixed_renders_and_differentiates_to_the_same_bits_on_every_instruction_set(
    scene, sh_degree
):
    g, camera, pose = scene
    packed = to_mixed(g)
    plain, ran = packed.to_gaussians(), 0
    rng = np.random.default_rng(3)
    for isa in gsut.machine.available_isas():
        gsut.machine.set_isa(isa)
        one = gsut.render(plain, camera, pose, sh_degree=sh_degree)
        two = gsut.render(packed, camera, pose, sh_degree=sh_degree)
        assert np.count_nonzero(one.alpha) > 500
        assert one.image.tobytes() == two.image.tobytes()
        assert one.depth.tobytes() == two.depth.tobytes()
        weights = rng.normal(size=one.image.shape).astype(np.float32)
        expected = gsut.render_backward(one, weights)
        found = gsut.render_backward(two, weights)
        assert isinstance(found.gaussians, MixedGaussians)
        for name in GEOMETRY:
            a, b = getattr(expected.gaussians, name), getattr(found.gaussians, name)
            assert np.array_equal(a, b), (isa, name)
        for rows, band in found.gaussians.split_bands():
            assert np.array_equal(band, expected.gaussians.sh[rows, : band.shape[1]])
        np.testing.assert_array_equal(found.pose, expected.pose)
        ran += 1
    assert ran == len(gsut.machine.available_isas()) >= 1


def test_mixed_through_lines_and_every_lens_gives_the_same_bits(rng):
    ran = 0
    for _, camera in every_lens(width=64):
        pose = random_pose(rng)
        g = gaussians_in_view(rng, camera, pose, 60, sh_degree=2, opacity=1.0)
        packed = to_mixed(with_degrees(rng, g, rng.integers(0, 3, 60)))
        later = pose.copy()
        later[:3, 3] += 0.05
        for place in (pose, (pose, later)):
            shutter = None if place is pose else "top_to_bottom"
            one = gsut.render(packed.to_gaussians(), camera, place, shutter=shutter)
            two = gsut.render(packed, camera, place, shutter=shutter)
            assert one.image.tobytes() == two.image.tobytes()
            dimage = np.ones_like(one.image)
            a = gsut.render_backward(one, dimage).gaussians
            b = gsut.render_backward(two, dimage).gaussians
            assert np.array_equal(a.means, b.means)
            for rows, band in b.split_bands():
                assert np.array_equal(band, a.sh[rows, : band.shape[1]])
            ran += 1
    assert ran > 20


def test_mixed_in_double_is_the_reference_of_the_same_values(scene):
    g, camera, pose = scene
    packed = to_mixed(g)
    one = gsut.render(packed.to_gaussians(), camera, pose, dtype="float64")
    two = gsut.render(packed, camera, pose, dtype="float64")
    assert one.image.tobytes() == two.image.tobytes()


def test_mixed_fisher_matrices_and_jacobians_are_the_same(scene):
    g, camera, pose = scene
    packed = to_mixed(g)
    view = SeenView(camera, pose, np.array(camera.rays()[1], bool))
    np.testing.assert_array_equal(
        sum_fisher_matrices(packed, [view]), sum_fisher_matrices(packed.to_gaussians(), [view])
    )


@pytest.mark.parametrize("count", [0, 1, 15, 17, 33])
def test_mixed_of_few_or_no_gaussians_works(rng, count):
    camera, pose = fisheye(32), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 40, sh_degree=3)[:count]
    g = with_degrees(rng, g, rng.integers(0, 4, count))
    packed = to_mixed(g)
    assert len(packed) == count
    one = gsut.render(packed.to_gaussians(), camera, pose)
    assert one.image.tobytes() == gsut.render(packed, camera, pose).image.tobytes()


def test_mixed_that_is_wrong_is_refused(scene):
    packed, camera, pose = to_mixed(scene[0]), scene[1], scene[2]
    with pytest.raises(InputError, match="4 falling numbers"):
        dataclasses.replace(packed, degree_ends=(COUNT, 0, 16, 0))
    with pytest.raises(InputError, match="sh must have shape"):
        dataclasses.replace(packed, sh=packed.sh[:-1])
    n = COUNT - 8
    odd = MixedGaussians(
        *(getattr(packed, name) for name in GEOMETRY),
        np.zeros(3 * COUNT + 9 * n, np.float32), (COUNT, n, 0, 0),
    )  # fmt: skip
    with pytest.raises(InputError, match="multiples of 16"):
        gsut.render(odd, camera, pose)
    result = gsut.render(packed, camera, pose)
    with pytest.raises(InputError, match="degrees of harmonics"):
        result.renderer.backward(result.image, packed.to_gaussians(), np.zeros(COUNT, np.uint8))


def test_lighter_leaves_alone_what_it_would_not_save(rng, scene):
    g = scene[0]
    full = gaussians_in_view(rng, scene[1], scene[2], 50, sh_degree=1)
    assert pack_harmonics(full) is full
    assert isinstance(pack_harmonics(g), MixedGaussians)
    packed = to_mixed(g)
    assert pack_harmonics(packed) is packed


def test_finetuning_of_mixed_keeps_degrees_and_takes_the_same_steps(tmp_path, rng):
    data = gsut.load_dataset(write_dataset(tmp_path / "data", np.random.default_rng(20260821)))
    options = TrainOptions(steps=30, max_gaussians=300, sh_degree=2).resolve()
    start = gsut.train(data, options, progress=False).gaussians
    start.sh[:, 1:] += 0.01 * rng.normal(size=start.sh[:, 1:].shape).astype(np.float32)
    start = with_degrees(rng, start, rng.integers(0, 3, len(start)))
    packed = to_mixed(start)
    tuning = finetune_options(options, 10, len(packed))
    made, _ = finetune(data, packed, tuning)
    assert isinstance(made, MixedGaussians)
    assert made.degree_ends == packed.degree_ends
    # The same steps with all coefficients, those that are not stored put back to 0 after each.
    kept = np.zeros(packed.to_gaussians().sh.shape, bool)
    for rows, band in packed.split_bands():
        kept[rows, : band.shape[1]] = True
    plain, _ = finetune(
        data, packed.to_gaussians(), tuning,
        lambda loop, loss: np.copyto(loop.gaussians.sh, 0.0, where=~kept),
    )  # fmt: skip
    for name in GEOMETRY:
        assert np.array_equal(getattr(made, name), getattr(plain, name)), name
    assert np.array_equal(made.to_gaussians().sh, plain.sh)


def test_dropped_harmonics_give_degrees_that_mixed_finds_again(scene):
    g, camera, pose = scene
    view = SeenView(camera, pose, np.array(camera.rays()[1], bool))
    lowered = drop_harmonics(g, [view], lambda tried: float(-len(np.unique(tried.sh))), 50.0)
    assert np.all(find_used_degrees(lowered.gaussians) <= lowered.degrees)
    assert sum_bases(lowered.gaussians, [view]).shape[0] == COUNT
