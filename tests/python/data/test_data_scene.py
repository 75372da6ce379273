"""Scene: decoding, masks, scaling, cache, extent."""

import concurrent.futures
import dataclasses

import cv2
import numpy as np
import pytest

import gsut
import small_datasets as small
import tolerances
from gsut.data import load_dataset
from gsut.data.images import decode_image, decode_mask, read_header, shrink_image, shrink_mask
from gsut.data.scene import TrainingViews, choose_inner_views, split_views
from gsut.data.scene.lru_cache import LruCache
from gsut.data.scene.scene import make_lens_mask


def test_scaled_image_is_the_area_mean(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path))
    half = scene.scale_images(0.5)
    full = scene.image(3).astype(float)
    mean = full.reshape(small.HEIGHT // 2, 2, small.WIDTH // 2, 2, 3).mean(axis=(1, 3))
    assert half.image(3).shape == mean.shape
    assert np.abs(half.image(3) - mean).max() <= tolerances.DATA_EIGHT_BIT


@pytest.mark.parametrize("factor", [0.5, 0.3, 0.07, 0.001])
def test_scaled_size_is_rounded_and_at_least_one(factor, tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path)).scale_images(factor)
    size = [max(1, int(n * factor + 0.5)) for n in (small.HEIGHT, small.WIDTH)]
    assert list(scene.image(0).shape[:2]) == size == list(scene.mask(0).shape)
    np.testing.assert_allclose(
        scene.camera(0).params[0] / small.FX, size[1] / small.WIDTH, rtol=tolerances.DATA_ROUNDING
    )


@pytest.mark.parametrize("factor", [0, -1, 1.5, float("nan")])
def test_scaled_factor_out_of_range_raises(factor, tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path))
    with pytest.raises(gsut.InputError, match="scale must be above 0 and at most 1"):
        scene.scale_images(factor)


@pytest.mark.parametrize("angle_degrees", [40, 70, 95])
@pytest.mark.parametrize("factor", [0.9, 0.5, 0.37, 0.125, 0.02])
def test_lens_mask_of_a_scaled_scene_equals_asking_every_source_pixel(factor, angle_degrees):
    params = [110.0, 111.0, 163.3, 118.2, 0.03, -0.01, 0.002, -0.0004]
    full = gsut.Camera(
        "kannala_brandt", params, 320, 240, valid_field_angle=np.radians(angle_degrees)
    )
    size = [max(1, int(n * factor + 0.5)) for n in (320, 240)]
    camera = full.resize(*size)
    expected = camera.rays()[1] & shrink_mask(np.array(full.rays()[1]), *size)
    assert 0 < full.rays()[1].mean() < 1
    np.testing.assert_array_equal(make_lens_mask(camera, full), expected)


