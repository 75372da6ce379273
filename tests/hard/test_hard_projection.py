"""Hard cases 1, 2, 9, 12: the unscented transform where weights, lenses or rounding are extreme."""

import numpy as np
import pytest
from precision_paths import every_path, run_every_path

import gsut
import tolerances
from random_scenes import (
    blob,
    fisheye,
    gaussians_in_view,
    list_isas,
    pinhole,
    random_pose,
    random_weights,
)


def project(g, camera, pose, path, **options):
    gsut.machine.set_isa("" if path == "float64" else path)
    dtype = "float64" if path == "float64" else "float32"
    return gsut.project(g, camera, pose, dtype=dtype, **options)


@pytest.mark.parametrize("alpha", [1.0, 0.1, 1e-2, 1e-3])
def test_covariance_of_any_alpha_is_positive_definite_in_every_path(rng, alpha):
    # At alpha 1e-3 sums of pixels leave 70 % of the float covariances without a square root.
    camera, pose = fisheye(200), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 2000, sizes=(0.002, 0.1))
    for path in every_path():
        found = project(g, camera, pose, path, unscented=(alpha, 2.0, 0.0))
        c = found.covariances[found.valid].astype(np.float64)
        assert len(c) > 1800
        assert np.all(c[:, 0, 0] > 0) and np.all(c[:, 1, 1] > 0), path
        determinant = c[:, 0, 0] * c[:, 1, 1] - c[:, 0, 1] ** 2
        assert np.all(determinant > -tolerances.HARD_DETERMINANT * c[:, 0, 0] * c[:, 1, 1]), path
        assert np.isfinite(found.extents[found.valid]).all()


def test_small_alpha_bounds_render_the_same_image(rng):
    # The transform only guesses where to look for tiles: the image must not depend on it.
    camera, pose = fisheye(100), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 400, sizes=(0.01, 0.5))
    images = {}
    for unscented in ((1.0, 2.0, 0.0), (0.1, 2.0, 0.0), (1e-3, 2.0, 0.0), (1.5, 0.0, 1.0)):
        for isa in list_isas():
            gsut.machine.set_isa(isa)
            images[unscented, isa] = gsut.render(g, camera, pose, unscented=unscented).image
    assert len(images) == 4 * len(list_isas())
    for (_, isa), image in images.items():
        assert np.array_equal(image, images[(1.0, 2.0, 0.0), isa])


def test_projection_on_the_axis_and_against_it_is_exact_or_invalid(rng):
    # Through any lens angle 0 is the principal point; no division by the distance from the axis.
    for camera in (pinhole(64), fisheye(64, degrees=190), fisheye(64, degrees=350)):
        for offset in (0.0, 1e-38, 1e-20, 1e-9):
            for z in (2.0, -2.0):
                g = blob((offset, 0.0, z), 1e-3)
                for path in every_path():
                    found = project(g, camera, np.eye(4), path)
                    assert found.depths[0] == pytest.approx(2.0)
                    assert found.valid[0] == (z > 0)
                    if z > 0:
                        assert found.centers[0] == pytest.approx([32, 32], abs=1e-4)
                        expected = (camera.params[0] * 1e-3 / 2) ** 2 * np.eye(2)
                        assert found.covariances[0] == pytest.approx(expected, rel=1e-3, abs=1e-9)
                    else:
                        assert np.isnan(found.centers).all()


def test_tiny_gaussians_on_pixel_centres_are_drawn_although_their_ellipse_vanishes(rng):
    # 1e-6 of a pixel wide and hit by the ray exactly: the bounds must still hold the pixel.
    camera = pinhole(32, focal=64.0)
    rays, _ = camera.rays()
    for row, column in ((0, 0), (5, 9), (15, 16), (16, 15), (31, 31), (16, 16)):
        # Powers of two: the mean lies on the ray in float, too.
        ray = rays[row, column] / rays[row, column, 2]
        g = blob(2 * ray, 2e-4, opacity=0.8)
        outcomes = run_every_path(g, camera, np.eye(4), random_weights(rng, camera))
        for outcome in outcomes:
            assert outcome.result.alpha[row, column] == pytest.approx(0.8, abs=1e-4)
            assert (outcome.result.alpha > 0).sum() == 1
