"""The unscented projection: against its definition in numpy, float against double, refusals."""

import itertools

import numpy as np
import pytest

import gsut
import tolerances
from gsut import InputError
from random_scenes import (
    blob,
    every_lens,
    fisheye,
    gaussians_in_view,
    list_isas,
    no_gaussians,
    pinhole,
    random_pose,
)
from ray_model import rotations

LENSES = dict(every_lens())
# alpha, beta, kappa: gsut's own, gsplat's, and one with a positive central weight.
UNSCENTED = ((1.0, 2.0, 0.0), (0.1, 2.0, 0.0), (1.2, 1.0, 0.5))


def sigma_points(g, camera_from_world, alpha, kappa):
    """(N, 7, 3) in the camera frame."""
    spread = np.sqrt(alpha**2 * (3 + kappa))
    axes = rotations(g.quats) * (spread * np.exp(g.log_scales))[:, None, :]  # columns
    points = np.repeat(g.means[:, None], 7, axis=1)
    points[:, 1:4] += axes.transpose(0, 2, 1)
    points[:, 4:7] -= axes.transpose(0, 2, 1)
    return points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]


def period_of(camera):
    """(2,) pixels after which a panorama repeats along u and v; infinite for other lenses."""
    period = np.array(camera.period)
    return np.where(period > 0, period, np.inf)


def transform(g, camera, camera_from_world, alpha, beta, kappa):
    """Centres, covariances and validity as Wan and van der Merwe define them, in long double.

    With alpha 0.1 the weights are of size 100 and cancel; long double pays for that. Across the
    seam of a panorama sigma points are taken on the centre's side.
    """
    pixels, valid = camera.project(sigma_points(g, camera_from_world, alpha, kappa).reshape(-1, 3))
    pixels = pixels.reshape(-1, 7, 2).astype(np.longdouble)
    for axis, period in enumerate(period_of(camera)):
        if np.isfinite(period):
            off = pixels[..., axis] - pixels[:, :1, axis]
            pixels[..., axis] -= np.longdouble(period) * np.round(off / period)
    reach = np.longdouble(alpha) ** 2 * (3 + np.longdouble(kappa))  # 3 + lambda
    weights = np.full(7, 1 / (2 * reach), np.longdouble)
    weights[0] = (reach - 3) / reach
    centers = np.einsum("k,nkc->nc", weights, pixels)
    of_covariance = weights.copy()
    of_covariance[0] += 1 - np.longdouble(alpha) ** 2 + beta
    off = pixels - centers[:, None]
    covariances = np.einsum("k,nkc,nkd->ncd", of_covariance, off, off)
    return centers, covariances, valid.reshape(-1, 7).all(axis=1)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("unscented", UNSCENTED)
def test_project_double_every_lens_matches_the_definition(rng, lens, unscented):
    camera, pose = LENSES[lens], random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 200).to_dtype(np.float64)
    centers, covariances, valid = transform(g, camera, pose, *unscented)
    found = gsut.project(g, camera, pose, unscented=unscented, dtype="float64")
    assert np.array_equal(found.valid, valid)
    assert valid.sum() > 100
    assert np.isnan(found.centers[~valid]).all() and np.isnan(found.covariances[~valid]).all()
    size = np.maximum(1, np.abs(covariances[valid]).max(axis=(1, 2)))
    assert np.abs(found.centers - centers)[valid].max() < tolerances.PROJECTION_DOUBLE
    relative = np.abs(found.covariances - covariances)[valid].max(axis=(1, 2)) / size
    assert relative.max() < tolerances.PROJECTION_DOUBLE
    in_camera = g.means @ pose[:3, :3].T + pose[:3, 3]
    assert np.abs(found.depths - np.linalg.norm(in_camera, axis=1)).max() < (
        tolerances.RENDER_IDENTITY
    )


@pytest.mark.parametrize("unscented", UNSCENTED)
def test_project_float_every_lens_and_isa_matches_double(rng, unscented):
    for camera in LENSES.values():
        pose = random_pose(rng)
        g = gaussians_in_view(rng, camera, pose, 300, sizes=(0.005, 0.1))
        expected = gsut.project(g, camera, pose, unscented=unscented, dtype="float64")
        # Wide footprints have sigma points at the pole of a panorama, or far outside the image,
        # where a polynomial lens is steep: the bound grows in proportion, as their rounding does.
        rows = expected.valid
        assert rows.sum() > 250
        widths = np.sqrt(np.einsum("ncc->nc", expected.covariances[rows]).max(axis=1))
        bounds = tolerances.PROJECTION_FLOAT_PIXELS * np.maximum(
            1, widths / tolerances.PROJECTION_FLOAT_WIDTH
        )
        for isa in list_isas():
            gsut.machine.set_isa(isa)
            found = gsut.project(g, camera, pose, unscented=unscented)
            assert found.valid[rows].all()
            error = (np.abs(found.centers - expected.centers)[rows].max(axis=1) / bounds).max()
            assert error < 1, (isa, camera, error)
            size = np.abs(expected.covariances[rows]).max(axis=(1, 2))
            error = np.abs(found.covariances - expected.covariances)[rows].max(axis=(1, 2))
            assert (error / np.maximum(size, 1)).max() < tolerances.PROJECTION_FLOAT_COVARIANCE
            depth = np.abs(found.depths / expected.depths - 1).max()
            assert depth < tolerances.PROJECTION_FLOAT_DEPTH


