"""A COLMAP model that gsut writes opens in pycolmap, with the same pixels of its points."""

import numpy as np
import pytest

import gsut
import tolerances
from lens_cases import examples

pycolmap = pytest.importorskip("pycolmap", reason="needs pycolmap")
WRITTEN = (
    "division equirectangular extended_unified fisheye624 fov kannala_brandt opencv4 opencv5 "
    "opencv8 pinhole thin_prism_fisheye unified"
)


@pytest.mark.parametrize("model", WRITTEN.split())
def test_written_model_projects_its_points_in_pycolmap_as_here(model, tmp_path):
    whole = examples(model)[0]
    camera = whole.resize(32, max(1, round(32 * whole.height / whole.width)))
    rng = np.random.default_rng(3)
    rays, valid = camera.rays()
    inner = rays[valid][:: max(1, valid.sum() // 40)]
    points = inner * rng.uniform(2.0, 4.0, (len(inner), 1))
    images = [np.full((camera.height, camera.width, 3), 90, np.uint8)] * 2
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[1, :3, 3] = 0.01
    gsut.save_dataset(tmp_path / "out", images, camera, poses, points=points, to="colmap")
    opened = pycolmap.Reconstruction(tmp_path / "out" / "sparse" / "0")
    assert len(opened.images) == 2 and len(opened.points3D) == len(points)
    compared = 0
    images = sorted(opened.images.values(), key=lambda image: image.name)
    for image, pose in zip(images, poses, strict=True):
        for point in opened.points3D.values():
            pixel = image.project_point(point.xyz)
            expected, seen = camera.project((pose[:3, :3] @ point.xyz + pose[:3, 3])[None])
            if pixel is None or not seen[0]:
                continue
            np.testing.assert_allclose(pixel, expected[0], atol=tolerances.LENS_ORACLE_PIXELS)
            compared += 1
    assert compared >= 40