def test_shrink_mask_any_ratio_is_valid_only_where_all_sources_are(rng):
    cases = 0
    for _ in range(60):
        height, width = (int(n) for n in rng.integers(1, 30, 2))
        h, w = int(rng.integers(1, height + 1)), int(rng.integers(1, width + 1))
        mask = rng.random((height, width)) < 0.9
        shrunk = shrink_mask(mask, w, h)
        for y in range(h):
            for x in range(w):
                rows = slice(y * height // h, -(-(y + 1) * height // h))
                columns = slice(x * width // w, -(-(x + 1) * width // w))
                assert shrunk[y, x] == mask[rows, columns].all()
                cases += 1
    assert cases > 1000


def assert_halved_is_valid_only_where_all_are(scene, mask):
    blocks = mask.reshape(small.HEIGHT // 2, 2, small.WIDTH // 2, 2)
    np.testing.assert_array_equal(scene.scale_images(0.5).mask(0), blocks.all(axis=(1, 3)))


def test_mask_combines_file_and_alpha(tmp_path):
    mask = np.full((small.HEIGHT, small.WIDTH), 255, np.uint8)
    mask[:3] = 0
    small.write_nerfstudio(tmp_path, mask_path="mask.png")
    small.write_png(tmp_path / "mask.png", mask)
    rgba = np.full((small.HEIGHT, small.WIDTH, 4), 255, np.uint8)
    rgba[:, :2, 3] = 254
    small.write_png(tmp_path / "images/000.png", rgba)
    scene = load_dataset(tmp_path)
    expected = np.ones((small.HEIGHT, small.WIDTH), bool)
    expected[:3] = False
    np.testing.assert_array_equal(scene.mask(1), expected)
    expected[:, :2] = False
    np.testing.assert_array_equal(scene.mask(0), expected)
    assert_halved_is_valid_only_where_all_are(scene, expected)


def test_mask_fisheye_leaves_out_pixels_without_a_ray(tmp_path):
    """k1 = -0.2 folds back at 1.29 rad: the corners of a wide image have no ray."""
    lens = {"camera_model": "OPENCV_FISHEYE", "fl_x": 15.0, "fl_y": 15.0, "k1": -0.2}
    scene = load_dataset(small.write_nerfstudio(tmp_path, **lens))
    y, x = np.mgrid[: small.HEIGHT, : small.WIDTH] + 0.5
    theta = 1 / np.sqrt(0.6)  # root of 1 + 3 k1 theta^2
    limit = 15.0 * theta * (1 - 0.2 * theta**2)
    distance = np.hypot(x - small.CX, y - small.CY)
    mask = scene.mask(0)
    assert mask[distance < limit - 1].all() and not mask[distance > limit + 1].any()
    assert 0.1 < mask.mean() < 0.9
    assert_halved_is_valid_only_where_all_are(scene, mask)


def test_image_grey_and_sixteen_bits_become_rgb(tmp_path):
    grey = np.arange(small.HEIGHT * small.WIDTH).reshape(small.HEIGHT, small.WIDTH) % 256
    small.write_png(tmp_path / "grey.png", grey.astype(np.uint8))
    small.write_png(tmp_path / "deep.png", (grey * 257).astype(np.uint16))
    for name in ("grey.png", "deep.png"):
        pixels, valid = decode_image(tmp_path / name)
        assert valid is None and pixels.dtype == np.uint8
        np.testing.assert_array_equal(pixels, np.repeat(grey[:, :, None], 3, axis=2))


def test_image_exif_orientation_is_not_applied(tmp_path):
    jpeg = cv2.imencode(".jpg", small.render(small.world_from_cameras()[0]))[1].tobytes()
    # one TIFF entry, big endian: tag 0x112 (orientation), SHORT, count 1, value 6 = turn by 90
    tiff = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    exif = b"Exif\0\0" + tiff
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg[:2] + segment + jpeg[2:])
    turned = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
    assert turned.shape[:2] == (small.WIDTH, small.HEIGHT)  # the marker is really in force
    assert decode_image(path)[0].shape == (small.HEIGHT, small.WIDTH, 3)
    assert read_header(path)[:2] == (small.WIDTH, small.HEIGHT)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff", ".webp"])
def test_header_each_file_type_gives_the_decoded_size(suffix, tmp_path):
    path = tmp_path / f"image{suffix}"
    small.write_png(path, np.zeros((7, 13, 3), np.uint8))
    assert read_header(path)[:2] == (13, 7)
    assert decode_image(path)[0].shape == (7, 13, 3)


def test_mask_file_of_zeros_and_ones_is_read_as_black_and_white(tmp_path):
    ones = np.eye(6, dtype=np.uint8)
    for factor in (1, 255):
        small.write_png(tmp_path / "mask.png", ones * factor)
        np.testing.assert_array_equal(decode_mask(tmp_path / "mask.png"), ones.astype(bool))


def test_image_from_many_threads_is_the_same_and_read_only(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path)).scale_images(0.5)
    scene._images.limit_bytes = 1  # every call decodes anew
    expected = [
        shrink_image(small.render(pose), small.WIDTH // 2, small.HEIGHT // 2)
        for pose in small.world_from_cameras()
    ]
    with concurrent.futures.ThreadPoolExecutor(8) as threads:
        images = list(threads.map(lambda i: (i, scene.image(i)), list(range(small.VIEWS)) * 10))
    assert len(images) == 10 * small.VIEWS
    for i, image in images:
        np.testing.assert_array_equal(image, expected[i])
        assert not image.flags.writeable


def test_cache_over_its_limit_drops_the_oldest():
    cache, made = LruCache(250), []

    def get(key):
        return cache.get(key, lambda: (made.append(key), (np.zeros(100, np.uint8),))[1])

    for key in (1, 2, 1, 3, 1, 2):
        get(key)
    assert made == [1, 2, 3, 2]  # 3 pushed out 2, not 1, which was used later


def test_extent_is_the_largest_distance_of_a_training_camera(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path), test_every=0)
    centers = np.array([pose[:3, 3] for pose in small.world_from_cameras()])
    radius = np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()
    np.testing.assert_allclose(scene.extent, 1.1 * radius, rtol=tolerances.DATA_ROUNDING)


def test_extent_of_cameras_at_one_place_falls_back_on_the_points(tmp_path):
    values = small.transforms()
    for frame in values["frames"]:
        for row in frame["transform_matrix"][:3]:
            row[3] = 1.0
    scene = load_dataset(small.write_nerfstudio(tmp_path, values))
    xyz = small.points()[0]
    spread = np.sqrt(((xyz - xyz.mean(axis=0)) ** 2).sum(axis=1).mean())
    np.testing.assert_allclose(scene.extent, 1.1 * spread, rtol=tolerances.DATA_PLY_POSITION)
    del values["ply_file_path"]
    assert load_dataset(small.write_nerfstudio(tmp_path, values)).extent == 1.0


def test_image_changed_after_loading_raises(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path))
    small.write_png(tmp_path / "images/001.png", np.zeros((5, 5, 3), np.uint8))
    with pytest.raises(gsut.InputError, match="the image is 5 x 5, expected 48 x 36"):
        scene.image(1)


