"""Tests the page for any browser: offline, upright, and begun where a photograph was taken."""

import base64
import json
import re

import numpy as np
import pytest

from formats.scene_cases import plain_scene
from gsut import InputError, formats
from gsut.formats import StartView, WriteSettings
from gsut.gaussians import transform_gaussians
from tolerances import FORMAT_ERRORS


def page_of(path):
    """The page's text without the viewer, its scene and its settings."""
    text = path.read_text()
    scene = base64.b64decode(re.search(r'id="scene"[^>]*>([^<]+)<', text).group(1))
    (path.parent / "inside.sog").write_bytes(scene)
    settings = json.loads(re.search(r"^  settings: (\{.*\}),$", text, re.M).group(1))
    return text, formats.load_gaussians(path.parent / "inside.sog"), settings


def test_page_holds_the_scene_the_viewer_and_its_licence_and_asks_for_nothing(tmp_path, rng):
    g = plain_scene(rng, 300)
    written = formats.save_gaussians(tmp_path / "a <b>.html", g)
    text, found, settings = page_of(tmp_path / "a <b>.html")
    errors = formats.measure_errors(g[written.rows], found)
    assert errors["position"] <= FORMAT_ERRORS["SOG"]["position"]
    assert "MIT License" in text and "PlayCanvas" in text and "<title>a &lt;b></title>" in text
    assert re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="[^"]*"', text) == []
    assert len(text) < 2.4e6  # the viewer is 2.1 MB
    assert settings["cameras"][0]["initial"]["fov"] == 60.0


def test_page_begins_at_the_view_and_stands_upright(tmp_path, rng):
    g = plain_scene(rng, 300, 4)
    g.means[0] = [1.0, 2.0, 3.0]  # what is looked at
    up = np.array([0.0, 0.3, 1.0])
    view = StartView(np.array([4.0, -5.0, 6.0]), g.means[0].astype(np.float64), up, 50.0)
    written = formats.save_gaussians(tmp_path / "a.html", g, WriteSettings(view=view))
    _, found, settings = page_of(tmp_path / "a.html")
    initial = settings["cameras"][0]["initial"]
    seen = found.means[list(written.rows).index(0)] * [-1, -1, 1]  # the viewer's axes
    np.testing.assert_allclose(initial["target"], seen, atol=FORMAT_ERRORS["SOG"]["position"])
    eye = np.array(initial["position"])
    np.testing.assert_allclose(np.linalg.norm(eye - initial["target"]), np.sqrt(9 + 49 + 9))
    moved = WriteSettings(view=StartView(view.position + up, view.target, up, 50.0))
    formats.save_gaussians(tmp_path / "b.html", g, moved)
    higher = page_of(tmp_path / "b.html")[2]["cameras"][0]["initial"]["position"]
    np.testing.assert_allclose(higher - eye, [0, np.linalg.norm(up), 0], atol=1e-12)


def test_page_is_not_read(tmp_path, rng):
    formats.save_gaussians(tmp_path / "a.html", plain_scene(rng, 5))
    with pytest.raises(InputError, match="gsut only writes it"):
        formats.load_gaussians(tmp_path / "a.html")


def test_transformed_scene_is_the_same_to_a_transformed_camera(rng):
    import gsut
    from random_scenes import fisheye

    g = plain_scene(rng, 200)
    g.log_scales[:] = rng.uniform(-2.5, -1, g.log_scales.shape)
    camera, pose = fisheye(40), np.eye(4)
    pose[:3, 3] = [0.3, -0.2, 5.0]
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    scale, shift = 1.7, np.array([3.0, -2.0, 0.5])
    moved = np.eye(4)
    moved[:3, :3] = pose[:3, :3] @ rotation.T
    moved[:3, 3] = scale * pose[:3, 3] - moved[:3, :3] @ shift
    before = gsut.render(g.to_dtype(np.float64), camera, pose, dtype="float64").image
    turned = transform_gaussians(g.to_dtype(np.float64), rotation, scale, shift)
    after = gsut.render(turned.with_origin(np.zeros(3)), camera, moved, dtype="float64").image
    assert before.max() > 0.2
    np.testing.assert_allclose(after, before, atol=1e-9)
    with pytest.raises(InputError, match="a rotation and a scale"):
        transform_gaussians(g, -np.eye(3))
