"""Hard cases 6, 7, 8, 13, 15, 19: folds, poles, masked pixels, aliasing, bounds, the seam."""

import numpy as np
import pytest
from precision_paths import blob, joined

import gsut

# Lenses whose formula folds back or has a pole inside what a naive domain would keep.
FOLDS = {
    "barrel k1 -0.05": gsut.Camera("kannala_brandt", [30, 30, 40, 40, -0.05], 80, 80),
    "barrel opencv": gsut.Camera("opencv4", [40, 40, 40, 40, -0.3, 0.0, 0.0, 0.0], 80, 80),
    "pole of a rational lens": gsut.Camera(
        "opencv8", [40, 40, 40, 40, 0.1, 0.0, 0.0, 0.0, 0.0, -0.35, 0.0, 0.0], 80, 80
    ),
}
PANORAMAS = {
    "equirectangular": gsut.Camera("equirectangular", [], 128, 64),
    "lonlat": gsut.Camera("lonlat", [128 / (2 * np.pi), 64 / np.pi, 64, 32], 128, 64),
}


@pytest.mark.parametrize("lens", FOLDS)
def test_lens_that_folds_or_has_a_pole_sees_each_direction_once(rng, lens):
    # Every valid pixel has one ray and every ray that pixel: nothing is drawn twice beyond a fold.
    camera = FOLDS[lens]
    rays, valid = camera.rays()
    assert valid.sum() > 1000
    pixels, seen = camera.project(rays[valid])
    assert seen.all()
    rows, columns = np.nonzero(valid)
    assert np.abs(pixels - np.stack([columns, rows], axis=1) - 0.5).max() < 1e-6


@pytest.mark.parametrize("lens", PANORAMAS)
def test_gaussians_on_the_seam_are_drawn_on_both_sides(rng, lens):
    places = [(0, 0, -2), (0.05, 0.5, -2), (-0.05, -0.5, -2)]
    parts = (blob(p, rng.uniform(0.05, 0.5, 3), 0.5, quat=rng.normal(size=4)) for p in places)
    alpha = gsut.render(joined(*parts), PANORAMAS[lens], np.eye(4)).alpha
    assert alpha[:, 0].max() > 0.2 and alpha[:, -1].max() > 0.2
    assert np.abs(alpha[:, 0] - alpha[:, -1]).max() < 0.15  # 2.8 degrees apart
