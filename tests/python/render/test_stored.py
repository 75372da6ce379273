"""Scenes that stay in their file: the bits of one in memory, in the memory that is given."""

import subprocess
import sys

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.formats import load_ply, open_ply
from gsut.gaussians import StoredGaussians
from gsut.render import PixelFilter
from random_scenes import fisheye, open_rule, pinhole, random_pose
from stored_reads import count_reads

COUNT, LARGE = 60_000, 500_000
LIMIT = 11_500_000  # bytes: less than half of the scene


def shell(rng, count):
    """Small Gaussians around the world's zero, some of them large, ordered for reading."""
    away = rng.standard_normal((count, 3))
    away *= rng.uniform(3.0, 4.0, (count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    sizes = np.where(np.arange(count) % 1000 == 0, -1.0, rng.uniform(-5.0, -4.0, count))
    g = gsut.Gaussians(
        away.astype(np.float32), rng.standard_normal((count, 4)),
        sizes[:, None] + rng.uniform(-0.5, 0.5, (count, 3)), rng.uniform(-3.0, 3.0, count),
        0.3 * rng.standard_normal((count, 4, 3)),
    )  # fmt: skip
    return g[StoredGaussians.order_rows(g)]


@pytest.fixture(scope="module")
def ply(tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "scene.ply"
    gsut.formats.save_ply(
        path, shell(np.random.default_rng(20261122), COUNT).translate([5e5, 4e6, 100])
    )
    return path


def pose_near(rng, origin=(5e5, 4e6, 100)):
    """Turned anyhow, within a world unit of the shell's middle."""
    pose = random_pose(rng)
    pose[:3, 3] = -pose[:3, :3] @ (np.array(origin) + rng.uniform(-0.5, 0.5, 3))
    return pose


def views(rng):
    """(name, camera, place) of a narrow, a wide, a whole and a moving camera."""
    pose, turned = pose_near(rng), gsut.exp_pose([0.1, 0.05, 0.0, 0.05, -0.1, 0.02])
    sphere = gsut.Camera("equirectangular", [], 320, 160)
    moving = gsut.CameraMotion(pose, turned @ pose, gsut.Shutter("top_to_bottom"))
    return [
        ("pinhole", pinhole(96), pose), ("fisheye", fisheye(128), pose), ("sphere", sphere, pose),
        ("moving", fisheye(112), moving),
    ]  # fmt: skip


def test_stored_scene_has_the_bits_of_one_in_memory(ply, rng, monkeypatch):
    whole, stored = load_ply(ply), open_ply(ply, LIMIT)
    assert isinstance(stored, StoredGaussians)
    assert len(stored) == len(whole) == COUNT
    parts = {}
    for name, camera, place in views(rng):
        parts[name] = count_reads(monkeypatch)
        for background in ((0.2, 0.3, 0.4), None):
            expected = gsut.render(whole, camera, place, background=background)
            found = gsut.render(stored, camera, place, background=background)
            for key in ("image", "alpha", "depth", "distortion"):
                assert (getattr(found, key) == getattr(expected, key)).all(), (name, key)
        monkeypatch.undo()
    assert all(max(reads) < COUNT / 2 for reads in parts.values())
    assert len(parts["sphere"]) > 4  # it was drawn in parts
    assert sum(parts["pinhole"]) < sum(parts["sphere"])  # of less


def test_stored_surfels_have_the_bits_of_those_in_memory(tmp_path, rng):
    path = tmp_path / "discs.ply"
    gsut.formats.save_ply(path, shell(rng, 5000).to_surfels())
    assert b"scale_2" not in path.read_bytes()[:1000]
    stored, camera, pose = open_ply(path, 1_900_000), fisheye(96), np.eye(4)
    assert isinstance(stored, StoredGaussians)
    found, expected = (gsut.render(g, camera, pose).image for g in (stored, load_ply(path)))
    assert (found == expected).all()


def test_lens_that_sees_little_reads_little(ply, rng, monkeypatch):
    stored, pose = open_ply(ply, LIMIT), pose_near(rng)
    reads = count_reads(monkeypatch)
    narrow = gsut.Camera("pinhole", [2000, 2000, 32, 32], 64, 64)
    gsut.render(stored, narrow, pose)
    assert len(reads) == 1
    assert 0 < reads[0] < COUNT / 8
    gsut.render(stored, narrow, pose)
    assert len(reads) == 1  # the same ones are kept


def test_pixel_filter_of_a_stored_scene_has_the_same_bits(ply, rng):
    camera = pinhole(96)
    pose = pose_near(rng)
    scene = gsut.scene_from_arrays([np.zeros((96, 96, 3), np.uint8)], camera, [pose])
    small = camera.resize(48, 48)
    pictures = [
        gsut.render(PixelFilter.from_scene(g, scene).widen(small, pose), small, pose).image
        for g in (load_ply(ply), open_ply(ply, 2 * LIMIT))
    ]  # fmt: skip
    assert (pictures[0] == pictures[1]).all()
    plain = gsut.render(load_ply(ply), small, pose).image
    assert not (pictures[0] == plain).all()


def test_scene_that_fits_is_read_whole(ply):
    assert isinstance(open_ply(ply, 10**9), gsut.Gaussians)
    assert isinstance(open_ply(ply), gsut.Gaussians)


def test_file_of_another_layout_is_read_whole(ply, tmp_path):
    text = tmp_path / "text.ply"
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    head = "".join(f"property float {name}\n" for name in names.split())
    row = "0 0 3 0 0 0 1 -2 -2 -2 1 0 0 0\n"
    text.write_text(f"ply\nformat ascii 1.0\nelement vertex 1\n{head}end_header\n{row}")
    assert isinstance(open_ply(text, 1), gsut.Gaussians)
    damaged = tmp_path / "nan.ply"
    g = load_ply(ply)
    g.means[7] = np.nan
    gsut.formats.save_ply(damaged, g)
    with pytest.warns(UserWarning, match="left out; the first is row 7"):
        assert len(open_ply(damaged, LIMIT)) == COUNT - 1


def test_what_does_not_fit_or_needs_all_is_said(ply, rng):
    stored = open_ply(ply, 200_000)
    with pytest.raises(gsut.InputError, match=r"16 x 16 pixels.*free some memory"):
        gsut.render(stored, pinhole(64), pose_near(rng))
    with pytest.raises(gsut.InputError, match="needs all 60,000 Gaussians"):
        stored.to_gaussians()
    with pytest.raises(gsut.InputError, match="double reference"):
        gsut.render(stored, pinhole(64), pose_near(rng), dtype="float64")
    with pytest.raises(gsut.InputError, match="alpha_min below 1/255"):
        gsut.render(stored, pinhole(64), pose_near(rng), blend=open_rule())
    seen = gsut.render(open_ply(ply, LIMIT), pinhole(32), pose_near(rng))
    with pytest.raises(gsut.InputError, match="gradients are of Gaussians in memory"):
        gsut.render_backward(seen, np.ones_like(seen.image))


_PEAK = """
import sys
import numpy as np
import gsut
from gsut.formats import open_ply
from gsut.run import measure_peak_rss
gsut.set_num_threads(2)
camera = gsut.Camera("equirectangular", [], 320, 160)
gsut.render(open_ply(sys.argv[1])[:1000], camera, np.eye(4))
before = measure_peak_rss()
gsut.render(open_ply(sys.argv[2], int(sys.argv[3])), camera, np.eye(4))
print((measure_peak_rss() - before) * 2**20)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells the peak of memory")
def test_memory_stays_under_what_was_given(ply, tmp_path):
    large = tmp_path / "large.ply"
    gsut.formats.save_ply(large, shell(np.random.default_rng(1), LARGE))
    limit = 20_000_000
    told = subprocess.run(
        [sys.executable, "-c", _PEAK, ply, large, str(limit)],
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    print(f"{float(told.stdout) / 1e6:.1f} MB beside {limit / 1e6:.0f} MB")
    assert float(told.stdout) < limit + tol.STORED_OVERHEAD < 92 * LARGE / 1.5


@pytest.mark.parametrize("lens", [fisheye, pinhole])
def test_gaussians_that_rays_may_see_render_to_the_bits_of_all(rng, lens):
    camera, g, pose = lens(64, 48), shell(rng, 3000), random_pose(rng)
    rays, valid = camera.rays()
    apex = -pose[:3, :3].T @ pose[:3, 3]
    some = g.select_seen(apex, rays[valid] @ pose[:3, :3], 1e-6)
    assert 0 < len(some) < len(g)
    expected, found = (gsut.render(each, camera, pose).image for each in (g, some))
    np.testing.assert_array_equal(found, expected)
    assert len(g.select_seen(apex, rays[valid] @ pose[:3, :3], np.pi)) == len(g)
