"""Files whose values may mean something else are read with a word."""

import gzip
import struct
import warnings

import numpy as np
import pytest

import gsut
from gsut.formats import WriteSettings, save_gaussians
from random_scenes import fisheye, gaussians_in_view, rng_of


@pytest.fixture
def scene():
    return gaussians_in_view(rng_of("suspected"), fisheye(), np.eye(4), 60)


def test_ply_of_activated_values_is_suspected(scene, tmp_path):
    save_gaussians(tmp_path / "plain.ply", scene)
    scene.opacity_logits[:] = 1 / (1 + np.exp(-scene.opacity_logits))
    scene.log_scales[:] = np.exp(scene.log_scales)
    save_gaussians(tmp_path / "active.ply", scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gsut.load_gaussians(tmp_path / "plain.ply")
    with pytest.warns(UserWarning, match="export it again without activating them"):
        assert len(gsut.load_gaussians(tmp_path / "active.ply")) == 60


@pytest.mark.parametrize(
    ("name", "factor"), [("opacity_logits", 1), ("opacity_logits", 255), ("log_scales", 1)]
)
def test_ply_with_one_activated_value_is_suspected_and_a_large_scene_is_not(
    scene, tmp_path, name, factor
):
    scene.log_scales[:] += 6 - scene.log_scales.min()
    save_gaussians(tmp_path / "large.ply", scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gsut.load_gaussians(tmp_path / "large.ply")
    values = getattr(scene, name)
    values[:] = factor * np.linspace(0.01, 0.9, values.size).reshape(values.shape) ** 2
    save_gaussians(tmp_path / "active.ply", scene)
    with pytest.warns(UserWarning, match="does it hold opacities and sizes"):
        gsut.load_gaussians(tmp_path / "active.ply")


def extend(path, records: bytes, cut: int = 0):
    """Adds records behind the Gaussians of an SPZ of version 3, and the flag that says so."""
    data = bytearray(gzip.decompress(path.read_bytes()))
    data[14] |= 2
    path.write_bytes(gzip.compress((bytes(data) + records)[: None if not cut else -cut]))


def test_spz_with_records_behind_loads_and_names_unknown_ones(scene, tmp_path):
    path = tmp_path / "a.spz"
    save_gaussians(path, scene)
    extend(path, struct.pack("<II3f", 0xADBE0002, 12, -0.5, 0.5, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(gsut.load_gaussians(path)) == 60
    extend(path, struct.pack("<III", 0xADBE0004, 4, 1))
    with pytest.warns(UserWarning, match="0xadbe0004 are not read"):
        assert len(gsut.load_gaussians(path)) == 60


@pytest.mark.parametrize("cut", [1, 13])
def test_spz_with_records_cut_off_is_refused(scene, tmp_path, cut):
    path = tmp_path / "a.spz"
    save_gaussians(path, scene)
    extend(path, struct.pack("<II3f", 0xADBE0002, 12, -0.5, 0.5, 1.0), cut)
    with pytest.raises(gsut.InputError, match="truncated or damaged"):
        gsut.load_gaussians(path)


AXES = {0: 1, 6: 1, 4: -1}  # number of a coordinate system: sign of y and z as they are read


def add_axes_in_front(path, number: int):
    """Adds a record to an SPZ of version 4: between header and table, as its library does."""
    data = bytearray(path.read_bytes())
    data[14] |= 2
    (table,) = struct.unpack_from("<I", data, 16)
    data[16:20] = struct.pack("<I", table + 12)
    path.write_bytes(bytes(data[:32]) + struct.pack("<III", 0xADBE0003, 4, number) + data[32:])


def write_axes(path, scene, version: int, number: int):
    if version == 4:
        pytest.importorskip("zstandard")
    save_gaussians(path, scene, WriteSettings(spz_version=version))
    if version == 4:
        add_axes_in_front(path, number)
    else:
        extend(path, struct.pack("<III", 0xADBE0003, 4, number))


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("number", AXES)
def test_spz_with_axes_loads_in_the_axes_of_ply(scene, tmp_path, version, number):
    save_gaussians(tmp_path / "plain.spz", scene)
    write_axes(tmp_path / "axes.spz", scene, version, number)
    plain, read = (gsut.load_gaussians(tmp_path / f"{name}.spz") for name in ("plain", "axes"))
    sign = AXES[number]
    np.testing.assert_array_equal(read.means, plain.means * np.float32([1, sign, sign]))


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(("number", "name"), [(8, "RUF"), (1, "LDB"), (9, "number 9")])
def test_spz_of_axes_that_are_not_read_is_refused_by_name(scene, tmp_path, version, number, name):
    write_axes(tmp_path / "a.spz", scene, version, number)
    with pytest.raises(gsut.InputError, match=f"its coordinate system is {name}"):
        gsut.load_gaussians(tmp_path / "a.spz")