def test_project_sigma_point_outside_the_domain_is_never_averaged_in():
    # The Gaussian's centre has a pixel; one sigma point lies behind the pinhole.
    camera, pose = pinhole(), np.eye(4)
    g = blob((0, 0, 1), (0.1, 0.1, 0.6))
    for dtype in ("float32", "float64"):
        found = gsut.project(g, camera, pose, dtype=dtype)
        assert not found.valid[0]
        assert np.isnan(found.centers).all() and np.isnan(found.covariances).all()
        assert found.depths[0] == 1.0
    # A narrower one is projected.
    g.log_scales[0, 2] = np.log(0.5)
    assert gsut.project(g, camera, pose).valid[0]


def test_project_extent_holds_every_pixel_above_the_cutoff():
    # In the small-angle limit the footprint is the ellipse: extent = sqrt(2 ln(255 opacity)) sigma.
    camera = pinhole(64, focal=64.0)
    scale, opacity = 0.02, 0.8
    g = blob(scale=scale, opacity=opacity)
    expected = np.sqrt(2 * np.log(255 * opacity)) * scale / 2 * 64
    for dtype in ("float32", "float64"):
        extents = gsut.project(g, camera, np.eye(4), dtype=dtype).extents[0]
        assert extents == pytest.approx(expected, rel=tolerances.PROJECTION_SMALL_ANGLE)
    alpha = gsut.render(g, camera, np.eye(4), dtype="float64").alpha
    rows, columns = np.nonzero(alpha)
    assert np.abs(columns + 0.5 - 32).max() <= expected
    assert np.abs(rows + 0.5 - 32).max() <= expected


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "linear"}, "unscented, ewa"),
        *(
            ({"unscented": (alpha, 2.0, 0.0)}, "alpha must be positive")
            for alpha in (0.0, -1.0, np.nan, np.inf)
        ),
        *(({"unscented": (1.0, 2.0, kappa)}, "kappa") for kappa in (-3.0, -4.0, np.nan)),
        *(({"unscented": (1.0, beta, 0.0)}, "beta") for beta in (np.nan, np.inf)),
        ({"camera_from_world": np.diag([2.0, 1, 1, 1])}, "rotation"),
        ({"camera_from_world": np.full((4, 4), np.nan)}, "finite"),
        ({"camera_from_world": np.eye(3)}, "camera_from_world"),
    ],
)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_project_bad_argument_is_refused_with_its_name(rng, arguments, message, dtype):
    camera = pinhole()
    g = gaussians_in_view(rng, camera, np.eye(4), 3)
    arguments = {"camera_from_world": np.eye(4), **arguments}
    with pytest.raises(InputError, match=message):
        gsut.project(g, camera, dtype=dtype, **arguments)


@pytest.mark.parametrize("method", gsut.rendering.PROJECTION_METHODS)
def test_project_every_method_gives_the_same_footprint_of_a_small_gaussian(rng, method):
    # Where the lens is linear over the Gaussian, all methods agree.
    camera, pose = fisheye(200), random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 60, sizes=(2e-4, 4e-4), aspect=0.3, opacity=2.0)
    expected = gsut.project(g, camera, pose, method="unscented", dtype="float64")
    rows = expected.valid
    assert rows.sum() > 40
    for dtype in ("float64", "float32"):
        found = gsut.project(g, camera, pose, method=method, dtype=dtype)
        assert found.valid[rows].all()
        assert np.abs(found.centers - expected.centers)[rows].max() < (
            tolerances.PROJECTION_METHODS_CENTER
        )
        size = np.einsum("ncc->n", expected.covariances)[rows]
        off = np.abs(found.covariances - expected.covariances)[rows].max(axis=(1, 2))
        assert (off / size).max() < tolerances.PROJECTION_METHODS_COVARIANCE
        far = np.abs(found.extents - expected.extents)[rows].max()
        assert far < tolerances.PROJECTION_METHODS_EXTENT


def test_project_no_gaussians_gives_empty_arrays():
    for dtype, method in itertools.product(
        ("float32", "float64"), gsut.rendering.PROJECTION_METHODS
    ):
        found = gsut.project(no_gaussians(), pinhole(), np.eye(4), dtype=dtype, method=method)
        assert found.centers.shape == (0, 2) and found.covariances.shape == (0, 2, 2)
        assert found.depths.shape == (0,) and found.valid.shape == (0,)
