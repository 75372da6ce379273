"""Tests SOG files: layout, same bytes, and what is left out."""

import json
import zipfile

import cv2
import numpy as np

from formats.scene_cases import plain_scene
from gsut import formats

COUNT = 300


def test_same_scene_makes_the_same_bytes(tmp_path, rng):
    g = plain_scene(rng, COUNT)
    for name in ("a.sog", "b.sog"):
        formats.save_gaussians(tmp_path / name, g)
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()


def test_images_are_of_the_specified_layout(tmp_path, rng):
    formats.save_gaussians(tmp_path / "good.sog", plain_scene(rng, COUNT))
    with zipfile.ZipFile(tmp_path / "good.sog") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(members["meta.json"])
    assert meta["version"] == 2 and meta["count"] == COUNT and meta["shN"]["bands"] == 3
    assert set(members) == {
        "means_l.webp", "means_u.webp", "quats.webp", "scales.webp", "sh0.webp",
        "shN_centroids.webp", "shN_labels.webp", "meta.json",
    }  # fmt: skip
    pixels = cv2.imdecode(np.frombuffer(members["quats.webp"], np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels.shape == (16, 20, 4)
    assert np.all(pixels.reshape(-1, 4)[:COUNT, 3] >= 252)


def test_gaussians_that_nobody_sees_are_left_out_and_counted(tmp_path, rng):
    g = plain_scene(rng, COUNT)
    g.opacity_logits[[3, 8]] = -9.0
    written = formats.save_gaussians(tmp_path / "a.sog", g)
    assert sorted(set(range(COUNT)) - set(written.rows)) == [3, 8]
    assert "2 Gaussians of opacity below" in written.left_out[0]