def test_mask_sponza_tiny_equals_the_dataset_circle(shared):
    """mask.png holds the pixels wholly inside the image circle; the lens leaves no fewer."""
    path = shared / "data" / "sponza_fisheye_tiny"
    np.testing.assert_array_equal(load_dataset(path).mask(0), decode_mask(path / "mask.png"))


def test_scene_is_a_value_that_nothing_changes(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path))
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.train_indices = ()
    with pytest.raises(TypeError):
        scene.cameras[0] = scene.cameras[0]
    for array in (scene.points, scene.world_offset, scene.views[0].camera_from_world):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_replaced_scene_shares_what_is_decoded_and_nothing_else_changes(tmp_path):
    scene = load_dataset(small.write_nerfstudio(tmp_path))
    moved = scene.with_poses([2, 0], np.stack([np.eye(4)] * 2))
    assert [np.array_equal(v.camera_from_world, np.eye(4)) for v in moved.views[:4]] == [
        True, False, True, False,
    ]  # fmt: skip
    assert moved.image(1) is scene.image(1) and moved.mask(1) is scene.mask(1)
    (lens,) = scene.file_cameras
    wider = scene.scale_images(0.5).with_lenses([lens.with_params(lens.params * 0.9)])
    np.testing.assert_allclose(wider.cameras[0].params, 0.45 * lens.params)
    fewer = scene.replace(views=scene.views[3:], train_indices=[0], test_indices=[])
    assert fewer.image(0) is scene.image(3)
    assert (len(scene), len(fewer), fewer.test_indices) == (small.VIEWS, small.VIEWS - 3, ())


def test_training_views_own_poses_and_lenses_at_every_resolution(tmp_path, monkeypatch):
    monkeypatch.setattr("gsut.data.scene.training_views.SMALLEST_SIDE", 8)
    views = TrainingViews(load_dataset(small.write_nerfstudio(tmp_path)), (0.3, 0.6))
    level = views.select_level(0.5)
    assert level.scene.camera(0).width == small.WIDTH // 2
    state, poses = views.state_dict(), views.poses + 1.0
    views.move(poses)
    (lens,) = views.scene.file_cameras
    views.replace_lenses([lens.with_params(lens.params * 0.9)])
    for scene in (views.scene, views.select_level(0.5).scene, views.select_level(1.0).scene):
        np.testing.assert_array_equal(scene.poses(scene.train_indices), poses)
        scale = scene.cameras[0].width / small.WIDTH
        np.testing.assert_allclose(scene.cameras[0].params, 0.9 * scale * lens.params)
    views.load_state_dict(state)
    np.testing.assert_array_equal(views.poses, state["poses"])
    assert views.select_level(1.0).scene.camera(0) == lens


@pytest.mark.parametrize("total", [*range(12), 17, 100])
def test_inner_views_have_training_views_on_both_sides(total):
    names = [f"{i:03d}" for i in range(total)]
    chosen = [names.index(name) for name in choose_inner_views(names, 8)]
    assert len(chosen) == (-(-total // 8) if total > 2 else 0)
    for index in chosen:
        assert 0 < index < total - 1 and not {index - 1, index + 1} & set(chosen)
    assert choose_inner_views(names, 0) == []


def test_inner_views_are_those_that_the_others_know_most_of_where_the_order_says_nothing():
    names = [f"{i:03d}" for i in range(10)]
    spare = [0, 3, 9, 9, 1, 8, 2, 2, 2, 7]
    assert choose_inner_views(names, 8, spare) == ["002", "005"]


def test_name_in_full_wins_over_the_same_file_name_in_a_folder(tmp_path):
    names = ["a.png", "left/a.png"]
    assert split_views(names, tmp_path, test_names=["a.png"])[:2] == ([1], [0])
