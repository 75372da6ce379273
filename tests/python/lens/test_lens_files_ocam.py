"""OCamCalib's and MATLAB's polynomial fisheye against their own formulae and published inverses."""

import json

import numpy as np
import pytest

import tolerances as tol
from gsut.lens import Camera, load_camera

# Calibrations that OCamCalib made and their owners published: row, column centre; c d e; the
# polynomial and the inverse that OCamCalib fitted to it, which no code of gsut's has touched.
PUBLISHED = {
    "800 848": (
        [-2.897359e02, 0.0, 1.773712e-03, -4.779778e-06, 1.018103e-08],
        [
            *(427.002424, 206.233564, -39.709445, 48.598171, 4.746745, 3.325197, 37.758438),
            *(-61.894414, -53.388516, 92.049649, 82.273816, -30.283246, -55.178129, -21.427296),
            -2.733399,
        ],
        (387.121004, 417.520087),
        (0.997625, -0.000466, -0.000096),
    ),
    "960 1280": (
        [-3.001285e02, 0.0, 1.401182e-03, -1.612388e-06, 4.170649e-09],
        [
            *(445.680691, 252.513627, -9.273854, 36.991251, 20.202138, -1.864964, 8.113368),
            *(5.803419, -3.367966, 0.005923, 2.568670, 0.823450),
        ],
        (459.542917, 657.820886),
        (0.999894, -0.000104, -0.000146),
    ),
}


def text_of(size: str) -> str:
    direct, inverse, center, affine = PUBLISHED[size]
    rows = [[len(direct), *direct], [len(inverse), *inverse], center, affine]
    lines = [" ".join(map(str, row)) for row in rows] + [size]
    names = ("direct mapping", "inverse mapping", "center", "affine", "image size")
    return "".join(f"#{name}\n\n{line}\n\n" for name, line in zip(names, lines, strict=True))


def rays_of(size: str, pixels: np.ndarray) -> np.ndarray:
    """OCamCalib's cam2world at gsut's pixels, turned into gsut's axes."""
    direct, _, (row, column), (c, d, e) = PUBLISHED[size]
    centred = np.stack([pixels[:, 1] - 0.5 - row, pixels[:, 0] - 0.5 - column])
    x, y = np.linalg.inv([[c, d], [e, 1]]) @ centred
    z = np.polyval(direct[::-1], np.hypot(x, y))
    rays = np.stack([y, x, -z], axis=1)  # x runs down, y to the right, and it looks along -z
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def pixels_of(size: str, rays: np.ndarray) -> np.ndarray:
    """OCamCalib's world2cam with its own inverse polynomial, in gsut's pixels."""
    _, inverse, (row, column), (c, d, e) = PUBLISHED[size]
    x, y, z = rays[:, 1], rays[:, 0], -rays[:, 2]
    rho = np.polyval(inverse[::-1], np.arctan2(z, np.hypot(x, y)))
    x, y = rho * x / np.hypot(x, y), rho * y / np.hypot(x, y)
    return np.stack([x * e + y + column, x * c + y * d + row], axis=1) + 0.5


def grid(camera: Camera) -> np.ndarray:
    columns, rows = np.meshgrid(np.linspace(0, camera.width, 40), np.linspace(0, camera.height, 30))
    return np.stack([columns, rows], axis=-1).reshape(-1, 2)


@pytest.fixture(params=PUBLISHED)
def published(request, tmp_path):
    path = tmp_path / "calib_results.txt"
    path.write_text(text_of(request.param))
    return request.param, load_camera(path)


def test_unproject_is_the_published_formula(published):
    size, camera = published
    assert f"{camera.height} {camera.width}" == size and camera.model == "ocam"
    rays, valid = camera.unproject(grid(camera))
    assert valid.all()
    np.testing.assert_allclose(rays, rays_of(size, grid(camera)), rtol=0, atol=tol.OCAM_RAYS)


def test_project_agrees_with_the_published_inverse(published):
    size, camera = published
    rays = rays_of(size, grid(camera))
    pixels, valid = camera.project(rays)
    assert valid.all()
    np.testing.assert_allclose(pixels, grid(camera), rtol=0, atol=tol.ROUND_TRIP_PIXELS)
    worst = np.abs(pixels_of(size, rays) - pixels).max()
    print(size, "OCamCalib's inverse is off by", worst, "px")
    assert worst < tol.OCAM_PUBLISHED_INVERSE


def test_matlab_fisheye_is_its_formula(tmp_path):
    values = {
        "MappingCoefficients": [289.05, -1.78e-3, 4.8e-6, -1.03e-8],
        "ImageSize": [800, 848],
        "DistortionCenter": [418.5, 388.25],
        "StretchMatrix": [[1.002, -1e-4], [-4.7e-4, 1]],
    }
    path = tmp_path / "intrinsics.json"
    path.write_text(json.dumps({"Intrinsics": values}))
    camera = load_camera(path)
    assert (camera.model, camera.width, camera.height) == ("ocam", 848, 800)
    center, stretch = np.array(values["DistortionCenter"]), np.array(values["StretchMatrix"])
    plane = np.linalg.solve(stretch, (grid(camera) + 0.5 - center).T)  # MATLAB counts from 1
    a0, a2, a3, a4 = values["MappingCoefficients"]
    rho = np.hypot(*plane)
    rays = np.stack([*plane, a0 + a2 * rho**2 + a3 * rho**3 + a4 * rho**4], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.unproject(grid(camera))[0], rays, rtol=0, atol=tol.OCAM_RAYS)
