"""The truth of `./run bench projection`: quadrature against a million random samples."""

import numpy as np
import pytest

import tolerances
from tests.bench.projection_bench import SIZES, make_example_camera, place_gaussians
from tests.bench.projection_truth import compute_alphas, compute_moments, sample_moments

SAMPLES = 1_000_000
LENSES = (
    "pinhole", "opencv8", "kannala_brandt", "double_sphere", "splined_stereographic",
    "equirectangular", "orthographic", "cahvore",
)  # fmt: skip
UPPER = np.triu_indices(2)


@pytest.mark.parametrize("lens", LENSES)
def test_quadrature_lies_within_the_standard_error_of_a_million_samples(lens):
    rng = np.random.default_rng(LENSES.index(lens))
    camera = make_example_camera(lens, 128)
    scores = []
    for size in SIZES:
        gaussians = place_gaussians(camera, size, (0.25, 0.75), 1, rng).to_dtype(np.float64)
        centers, covariances = compute_moments(gaussians, camera)
        # Without: the quadrature did not settle (a spline's pieces), or a part has no pixel.
        there = np.isfinite(centers[:, 0])
        samples = sample_moments(gaussians[there], camera, SAMPLES, rng)
        for center, covariance, found in zip(
            centers[there], covariances[there], samples, strict=True
        ):
            assert found.lost < 1e-5
            scores += list((center - found.center) / found.center_error)
            scores += list(((covariance - found.covariance) / found.covariance_error)[UPPER])
    assert len(scores) >= 15
    assert np.abs(scores).max() < tolerances.MONTE_CARLO_WORST_SCORE


@pytest.mark.parametrize("lens", ["orthographic", "cahvore"])
def test_alpha_images_of_rays_that_do_not_meet_peak_where_the_mean_is_seen(lens):
    camera = make_example_camera(lens, 96)
    gaussians = place_gaussians(camera, "medium", (0.25, 0.75), 20, np.random.default_rng(3))
    gaussians = gaussians.to_dtype(np.float64)
    alphas = compute_alphas(gaussians, camera, 1 / 255)
    centers, valid = camera.project(gaussians.means)
    checked = 0
    for image, center in zip(alphas[valid], centers[valid], strict=True):
        row, column = np.unravel_index(np.argmax(image), image.shape)
        assert np.abs(center - [column + 0.5, row + 0.5]).max() < 1.5
        checked += 1
    assert checked == 20
