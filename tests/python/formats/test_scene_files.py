"""Tests every format of scene files: round trips within their bounds, and files that are wrong."""

import gzip
import struct

import numpy as np
import pytest

import gsut
from formats.scene_cases import plain_scene
from gsut import InputError, formats
from gsut.formats import WriteSettings
from tolerances import FORMAT_ERRORS, GLTF_QUANTISED_TURN, SPZ_DIRECTION

ALL = {each.name: each for each in formats.list_formats()}
READ = [each for each in ALL.values() if each.read is not None]


def file_of(folder, chosen, name="scene"):
    if chosen.name == "USD":
        pytest.importorskip("pxr", reason="usd-core reads and writes USD")
    return folder / f"{name}{chosen.suffixes[0]}"


@pytest.fixture
def written(tmp_path, rng):
    """name of a format -> file with a small scene."""

    def write(chosen, count=300, **settings):
        path = file_of(tmp_path, chosen)
        formats.save_gaussians(path, plain_scene(rng, count), WriteSettings(**settings))
        return path

    return write


def test_every_format_has_bounds():
    assert {each.name for each in READ} == set(FORMAT_ERRORS)


@pytest.mark.parametrize("chosen", READ, ids=lambda each: each.name)
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_round_trip_is_within_the_bounds_of_the_format(tmp_path, rng, chosen, coefficients):
    g = plain_scene(rng, 2000, coefficients)
    path = file_of(tmp_path, chosen)
    written = formats.save_gaussians(path, g)
    found = formats.load_gaussians(path)
    assert written.clipped == {}
    assert sorted(written.rows) == list(range(2000))
    assert found.sh_degree == (0 if chosen.name == "splat" else g.sh_degree)
    errors = formats.measure_errors(g[written.rows], found)
    bounds = FORMAT_ERRORS[chosen.name]
    assert {name: error for name, error in errors.items() if not error <= bounds[name]} == {}


@pytest.mark.parametrize("chosen", ALL.values(), ids=lambda each: each.name)
def test_writing_leaves_out_what_cannot_be_drawn_and_says_which(tmp_path, rng, chosen):
    g = plain_scene(rng, 20)
    g.means[3, 1] = np.nan
    g.quats[7] = 0
    g.sh[11, 5, 2] = np.inf
    path = file_of(tmp_path, chosen)
    written = formats.save_gaussians(path, g)
    assert sorted(written.rows) == sorted(set(range(20)) - {3, 7, 11})
    if chosen.read is not None:
        assert len(formats.load_gaussians(path)) == 17
    with pytest.raises(InputError, match="no Gaussian to write"):
        formats.save_gaussians(path, g[3:4])


@pytest.mark.parametrize("read", [formats.load_ply, formats.load_gaussians])
@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("means", np.nan, "values that are not finite"),
        ("sh", np.inf, "values that are not finite"),
        ("quats", 0.0, "a rotation of norm 0"),
    ],
)
def test_rows_that_cannot_be_drawn_are_left_out_with_file_and_row(
    tmp_path, rng, read, field, value, why
):
    g, path = plain_scene(rng, 20), tmp_path / "a.ply"
    getattr(g, field)[[3, 8]] = value
    gsut.formats.save_ply(path, g)
    said = rf"{path}: 2 of 20 Gaussians have {why} and were left out; the first is row 3"
    with pytest.warns(UserWarning, match=f"^{said}$"):
        assert len(read(path)) == 18
    getattr(g, field)[:] = value
    gsut.formats.save_ply(path, g)
    with pytest.raises(InputError, match=f"none of its 20 Gaussians can be drawn: row 0 has {why}"):
        read(path)


@pytest.mark.parametrize("name", ["PLY", "compressed PLY", "SPZ", "SOG"])
@pytest.mark.parametrize("antialiased", [False, True])
def test_antialiasing_is_kept_where_a_format_has_a_place_for_it(written, name, antialiased):
    path = written(ALL[name], antialiased=antialiased)
    assert formats.read_scene_file(path).antialiased == antialiased


