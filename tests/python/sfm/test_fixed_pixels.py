"""Pixels that do not move with the scene are found and masked; skies and bare walls are not."""

import cv2
import numpy as np
import pytest

from gsut.sfm.photographs import find_photographs, mask_fixed_pixels
from gsut.sfm.photographs.fixed_pixels import MASK, find_fixed_pixels

HEIGHT, WIDTH = 150, 200
Y, X = np.mgrid[:HEIGHT, :WIDTH]
CIRCLE = np.hypot(X - 100, Y - 75) < 72


def film_texture(count=16, sigma=4.0):
    """Pictures (count, H, W, 3) of a texture that moves by 11 pixels a picture, with noise."""
    rng = np.random.default_rng(3)
    wide = rng.normal(size=(HEIGHT + 60, WIDTH + 12 * count, 3))
    wide = cv2.GaussianBlur(wide, (0, 0), sigma)
    wide = 128 + 50 * wide / wide.std()
    rows = [wide[(7 * i) % 60 :, 11 * i :][:HEIGHT, :WIDTH] for i in range(count)]
    return np.clip(rows + rng.normal(0, 2, (count, HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)


def add_circle(pictures):
    pictures[:, ~CIRCLE] = np.minimum(pictures[:, ~CIRCLE], 4)
    return ~CIRCLE


def add_bars(pictures):
    pictures[:, Y < 18] = 0
    pictures[:, Y > 131] = 0
    return (Y < 18) | (Y > 131)


def add_clock(pictures):
    box = (Y > 120) & (Y < 140) & (X > 20) & (X < 80)
    pictures[:, box] = 30
    for i, picture in enumerate(pictures):
        cv2.putText(picture, f"12:{3 * i:02d}", (26, 136), 0, 0.5, (240, 240, 240), 1)
    return box


def add_logo(pictures):
    disc = np.hypot(X - 160, Y - 30) < 14
    pictures[:, disc] = (200, 30, 40)
    return disc


def add_nothing(pictures):
    return np.zeros((HEIGHT, WIDTH), bool)


def add_sky(pictures):
    for i, picture in enumerate(pictures):  # its horizon is elsewhere in each picture
        picture[40 + 15 * np.sin(i) + 6 * np.sin(X / 9 + i) > Y + 0.1 * X] = 255
    return add_nothing(pictures)


def add_bare_wall(pictures):
    make_plain(pictures)
    return add_nothing(pictures)


def add_night(pictures):
    lamp = 180 * np.exp(-((X - 60) ** 2 + (Y - 60) ** 2) / 400)[..., None]
    for i, picture in enumerate(pictures):  # which stands elsewhere in each picture
        picture[:] = 0.04 * picture + np.roll(lamp, 5 * i, axis=1)
    return add_nothing(pictures)


def make_plain(pictures):
    pictures[:] = 0.05 * pictures + 150


def keep(pictures):
    """Leaves the texture as it is."""


@pytest.mark.parametrize(
    ("scene", "add"),
    [(keep, add_circle), (keep, add_bars), (keep, add_clock), (make_plain, add_circle),
     (make_plain, add_bars)],
)  # fmt: skip
def test_pixels_that_do_not_move_are_found(scene, add):
    pictures = film_texture()
    scene(pictures)
    wanted = add(pictures)
    found = find_fixed_pixels(pictures)
    assert found[wanted].all()
    near = cv2.dilate(wanted.astype(np.uint8), np.ones((7, 7)))
    assert not found[near == 0].any()


def test_logo_before_a_plain_wall_is_found_where_the_far_scene_moves():
    pictures = film_texture()
    for i, picture in enumerate(pictures):  # which ends elsewhere in each picture
        wall = np.abs(X - 110 - 6 * np.sin(i)) > 25
        picture[wall] = 0.05 * picture[wall] + 150
    wanted = add_logo(pictures)
    assert not find_fixed_pixels(pictures)[wanted].any()
    found = find_fixed_pixels(pictures, far_moves=True)
    near = cv2.dilate(wanted.astype(np.uint8), np.ones((7, 7)))
    assert found[wanted].all() and not found[near == 0].any()


def add_object_on_black(pictures):
    for i, picture in enumerate(pictures):  # which looks different from each side
        picture[np.hypot(X - 100 - 30 * np.sin(i), Y - 75 - 20 * np.cos(2 * i)) > 40] = 0
    return add_nothing(pictures)


@pytest.mark.parametrize("far_moves", [None, True])
@pytest.mark.parametrize(
    "add", [add_nothing, add_sky, add_bare_wall, add_night, add_object_on_black]
)
def test_scene_that_is_alike_in_places_is_not_masked(add, far_moves):
    pictures = film_texture()
    add(pictures)
    assert not find_fixed_pixels(pictures, far_moves).any()


def test_still_pictures_are_not_masked():
    pictures = film_texture()
    assert not find_fixed_pixels(np.repeat(pictures[:1], 16, axis=0)).any()


@pytest.mark.parametrize(("change", "is_masked"), [(add_circle, True), (add_nothing, False)])
def test_mask_is_written_and_named_where_pixels_are_fixed(change, is_masked, tmp_path):
    folder, notes = tmp_path / "in", []
    folder.mkdir()
    pictures = film_texture()
    change(pictures)
    for i, picture in enumerate(pictures):
        large = cv2.resize(picture, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / f"{i:02d}.jpg"), large)
    photographs = find_photographs(folder, None)
    masked = mask_fixed_pixels(photographs, tmp_path, notes.append)
    assert (masked is not photographs) == is_masked == (tmp_path / MASK).is_file()
    if is_masked:
        assert set(masked.masks) == {tmp_path / MASK} and "--keep-all-pixels" in notes[0]
        mask = cv2.imread(str(tmp_path / MASK), 0)
        assert mask.shape == (4 * HEIGHT, 4 * WIDTH) and abs((mask == 255).mean() - 0.54) < 0.05
