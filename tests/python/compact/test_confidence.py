"""How sure renders are: sums over photographs, calibration, what was never seen, files."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import surface_scenes
import tolerances
from gsut import InputError
from gsut.cli import main
from gsut.cli._render_confidence import ConfidenceOutput
from gsut.compact import blend_weights, list_seen_views, measure_confidence
from gsut.render import Confidence
from small_run import inward_pose, scene_from_arrays

COUNT = 300
CAMERA = gsut.Camera("pinhole", [40.0, 40.0, 16, 16], 32, 32)


@pytest.fixture
def scene(tmp_path):
    """Four training views and two held-out ones of random pixels, around the origin."""
    made = scene_from_arrays(tmp_path / "data", CAMERA)
    return made.replace(world_offset=np.zeros(3))


@pytest.fixture
def ball(rng):
    """Opaque Gaussians on a sphere about the origin; the last lies behind all cameras."""
    means = rng.normal(size=(COUNT, 3))
    means *= 0.6 / np.linalg.norm(means, axis=1, keepdims=True)
    means[-1] = (0.0, 0.0, 60.0)
    return gsut.Gaussians(
        means, rng.normal(size=(COUNT, 4)), np.full((COUNT, 3), math.log(0.1)),
        np.full(COUNT, 2.0), rng.uniform(-1, 1, (COUNT, 1, 3)),
    ).to_dtype(np.float32)  # fmt: skip


@pytest.fixture
def confidence(scene, ball):
    return measure_confidence(scene, ball)


def test_residuals_times_weights_add_up_to_differences_times_alpha(scene, ball, confidence):
    expected = 0.0
    for index in scene.train_indices:
        result = gsut.render(ball, scene.camera(index), scene.views[index].motion)
        difference = np.abs(np.clip(result.image, 0, 1) - scene.image(index) / 255.0).mean(axis=2)
        expected += float((difference * result.alpha)[scene.mask(index)].sum())
    found = float((confidence.residual.astype(float) * confidence.weight).sum())
    assert expected > 10
    assert abs(found - expected) < tolerances.CONFIDENCE_SUMS * expected


def test_views_of_a_gaussian_are_at_most_those_that_show_it(scene, ball, confidence):
    views = list_seen_views(scene, scene.train_indices)
    shown = np.stack([blend_weights(ball, [view]) for view in views])
    np.testing.assert_allclose(confidence.weight, shown.sum(axis=0), rtol=1e-6)
    seen = confidence.weight > 0
    assert np.all(confidence.views[seen] <= (shown > 0).sum(axis=0)[seen] * (1 + 1e-6))
    assert confidence.views[seen].max() > 1.5 and confidence.weight[-1] == 0


def test_place_that_no_view_shows_gets_no_number(ball, confidence):
    above = np.eye(4)
    above[:3, 3] = (0.0, 0.0, -59.0)  # looks at the Gaussian that is behind all cameras
    result = gsut.render(ball, CAMERA, above, confidence=confidence)
    covered = result.alpha > 0.6
    assert covered.sum() > 5
    assert np.all(result.seen_views[covered] == 0)
    assert np.all(np.isnan(result.color_sigma[covered]))
    assert np.all(np.isnan(result.depth_sigma[covered]))


def test_place_that_views_show_gets_finite_sigmas(ball, confidence):
    result = gsut.render(ball, CAMERA, inward_pose(0.3), confidence=confidence)
    seen = result.seen_views > 0
    assert seen.sum() > 50 and np.all(result.alpha[seen] > 0.4)
    assert np.all(result.color_sigma[seen] > 0) and np.all(result.depth_sigma[seen] > 0)
    plain = gsut.render(ball, CAMERA, inward_pose(0.3))
    # The sigmas are blended as features, whose kernels round differently.
    off = np.sqrt(np.mean((plain.image - result.image) ** 2))
    assert off < tolerances.RENDER_IMAGE_RMS and plain.color_sigma is None


def test_factors_bound_shares_of_held_out_pixels(rng, confidence):
    ratios = [rng.exponential(size=5000) for _ in range(6)]
    found = confidence.calibrate(ratios)
    exact = -np.log1p(-found.levels)
    np.testing.assert_allclose(found.factors, exact, rtol=tolerances.CONFIDENCE_QUANTILES)
    np.testing.assert_allclose(found.held, found.levels, atol=tolerances.CONFIDENCE_QUANTILES)
    assert len(found.held_by_view) == 6 and "6 held-out views" in found.describe()


def test_held_out_half_is_judged_by_the_other_half(confidence):
    small, large = np.linspace(0, 1, 1001), np.linspace(0, 2, 1001)
    found = confidence.calibrate([small, large])
    one_sigma = list(found.levels).index(0.68)
    assert found.held_by_view[0, one_sigma] == 1.0  # by the factors of the large
    assert abs(found.held_by_view[1, one_sigma] - 0.34) < 0.01
    assert abs(found.held[one_sigma] - 0.67) < 0.01


def test_fewer_than_two_held_out_views_are_not_called_calibrated(scene, ball):
    alone = scene.replace(test_indices=())
    found = measure_confidence(alone, ball)
    assert np.all(np.isnan(found.held)) and "not calibrated" in found.describe()
    assert found.factors[list(found.levels).index(0.68)] == 1.0
    with pytest.raises(InputError, match="no training view"):
        measure_confidence(scene.replace(train_indices=()), ball)


def test_confidence_of_gaussians_about_an_origin_is_the_same(scene, ball, confidence):
    moved = ball.with_origin((0.25, -0.5, 0.125))
    found = measure_confidence(scene, moved)
    np.testing.assert_allclose(found.residual, confidence.residual, atol=1e-5)
    at = inward_pose(0.3)
    sigmas = [
        gsut.render(g, CAMERA, at, confidence=c).color_sigma
        for g, c in ((ball, confidence), (moved, found))
    ]
    np.testing.assert_allclose(sigmas[1], sigmas[0], atol=tolerances.CONFIDENCE_MOVED)


def test_confidence_has_the_same_bits_on_any_threads(scene, ball, confidence):
    for threads in (1, 3):
        gsut.set_num_threads(threads)
        found = measure_confidence(scene, ball)
        for field in dataclasses.fields(Confidence):
            one, other = (np.asarray(getattr(c, field.name)) for c in (found, confidence))
            assert one.tobytes() == other.tobytes(), field.name


def test_confidence_of_other_gaussians_is_refused(ball, confidence):
    moved = dataclasses.replace(ball, means=ball.means[::-1])
    with pytest.raises(InputError, match="other Gaussians"):
        gsut.render(moved, CAMERA, np.eye(4), confidence=confidence)
    with pytest.raises(InputError, match="by themselves"):
        features = np.zeros((COUNT, 2))
        gsut.render(ball, CAMERA, np.eye(4), features=features, confidence=confidence)


def test_confidence_comes_back_from_its_file(tmp_path, confidence):
    file = tmp_path / "confidence.npz"
    confidence.save(file)
    found = Confidence.load(file)
    assert found.mark == confidence.mark and found.describe() == confidence.describe()
    assert np.array_equal(found.residual, confidence.residual)
    for damaged in (b"", b"PK\x03\x04 nothing", file.read_bytes()[:200]):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=r"confidence\.npz holds no confidence"):
            Confidence.load(file)


def test_share_never_seen_leaves_out_pixels_that_no_lens_shows(tmp_path, confidence):
    params = [20, 20, 16, 16, 0, 0, 0, 0]
    fisheye = gsut.Camera("kannala_brandt", params, 32, 32, valid_field_angle=0.7)
    drawn = fisheye.rays()[1]
    seen_views = np.where(drawn, 2.0, 0.0)
    seen_views[16] = 0.0
    maps = {name: np.ones((32, 32)) for name in ("color_sigma", "depth_sigma")}
    output = ConfidenceOutput(SimpleNamespace(gaussians=None), confidence)
    result = SimpleNamespace(camera=fisheye, seen_views=seen_views, **maps)
    output.add(tmp_path, SimpleNamespace(name="a", turns=0), result, None)
    share = drawn[16].sum() / drawn.sum()
    assert 0 < share < np.mean(seen_views == 0)
    assert output.finish()["never_seen"] == share


def test_render_command_writes_maps_and_keeps_the_confidence(tmp_path, capsys):
    run = surface_scenes.plane_run(tmp_path)
    words = ["render", str(run), "--path", "train", "--frames", "1", "--confidence"]
    assert main([*words, "-o", str(tmp_path / "first")]) == 0
    assert "never seen: " in capsys.readouterr().out
    kept = run / "confidence.npz"
    before = kept.read_bytes()
    with np.load(tmp_path / "first/confidence/00000.npz") as maps:
        assert set(maps) == {"color_sigma", "depth_sigma", "seen_views"}
        assert np.array_equal(np.isnan(maps["color_sigma"]), maps["seen_views"] == 0)
        assert np.isfinite(maps["color_sigma"]).any()
    assert (tmp_path / "first/confidence/00000.png").is_file()
    time = kept.stat().st_mtime_ns
    assert main([*words, "-o", str(tmp_path / "second")]) == 0
    assert kept.read_bytes() == before and kept.stat().st_mtime_ns == time
    assert main(["render", str(run / "scene.ply"), "--confidence", "-o", str(tmp_path / "x")]) != 0
    assert "give the folder of its run" in capsys.readouterr().err
