"""Files whose values may mean something else are read with a word."""

import gzip
import struct
import warnings

import numpy as np
import pytest

import gsut
from gsut.formats import save_gaussians
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
