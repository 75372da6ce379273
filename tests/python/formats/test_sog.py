"""Tests SOG files that are wrong, each in one place."""

import json
import zipfile

import cv2
import numpy as np
import pytest

from formats.scene_cases import plain_scene
from gsut import InputError, formats

COUNT = 300


def webp(width, height, lossless=True):
    quality = [cv2.IMWRITE_WEBP_QUALITY, 101 if lossless else 50]
    return cv2.imencode(".webp", np.zeros((height, width, 3), np.uint8), quality)[1].tobytes()


@pytest.fixture
def members(tmp_path, rng):
    formats.save_gaussians(tmp_path / "good.sog", plain_scene(rng, COUNT))
    with zipfile.ZipFile(tmp_path / "good.sog") as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def archive_of(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def with_meta(members, change):
    meta = json.loads(members["meta.json"])
    change(meta)
    return members | {"meta.json": json.dumps(meta).encode()}


WRONG = {
    "claim": (lambda m: with_meta(m, lambda x: x.update(count=10**12)), "claims 1,000,000,000,000"),
    "count": (lambda m: with_meta(m, lambda x: x.update(count=9000)), "9,000 are needed"),
    "version": (lambda m: with_meta(m, lambda x: x.update(version=1)), "version 1"),
    "no means": (lambda m: with_meta(m, lambda x: x.pop("means")), "means is missing"),
    "palette": (lambda m: with_meta(m, lambda x: x["shN"].update(count=10**9)), "1 to 65536"),
    "label": (lambda m: with_meta(m, lambda x: x["shN"].update(count=1)), "pixels|beyond"),
    "infinite": (lambda m: with_meta(m, lambda x: x.update(count=float("inf"))), "count is inf"),
    "deep": (lambda m: m | {"meta.json": b"[" * 100000}, "lacks what SOG needs"),
    "no meta": (lambda m: {k: v for k, v in m.items() if k != "meta.json"}, "meta.json is missing"),
    "huge image": (lambda m: m | {"quats.webp": webp(4000, 4000)}, "4000 x 4000 pixels"),
    "lossy image": (lambda m: m | {"quats.webp": webp(20, 16, False)}, "no lossless WebP"),
    "bomb": (lambda m: m | {"scales.webp": bytes(10**8)}, "scales.webp has more than"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_file_is_refused_before_memory_is_asked_for(members, tmp_path, case):
    change, message = WRONG[case]
    path = archive_of(tmp_path / "bad.sog", change(members), zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match=message):
        formats.load_gaussians(path)


def test_same_scene_makes_the_same_bytes(tmp_path, rng):
    g = plain_scene(rng, COUNT)
    for name in ("a.sog", "b.sog"):
        formats.save_gaussians(tmp_path / name, g)
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()


def test_images_are_of_the_specified_layout(members):
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
