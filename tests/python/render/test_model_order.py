"""A model is drawn in the order that it carries, unless a render says another."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut import InputError, _core
from gsut.compact import SeenView, compact
from random_scenes import fisheye, gaussians_in_view, random_pose


@pytest.fixture
def drawn(rng):
    """A camera, a pose, and Gaussians in one another, a model of each order."""
    camera, pose = fisheye(24), random_pose(rng)
    shape = {"distances": (2.0, 3.0), "sizes": (0.03, 0.3), "opacity": 0.5}
    g = gaussians_in_view(rng, camera, pose, 100, **shape)
    models = {order: dataclasses.replace(g, order=order) for order in gsut.Gaussians.ORDERS}
    return camera, pose, models


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_render_of_a_model_takes_its_order_or_the_given_one(drawn, dtype):
    camera, pose, models = drawn
    plain, seen = models["distance"], set()
    for order, g in models.items():
        own = gsut.render(g, camera, pose, dtype=dtype)
        given = gsut.render(plain, camera, pose, dtype=dtype, order=order)
        assert own.image.tobytes() == given.image.tobytes()
        back = [gsut.render_backward(each, each.image).gaussians for each in (own, given)]
        assert back[0].means.tobytes() == back[1].means.tobytes()
        for other in models.values():
            image = gsut.render(other, camera, pose, dtype=dtype, order=order).image
            assert image.tobytes() == own.image.tobytes()
        seen.add(own.image.tobytes())
    assert len(seen) == 3
    by_z = [gsut.render(g, camera, pose, dtype=dtype, parity="gsplat") for g in models.values()]
    assert len({each.image.tobytes() for each in by_z}) == 1


def test_model_along_the_ray_has_scores_and_derivatives_of_the_distance(drawn):
    camera, pose, models = drawn
    baseline = pytest.importorskip("gsut_scalar_baseline")
    job = _core.RenderJob(camera, pose)
    pixels = np.arange(200, 240, dtype=np.uint32)
    views = [SeenView(camera, pose, camera.rays()[1])]
    ray, distance = (
        (
            *baseline.color_jacobian(models[order], job, pixels),
            compact(models[order], 0.5, method="lightgaussian", views=views).gaussians.means,
        )
        for order in ("ray", "distance")
    )
    assert all(a.tobytes() == b.tobytes() for a, b in zip(ray, distance, strict=True))


def test_model_along_the_ray_with_features_is_refused_with_what_to_give(drawn):
    camera, pose, models = drawn
    options = {"features": np.ones((100, 1), np.float32)}
    with pytest.raises(InputError, match=r"order \"ray\".*distance"):
        gsut.render(models["ray"], camera, pose, **options)
    by_distance = gsut.render(models["ray"], camera, pose, order="distance", **options)
    assert by_distance.features.any()


def test_rows_and_other_forms_of_a_model_keep_its_order(drawn):
    g = drawn[2]["ray"]
    others = (g[3:5], g.copy(), g.to_dtype(np.float64), g.translate((1e6, 0, 0)), g.to_surfels())
    for each in (*others, g.to_primitive("triangle")):
        assert each.order == "ray" and each.order_by_centers().order == "distance"
    with pytest.raises(InputError, match='order "integral" is unknown; known: distance, z, ray'):
        dataclasses.replace(g, order="integral")