@pytest.mark.parametrize("comment", ["antialiased 1", "SplatRenderMode: mip"])
def test_antialiasing_is_read_from_the_comments_of_other_programs(tmp_path, rng, comment):
    formats.save_ply(tmp_path / "a.ply", plain_scene(rng, 2), [comment])
    assert formats.read_scene_file(tmp_path / "a.ply").antialiased


def test_spz_of_version_2_is_read(tmp_path):
    body = np.array([1 << 12, 0, -(1 << 11)], "<i4").view(np.uint8).reshape(3, 4)[:, :3].tobytes()
    body += bytes([128, 255, 0, 128, 160, 144, 128, 255, 128, 128])
    data = struct.pack("<IIIBBBB", 0x5053474E, 2, 1, 0, 12, 0, 0) + body
    (tmp_path / "a.spz").write_bytes(gzip.compress(data))
    found = formats.load_gaussians(tmp_path / "a.spz")
    np.testing.assert_array_equal(found.means, [[1.0, 0.0, -0.5]])
    np.testing.assert_allclose(found.quats, [[0, 1, 0, 0]], atol=5e-3)
    np.testing.assert_array_equal(found.log_scales, [[0.0, -1.0, -2.0]])


def test_spz_bits_follow_the_extent_and_what_cannot_fit_is_refused(tmp_path, rng):
    for extent, bound in ((1e-3, 2.0**-25), (8.0, 2.0**-20), (1e6, 0.0626)):
        g = plain_scene(rng, 100)
        g.means *= extent / np.abs(g.means).max()
        formats.save_gaussians(tmp_path / "a.spz", g)
        found = formats.load_gaussians(tmp_path / "a.spz")
        assert np.abs(found.means - g.means).max() <= bound
    g.means *= 100
    with pytest.raises(InputError, match="do not fit into SPZ"):
        formats.save_gaussians(tmp_path / "a.spz", g)


def test_spz_keeps_the_digits_of_a_scene_with_a_far_sky(tmp_path, rng):
    g = plain_scene(rng, 1000)
    g.log_scales[:] = -4
    g.means[7] = [3e5, -2e5, 1e5]
    written = formats.save_gaussians(tmp_path / "a.spz", g)
    found = formats.load_gaussians(tmp_path / "a.spz")
    assert written.clipped == {"distance": 1}
    near = np.arange(1000) != 7
    assert np.abs(found.means - g.means)[near].max() <= np.exp(-4) / 16
    # The far one is seen in the same direction, as large as before.
    ratio = np.linalg.norm(found.means[7]) / np.linalg.norm(g.means[7])
    np.testing.assert_allclose(found.means[7], ratio * g.means[7], rtol=SPZ_DIRECTION)
    np.testing.assert_allclose(found.log_scales[7], -4 + np.log(ratio), atol=1 / 32)


def test_values_beyond_a_format_are_brought_to_its_edge_and_counted(tmp_path, rng):
    g = plain_scene(rng, 50)
    g.log_scales[2, 1] = 9.0
    g.sh[4, 3, :2] = [-3.0, 5.0]
    g.sh[6, 0, 0] = 9.0
    clipped = {name: formats.save_gaussians(tmp_path / f"a.{name}", g).clipped for name in ("spz",)}
    assert clipped["spz"] == {"scale": 1, "harmonics": 2, "color": 1}


def test_gltf_is_half_a_turn_about_z_away(tmp_path, rng):
    """The colour that a direction sees stays with the direction."""
    import json

    from gsut import _core  # noqa: F401

    g = plain_scene(rng, 3, 16)
    formats.save_gaussians(tmp_path / "a.glb", g)
    data = (tmp_path / "a.glb").read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    view = document["bufferViews"][0]
    means = np.frombuffer(data, "<f4", 9, 28 + length + view["byteOffset"]).reshape(3, 3)
    np.testing.assert_array_equal(means, g.means * [-1, -1, 1])


