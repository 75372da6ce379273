"""What shows where no Gaussian is: the soft colour of what is around, and gradients through it."""

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.formats import NO_BACKGROUND, read_scene_file, save_ply
from gsut.render import compute_field_angles, with_surroundings
from gsut.training.first import find_plain_background
from gsut.training.loop import draw_background
from gsut.view import open_stage
from random_scenes import fisheye, gaussians_in_view, pinhole, random_pose
from rendered_dataset import write_dataset


def seen(rng, camera):
    pose = random_pose(rng)
    g = gaussians_in_view(rng, camera, pose, 12, sh_degree=0, sizes=(0.02, 0.2), opacity=0.6)
    return g, pose


def test_an_open_corner_takes_the_colour_around_it(rng):
    camera = pinhole(90, 70)
    color = np.float32([0.2, 0.5, 0.7])
    alpha = np.ones((70, 90), np.float32)
    alpha[:20, 60:] = 0.0
    alpha[40:60, 10:30] = 0.25
    filled = with_surroundings(alpha[..., None] * color, alpha, camera)
    assert np.abs(filled - color).max() < tol.SURROUNDINGS_FLAT
    # Nearer colours count more.
    sides = np.where(np.arange(90)[None, :, None] < 45, 0.0, 1.0) * np.ones((70, 1, 3))
    alpha = np.ones((70, 90), np.float32)
    alpha[:, 20:70] = 0.0
    filled = with_surroundings((alpha[..., None] * sides).astype("f4"), alpha, camera)
    assert (filled[:, 22].mean(), filled[:, 68].mean()) == pytest.approx((0.0, 1.0), abs=0.25)


def test_what_is_covered_and_what_has_no_ray_stays(rng):
    camera = fisheye(64)
    g, pose = seen(rng, camera)
    black, filled = (gsut.render(g, camera, pose, background=b) for b in ((0, 0, 0), None))
    no_ray = np.isnan(compute_field_angles(camera))
    assert no_ray.any()
    assert not filled.image[no_ray].any()
    assert np.array_equal(black.alpha, filled.alpha)
    assert np.array_equal(black.depth, filled.depth)
    open_share = 1.0 - black.alpha[~no_ray]
    assert (filled.image[~no_ray] >= black.image[~no_ray]).all()
    assert filled.image[~no_ray][open_share > 0.5].min() > 0.0
    opaque = np.ones_like(black.alpha)
    assert with_surroundings(black.image, opaque, camera) is black.image


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_gradients_see_what_is_behind_as_a_constant(rng, dtype):
    camera = pinhole(40, 30)
    g, pose = seen(rng, camera)
    result = gsut.render(g, camera, pose, background=None, dtype=dtype)
    weights = rng.normal(size=(30, 40, 3))
    found = gsut.render_backward(result, weights).gaussians
    black = gsut.render(g, camera, pose, dtype=dtype)
    behind = (result.image - black.image) / np.maximum(1.0 - black.alpha, 1e-6)[..., None]
    expected = gsut.render_backward(black, weights, -np.sum(weights * behind, axis=2)).gaussians
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        a, b = getattr(found, name), getattr(expected, name)
        assert np.abs(a - b).max() <= tol.SURROUNDINGS_GRADIENT * np.abs(b).max(), name


def test_backgrounds_of_steps_differ_and_are_the_same_again():
    colors = np.array([draw_background(3, step) for step in range(1, 200)])
    assert len(np.unique(colors, axis=0)) == len(colors)
    assert np.array_equal(colors[7], draw_background(3, 8))
    assert np.abs(colors.mean(axis=0) - 0.5).max() < tol.BACKGROUND_MEAN


def test_edges_of_one_colour_are_the_background_of_an_object(tmp_path, rng):
    path = write_dataset(tmp_path / "data", rng)
    scene = gsut.load_dataset(path)
    pictures = {i: np.array(scene.image(i)) for i in scene.train_indices}

    class Edged:
        train_indices, camera, views = scene.train_indices, scene.camera, scene.views
        find_lens_mask = scene.find_lens_mask
        image = pictures.__getitem__
        cut = False

        @classmethod
        def mask(cls, index):
            return scene.mask(index) & (not cls.cut)

    for picture in pictures.values():
        picture[:] = rng.integers(0, 255, picture.shape)
    assert find_plain_background(Edged) is None
    for picture in pictures.values():
        picture[0] = picture[-1] = (255, 255, 254)
        picture[:, 0] = (255, 254, 255)
    assert find_plain_background(Edged) == pytest.approx((1.0, 1.0, 1.0), abs=1 / 255)
    Edged.cut = True
    assert find_plain_background(Edged) == (0.0, 0.0, 0.0)


def test_a_file_says_whether_anything_stands_behind_it(tmp_path, rng):
    g, _ = seen(rng, pinhole(40, 30))
    for name, comments in (("open.ply", [NO_BACKGROUND]), ("black.ply", [])):
        save_ply(tmp_path / name, g, comments)
        assert read_scene_file(tmp_path / name).no_background == bool(comments)
        assert open_stage(tmp_path / name).background == (None if comments else (0.0, 0.0, 0.0))
