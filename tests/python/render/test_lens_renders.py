"""Tests that every lens renders: float tiles against the double reference, seam and poles too."""

import dataclasses

import numpy as np
import pytest

import tolerances as tol
from gsut import Gaussians, InputError, render
from gsut.lens.camera import Camera
from lens_cases import HARD_LENSES, all_lenses
from random_scenes import blob, list_models

# Every lens on an image small enough for the reference, by the lens' own scaling.
PIXELS = 96


def small(camera: Camera) -> Camera:
    if camera.width * camera.height <= PIXELS**2:
        return camera
    scale = PIXELS / max(camera.width, camera.height)
    return camera.resize(max(8, round(camera.width * scale)), max(8, round(camera.height * scale)))


# Hard lenses whose few pixels see nearly everything: no tile has a plane.
WIDE_TILES = [lens for lens in HARD_LENSES if lens[0] in ("pinhole", "stereographic")]
WIDE_TILES += [lens for lens in HARD_LENSES if lens[0] == "fov" and lens[1][-1] == 3.0]


CAMERAS = [small(camera) for camera in all_lenses() if camera.model in list_models()]
each_lens = pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: f"{c.model}-{c.width}")


def scene(rng: np.random.Generator, rays: np.ndarray, spread: float) -> Gaussians:
    """One Gaussian near each ray, 1 to 4 away, of sizes around `spread` radians.

    None reaches the camera: a hit at the ray's origin is a discontinuity of the response.
    """
    count = len(rays)
    distance = rng.uniform(1.0, 4.0, (count, 1))
    return Gaussians(
        rays * distance,
        rng.normal(size=(count, 4)),
        np.log(spread * distance) + rng.uniform(-1.5, 0.4, (count, 3)),
        rng.uniform(-2.0, 4.0, count),
        rng.normal(0.3, 0.3, (count, 4, 3)),
    )


def rays_of_image(rng: np.random.Generator, camera: Camera, count: int) -> np.ndarray:
    rays, valid = camera.rays()
    seen = rays[valid]
    picked = seen[rng.integers(0, len(seen), count)] + rng.normal(0, 0.05, (count, 3))
    return picked / np.linalg.norm(picked, axis=1, keepdims=True)


def assert_same_image(gaussians: Gaussians, camera: Camera) -> None:
    """Equal but for pixels where one Gaussian's alpha is the cut-off to within rounding."""
    expected = render(gaussians, camera, np.eye(4), dtype="float64")
    found = render(gaussians, camera, np.eye(4))
    assert expected.alpha.max() > 0.1
    error = np.abs(np.dstack([found.image - expected.image, found.alpha - expected.alpha]))
    stepped = error.max(axis=2) > tol.LENS_RENDER_STEP
    # A Gaussian that a tile misses would show as larger steps, or as steps on many pixels.
    assert stepped.sum() <= tol.LENS_RENDER_STEPS, np.argwhere(stepped)
    assert error.max() < tol.LENS_RENDER_CUTOFF
    rms = np.sqrt(np.mean(error[~stepped] ** 2))
    assert rms < tol.LENS_RENDER_RMS


@each_lens
@pytest.mark.parametrize("primitive", ["gaussian", "triangle"])  # the latter are drawn as lines
def test_render_any_lens_agrees_with_the_reference(camera, rng, primitive):
    for spread, count in ((0.02, 300), (0.15, 40)):
        g = scene(rng, rays_of_image(rng, camera, count), spread)
        g = dataclasses.replace(g, primitive=primitive)
        if any(camera == small(Camera(*lens)) for lens in WIDE_TILES):
            with pytest.raises(InputError, match="16 x 16 pixels spans more than 168 degrees"):
                render(g, camera, np.eye(4))
            continue
        assert_same_image(g, camera)


def test_seam_gaussian_shows_on_both_edges_and_nowhere_between():
    camera = Camera("equirectangular", [], 256, 128)
    alpha = render(blob((0, 0, -3), 0.05, 0.95), camera, np.eye(4)).alpha
    assert alpha[64, 0] > 0.5 and alpha[64, -1] > 0.5
    assert alpha[:, 10:-10].max() == 0