def quantize_glb(path, name: str, values: np.ndarray, normalized: bool) -> None:
    """Replaces an attribute of a .glb of Gaussians by whole numbers at the end of its data."""
    import json

    codes = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123}
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document, chunk = json.loads(data[20 : 20 + length]), data[28 + length :]
    rows = values.tobytes()
    rows += bytes(-len(rows) % 4)
    accessor = document["accessors"][
        document["meshes"][0]["primitives"][0]["attributes"][name]
    ]  # fmt: skip
    accessor |= {"componentType": codes[values.dtype.str[1:]], "normalized": normalized,
                 "bufferView": len(document["bufferViews"])}  # fmt: skip
    document["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(chunk), "byteLength": values.nbytes}
    )
    document["buffers"][0]["byteLength"] = len(chunk) + len(rows)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunk += rows
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(chunk))
    path.write_bytes(
        head + struct.pack("<I4s", len(text), b"JSON") + text
        + struct.pack("<I4s", len(chunk), b"BIN\0") + chunk
    )  # fmt: skip


def test_gltf_quantised_attributes_are_read_by_their_types(tmp_path, rng):
    g, path = plain_scene(rng, 7), tmp_path / "a.glb"
    formats.save_gaussians(path, g)
    exact = formats.load_gaussians(path)
    opacity = rng.integers(1, 255, 7).astype("<u1")
    turns = rng.integers(-32768, 32768, (7, 4)).astype("<i2")
    places = rng.integers(-300, 300, (7, 3)).astype("<i2")
    quantize_glb(path, "KHR_gaussian_splatting:OPACITY", opacity, True)
    quantize_glb(path, "KHR_gaussian_splatting:ROTATION", turns, True)
    quantize_glb(path, "POSITION", places, False)
    found = formats.load_gaussians(path)
    np.testing.assert_array_equal(found.means, places * np.float32([-1, -1, 1]))
    np.testing.assert_array_equal(found.log_scales, exact.log_scales)
    np.testing.assert_array_equal(
        np.rint(255 / (1 + np.exp(-found.opacity_logits.astype(np.float64)))), opacity
    )
    x, y, z, w = turns.T / 32767.0
    turned = np.stack([-z, -y, x, w], axis=1)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    quats = found.quats / np.linalg.norm(found.quats, axis=1, keepdims=True)
    assert np.abs(np.sum(turned * quats, axis=1)).min() > 1 - GLTF_QUANTISED_TURN


def test_gltf_whole_numbers_that_are_not_normalized_are_refused_by_name(tmp_path, rng):
    path = tmp_path / "a.glb"
    formats.save_gaussians(path, plain_scene(rng, 7))
    quantize_glb(path, "KHR_gaussian_splatting:OPACITY", np.ones(7, "<u1"), False)
    with pytest.raises(InputError, match="OPACITY has whole numbers that are not normalized"):
        formats.load_gaussians(path)


def test_save_ply_of_surfels_declares_2dgs(tmp_path, rng):
    formats.save_gaussians(tmp_path / "a.ply", plain_scene(rng, 5).to_surfels())
    assert b"\ncomment SplatRenderMode: 2dgs\n" in (tmp_path / "a.ply").read_bytes()


def test_usd_is_valid_and_has_w_x_y_z_of_a_turned_scene(tmp_path, rng):
    usd = pytest.importorskip("pxr.Usd", reason="usd-core reads USD")
    validation = pytest.importorskip("pxr.UsdValidation")
    g = plain_scene(rng, 3, 16)
    formats.save_gaussians(tmp_path / "a.usda", g)
    stage = usd.Stage.Open(str(tmp_path / "a.usda"))
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 20
    assert validation.ValidationContext(validators).Validate(stage) == []
    prim = stage.GetDefaultPrim()
    np.testing.assert_array_equal(prim.GetAttribute("positions").Get(), g.means * [-1, -1, 1])
    found = prim.GetAttribute("orientations").Get()[1]
    w, x, y, z = g.quats[1] / np.linalg.norm(g.quats[1])
    turned = np.array([-z, -y, x, w])
    wxyz = np.array([found.GetReal(), *found.GetImaginary()])
    np.testing.assert_allclose(wxyz * np.sign(wxyz @ turned), turned, atol=1e-6)


def test_unknown_suffix_is_refused_with_the_known_ones(tmp_path, rng):
    g = plain_scene(rng, 2)
    with pytest.raises(InputError, match=r"suffix; known: .*\.glb.*\.ply.*\.spz"):
        formats.save_gaussians(tmp_path / "a.obj", g)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="cannot be opened"):
        formats.load_gaussians(tmp_path / "a.spz")
