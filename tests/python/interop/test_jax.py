"""The example of docs/jax.md: values of gsut.render, gradients of gsut.render_backward."""

import contextlib
import io
from pathlib import Path

import numpy as np
import pytest

import gsut
import tolerances
from random_scenes import relative_error

jax = pytest.importorskip("jax", reason="docs/jax.md needs jax: pip install jax")
ROOT = Path(__file__).parents[3]
NAMES = ("means", "quats", "scales", "opacities", "colors", "lens")


def test_the_pages_example_renders_and_differentiates_under_jit():
    (block,) = (ROOT / "docs" / "jax.md").read_text("utf-8").split("```python\n")[1:]
    found: dict = {}
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(block.split("```")[0], found)
    assert "(500, 3), (500, 4), (500, 3), (500,), (500, 3), (8,)" in printed.getvalue()
    scene = [np.asarray(array) for array in found["scene"]]
    gaussians = gsut.LinearGaussians(*scene[:4])
    camera = found["CAMERA"].with_params(scene[5].astype(np.float64))
    expected = gsut.render(gaussians, camera, np.eye(4), features=scene[4])
    image, alpha = jax.jit(found["render"])(*found["scene"])
    assert np.array_equal(image, expected.features) and np.array_equal(alpha, expected.alpha)
    # The loss is mean(image^2) + mean(alpha).
    dimage = 2 * expected.features / np.float32(expected.features.size)
    dalpha = np.full_like(expected.alpha, 1 / expected.alpha.size)
    slopes = gsut.render_backward(
        expected, np.zeros_like(expected.image), dalpha, dfeatures=dimage, with_lens=True
    )
    g = slopes.gaussians
    wanted = (g.means, g.quats, g.scales, g.opacities, slopes.features, slopes.lens)
    for name, slope, array in zip(NAMES, found["slopes"], wanted, strict=True):
        assert np.abs(array).max() > 0
        assert relative_error(np.asarray(slope), array) < tolerances.JAX_SLOPE, name


def test_a_traced_array_is_refused_with_the_way_out():
    gaussians = gsut.LinearGaussians(np.zeros((1, 3)), np.ones((1, 4)), np.ones((1, 3)), np.ones(1))
    camera = gsut.Camera("pinhole", [10, 10, 5, 5], 10, 10)

    def draw(colors):
        return gsut.render(gaussians, camera, np.eye(4), features=colors).features

    with pytest.raises(gsut.InputError, match=r"features is traced by JAX.*jax\.pure_callback"):
        jax.jit(draw)(jax.numpy.ones((1, 3)))
