"""A lens from a table of pixels and rays."""

import numpy as np
import pytest

import gsut
import tolerances

LENSES = [
    gsut.Camera("kannala_brandt", [134.6, 134.9, 241.3, 238.9, 0.035, -0.012, 0.0035, -6e-4],
                480, 480),
    gsut.Camera("opencv4", [305.0, 306.2, 243.7, 177.4, -0.2, 0.05, 1.6e-3, -1.1e-3], 480, 360),
    gsut.Camera("pinhole", [305.0, 306.2, 243.7, 177.4], 480, 360),
]  # fmt: skip


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_fit_of_a_lens_own_rays_gives_the_lens_again(lens, rng):
    pixels = rng.uniform([0, 0], [lens.width, lens.height], (600, 2))
    rays = np.array(lens.unproject(pixels)[0])  # NaN outside the domain: does not count
    known = np.isfinite(rays[:, 0])
    found = gsut.Camera.fit(
        pixels, 3 * rays, model=lens.model, width=lens.width, height=lens.height
    )
    off = np.abs(found.project(rays[known])[0] - pixels[known]).max()
    print(f"{lens.model}: {off:.1e} px")
    assert off < tolerances.FIT_OF_OWN_RAYS


def test_fit_by_another_model_is_near(rng):
    lens = LENSES[0]
    pixels = rng.uniform(100, 380, (400, 2))
    rays = lens.unproject(pixels)[0]
    found = gsut.Camera.fit(pixels, rays, model="opencv8", width=480, height=480)
    assert np.abs(found.project(rays)[0] - pixels).max() < tolerances.FIT_BY_ANOTHER_MODEL


@pytest.mark.parametrize(
    ("pixels", "rays", "model", "said"),
    [
        (np.ones((9, 2)), np.ones((8, 3)), "pinhole", "9 pixels, but 8 rays"),
        (np.ones((9, 2)), np.full((9, 3), np.nan), "pinhole", "a fit needs 8"),
        (np.ones((9, 2)), np.tile([0.0, 0, 1], (9, 1)), "pinhole", "do not spread"),
    ],
)
def test_table_that_gives_no_lens_is_refused(pixels, rays, model, said):
    with pytest.raises(gsut.InputError, match=said):
        gsut.Camera.fit(pixels, rays, model=model, width=10, height=10)
