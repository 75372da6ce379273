"""Scenes that a file moves: glTF nodes, USD transforms, coordinates far from zero."""

import json
import struct
import warnings

import numpy as np
import pytest

import gsut
from formats.scene_cases import plain_scene
from gsut import InputError, formats
from gsut.gaussians import rotations_from_quaternions, transform_gaussians
from random_scenes import fisheye
from tolerances import FORMAT_ERRORS, PLACED

QUAT = np.array([0.5, 0.1, -0.7, 0.2]) / np.linalg.norm([0.5, 0.1, -0.7, 0.2])
UTM = np.array([393_123.25, 5_819_456.75, 41.5])
FLIP = np.diag([-1.0, -1.0, 1.0])  # from a file's axes, where y is up, to ours


def with_nodes(path, nodes):
    """The glTF file with other nodes."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length]) | {"nodes": nodes}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(rest)) + rest)


def assert_placed(found, g, scale, rotation, translation):
    expected = transform_gaussians(g, FLIP @ rotation @ FLIP, scale, FLIP @ translation)
    assert found.origin == pytest.approx(expected.origin)
    errors = formats.measure_errors(expected, found)
    assert {name: error for name, error in errors.items() if error > PLACED} == {}


def test_gltf_nodes_place_the_scene(tmp_path, rng):
    g = plain_scene(rng, 50)
    formats.save_gaussians(tmp_path / "a.glb", g)
    x, y, z = QUAT[1:]
    child = {"mesh": 0, "rotation": [x, y, z, QUAT[0]], "translation": [1, 2, 3]}
    turn = rotations_from_quaternions(QUAT[None])[0]
    parent = np.eye(4)
    parent[:3, :3] = 2.0 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    parent[:3, 3] = [5e5, 0, -7]
    nodes = [{"children": [1], "matrix": parent.T.ravel().tolist()}, child]
    with_nodes(tmp_path / "a.glb", nodes)
    whole = parent[:3, :3] @ [1, 2, 3] + parent[:3, 3]
    found = formats.load_gaussians(tmp_path / "a.glb")
    assert_placed(found, g, 2.0, parent[:3, :3] / 2 @ turn, whole)


@pytest.mark.parametrize(
    ("nodes", "said"),
    [
        ([{"mesh": 0, "scale": [1, 2, 1]}], "mirrors or stretches"),
        ([{"mesh": 0, "scale": [-1, 1, 1]}], "mirrors or stretches"),
        ([{"mesh": 0, "scale": [0, 0, 0]}], "mirrors or stretches"),
        ([{"mesh": 0, "translation": [float("nan"), 0, 0]}], "mirrors or stretches"),
        ([{"mesh": 0}, {"mesh": 0}], "2 nodes show its Gaussians"),
        ([{"mesh": 0, "children": [0]}], "their own parents"),
        ([{"mesh": 0, "matrix": [1, 2]}], "no glTF file of Gaussians"),
        ([{"mesh": 0, "rotation": "up"}], "no glTF file of Gaussians"),
    ],
)
def test_gltf_nodes_that_gaussians_cannot_follow_are_refused(tmp_path, rng, nodes, said):
    formats.save_gaussians(tmp_path / "a.glb", plain_scene(rng, 5))
    with_nodes(tmp_path / "a.glb", nodes)
    with pytest.raises(InputError, match=said):
        formats.load_gaussians(tmp_path / "a.glb")


def test_usd_transform_places_the_scene_and_usdz_is_read_as_usdc(tmp_path, rng):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core reads USD")
    from pxr import Gf, UsdGeom

    g = plain_scene(rng, 50)
    formats.save_gaussians(tmp_path / "a.usdz", g)
    assert (tmp_path / "a.usdz").read_bytes()[:2] == b"PK"
    same = formats.load_gaussians(tmp_path / "a.usdz")
    errors = formats.measure_errors(g, same)
    bounds = FORMAT_ERRORS["USD"]
    assert {name: error for name, error in errors.items() if error > bounds[name]} == {}
    formats.save_gaussians(tmp_path / "a.usda", g)
    stage = usd.Stage.Open(str(tmp_path / "a.usda"))
    place = UsdGeom.Xformable(stage.GetDefaultPrim())
    place.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    place.AddOrientOp().Set(Gf.Quatf(*QUAT.tolist()))
    place.AddScaleOp().Set(Gf.Vec3f(3, 3, 3))
    stage.GetRootLayer().Save()
    found = formats.load_gaussians(tmp_path / "a.usda")
    assert_placed(found, g, 3.0, rotations_from_quaternions(QUAT[None])[0], np.array([1.0, 2, 3]))


def ply_of_others(path, g, kind, places):
    """A PLY as other programs write it, with text or float64 coordinates."""
    names = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
             "rot_0", "rot_1", "rot_2", "rot_3"]  # fmt: skip
    wide = "double" if kind == "double" else "float"
    header = ["ply", f"format {'ascii' if kind == 'ascii' else 'binary_little_endian'} 1.0",
              f"element vertex {len(g)}", *(f"property {wide} {name}" for name in "xyz"),
              *(f"property float {name}" for name in names), "end_header", ""]  # fmt: skip
    rest = np.concatenate([g.sh[:, 0], g.opacity_logits[:, None], g.log_scales, g.quats], axis=1)
    if kind == "ascii":
        rows = [" ".join(map(repr, [*a.tolist(), *b.tolist()]))
                for a, b in zip(places, rest, strict=True)]  # fmt: skip
        body = "\n".join(rows).encode()
    else:
        parts = zip(places.astype("<f8" if kind == "double" else "<f4"), rest, strict=True)
        body = b"".join(a.tobytes() + b.astype("<f4").tobytes() for a, b in parts)
    path.write_bytes("\n".join(header).encode() + body)


@pytest.mark.parametrize("kind", ["ascii", "double"])
def test_utm_coordinates_of_others_keep_their_digits(tmp_path, rng, kind):
    g = plain_scene(rng, 20, 1)
    places = g.means.astype(np.float64) + UTM
    ply_of_others(tmp_path / "a.ply", g, kind, places)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = formats.load_gaussians(tmp_path / "a.ply")
    assert np.abs(found.means).max() < 40
    np.testing.assert_allclose(found.means + found.origin, places, rtol=0, atol=PLACED)
    formats.save_gaussians(tmp_path / "b.ply", found)
    again = formats.load_gaussians(tmp_path / "b.ply")
    np.testing.assert_array_equal(again.means + again.origin, found.means + found.origin)


def test_utm_coordinates_that_float_has_rounded_are_told(tmp_path, rng):
    g = plain_scene(rng, 20, 1)
    g.log_scales[:] = -3
    ply_of_others(tmp_path / "a.ply", g, "float", g.means + UTM)
    with pytest.warns(UserWarning, match=r"coordinates lie 0.5 apart, .* 0.05 large"):
        formats.load_gaussians(tmp_path / "a.ply")


def test_coordinates_near_zero_stay_as_they_are(tmp_path, rng):
    g = plain_scene(rng, 20, 1)
    ply_of_others(tmp_path / "a.ply", g, "double", g.means.astype(np.float64))
    found = formats.load_gaussians(tmp_path / "a.ply")
    assert not found.origin.any()
    np.testing.assert_array_equal(found.means, g.means)


def test_transformed_scene_is_the_same_to_a_transformed_camera(rng):
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
