"""Tests PLY files of Gaussians and points."""

import os

import numpy as np
import pytest

from gsut import InputError, formats
from gsut.data.points import load_points_ply
from gsut.gaussians import press_surfels
from random_scenes import assert_same, random_gaussians

pytestmark = pytest.mark.quick

COEFFICIENTS = (1, 4, 9, 16)


def columns_of(g):
    """Property name -> values, in the order of 3DGS."""
    columns = {name: g.means[:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{c}": g.sh[:, 0, c] for c in range(3)}
    rest = g.sh[:, 1:].transpose(0, 2, 1).reshape(len(g), -1)
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(rest.shape[1])}
    columns["opacity"] = g.opacity_logits
    columns |= {f"scale_{i}": g.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": g.quats[:, i] for i in range(4)}
    return columns


def write_table(path, columns, byte_order, types, before=b"", before_header=""):
    """A PLY file by an independent writer: numpy structured arrays, or text."""
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "a": "ascii"}[byte_order]
    count = len(next(iter(columns.values())))
    names = {
        "f4": "float",
        "f8": "double",
        "u1": "uchar",
        "i2": "int16",
        "u2": "ushort",
        "i4": "int",
    }
    header = f"ply\nformat {kind} 1.0\ncomment made by a test\n{before_header}"
    header += f"element vertex {count}\n"
    header += "".join(f"property {names[types[name]]} {name}\n" for name in columns)
    header += "end_header\n"
    if byte_order == "a":
        rows = zip(*columns.values(), strict=True)
        body = "".join(" ".join(repr(v.item()) for v in row) + "\n" for row in rows).encode()
    else:
        table = np.empty(count, [(name, byte_order + types[name]) for name in columns])
        for name, values in columns.items():
            table[name] = values
        body = table.tobytes()
    path.write_bytes(header.encode() + before + body)


@pytest.mark.parametrize("coefficients", COEFFICIENTS)
@pytest.mark.parametrize("count", [0, 1, 5000])
def test_ply_round_trip_keeps_every_bit(tmp_path, rng, coefficients, count):
    g = random_gaussians(rng, count, coefficients)
    formats.save_ply(tmp_path / "scene.ply", g, ["first", "second line"])
    found = formats.load_ply(tmp_path / "scene.ply")
    assert found.dtype == np.float32
    assert_same(found, g)
    assert sorted(os.listdir(tmp_path)) == ["scene.ply"]


def test_saved_ply_has_the_layout_of_3dgs(tmp_path, rng):
    g = random_gaussians(rng, 3, 16)
    formats.save_ply(tmp_path / "scene.ply", g, ["hello"])
    header, body = (tmp_path / "scene.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:4] == [
        "ply",
        "format binary_little_endian 1.0",
        "comment hello",
        "element vertex 3",
    ]
    names = [line.split()[2] for line in lines[4:]]
    rest = [f"f_rest_{i}" for i in range(45)]
    constant = ["f_dc_0", "f_dc_1", "f_dc_2"]
    scales = ["scale_0", "scale_1", "scale_2"]
    rotation = ["rot_0", "rot_1", "rot_2", "rot_3"]
    normal = ["nx", "ny", "nz"]
    assert names == [*"xyz", *normal, *constant, *rest, "opacity", *scales, *rotation]
    table = np.frombuffer(body, "<f4").reshape(3, 62)
    assert np.all(table[:, 3:6] == 0)
    np.testing.assert_array_equal(table[:, names.index("f_rest_15")], g.sh[:, 1, 1])


@pytest.mark.parametrize("byte_order", ["<", ">", "a"])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_load_ply_in_any_order_format_and_type_finds_the_same(tmp_path, rng, byte_order, kind):
    g = random_gaussians(rng, 20, 4)
    columns = columns_of(g) | {"label": np.arange(20, dtype=np.int16)}
    names = list(rng.permutation(list(columns)))
    types = dict.fromkeys(columns, kind) | {"label": "i2"}
    write_table(tmp_path / "a.ply", {n: columns[n] for n in names}, byte_order, types)
    assert_same(formats.load_ply(tmp_path / "a.ply"), g)


def test_load_ply_skips_elements_with_lists_before_the_vertices(tmp_path, rng):
    g = random_gaussians(rng, 7, 1)
    columns = columns_of(g)
    face_header = "element face 2\nproperty list uchar int vertex_indices\nproperty float area\n"
    faces = bytes([3]) + np.array([0, 1, 2], "<i4").tobytes() + np.float32(1).tobytes()
    faces += bytes([0]) + np.float32(2).tobytes()
    write_table(tmp_path / "a.ply", columns, "<", dict.fromkeys(columns, "f4"), faces, face_header)
    assert_same(formats.load_ply(tmp_path / "a.ply"), g)


def test_load_ply_with_infinite_opacity_logits_keeps_them_as_20(tmp_path, rng):
    g = random_gaussians(rng, 3, 1)
    g.opacity_logits[:] = [np.inf, 0.0, -np.inf]
    formats.save_ply(tmp_path / "a.ply", g)
    found = formats.load_ply(tmp_path / "a.ply")
    assert found.opacity_logits.tolist() == [20.0, 0.0, -20.0]


@pytest.mark.parametrize("name", ["y", "f_dc_1", "opacity", "scale_1", "rot_0", "f_rest_4"])
def test_load_ply_with_a_missing_property_names_it(tmp_path, rng, name):
    columns = columns_of(random_gaussians(rng, 2, 4))
    del columns[name]
    write_table(tmp_path / "a.ply", columns, "<", dict.fromkeys(columns, "f4"))
    with pytest.raises(InputError) as error:
        formats.load_ply(tmp_path / "a.ply")
    assert "a.ply" in str(error.value)
    expected = "8 properties f_rest_" if name.startswith("f_rest") else f'"{name}" is missing'
    assert expected in str(error.value)


def test_surfels_are_written_and_read_as_2dgs_does(tmp_path, rng):
    g = random_gaussians(rng, 30, 4)
    press_surfels(g.log_scales)
    columns = columns_of(g)
    del columns["scale_2"]
    for byte_order in "<>a":
        write_table(tmp_path / "2dgs.ply", columns, byte_order, dict.fromkeys(columns, "f4"))
        assert_same(formats.load_ply(tmp_path / "2dgs.ply"), g)
    formats.save_ply(tmp_path / "ours.ply", g)
    head = (tmp_path / "ours.ply").read_bytes().split(b"end_header")[0]
    assert b"scale_1" in head and b"scale_2" not in head
    assert_same(formats.load_ply(tmp_path / "ours.ply"), g)
    formats.save_ply(tmp_path / "three.ply", g, surfels=False)
    assert b"scale_2" in (tmp_path / "three.ply").read_bytes()
    assert_same(formats.load_ply(tmp_path / "three.ply"), g)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a PLY file"),
        (b"hello\n", "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "ends before end_header"),
        (b"ply\nformat utf8 1.0\nend_header\n", "line 2: unknown format"),
        (b"ply\nelement vertex 1\nend_header\n", "no format line"),
        (b"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "line 3: expected"),
        (b"ply\nformat ascii 1.0\nelement camera 04list\nend_header\n", "line 3: expected"),
        (b"ply\nformat ascii 1.0\nproperty float x\nend_header\n", "before the first element"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\n", "unknown type"),
        (b"ply\nformat ascii 1.0\nelement face 1\nproperty float x\nend_header\n1\n", "no element"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float x\n",
            "appears twice",
        ),
        (b"ply\n" + bytes(range(256)) * 400, "PLY header"),
    ],
)
def test_load_ply_with_a_bad_header_raises(tmp_path, content, message):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        formats.load_ply(tmp_path / "a.ply")
    assert "a.ply" in str(error.value)


def test_load_ply_with_a_word_that_is_no_number_names_row_and_property(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 2\n"
    header += "".join(f"property float {name}\n" for name in "xyz") + "end_header\n"
    (tmp_path / "a.ply").write_text(header + "1 2 3\n4 oops 6\n")
    with pytest.raises(InputError, match='vertex row 1 of 2, property y: "oops" is not a number'):
        load_points_ply(tmp_path / "a.ply")


def test_save_ply_with_a_line_break_in_a_comment_raises(tmp_path, rng):
    with pytest.raises(InputError, match="line break"):
        formats.save_ply(tmp_path / "a.ply", random_gaussians(rng, 1, 1), ["a\nb"])
    assert os.listdir(tmp_path) == []


def test_save_ply_in_float64_rounds_to_float32(tmp_path, rng):
    g = random_gaussians(rng, 5, 4, np.float64)
    formats.save_ply(tmp_path / "a.ply", g)
    assert_same(formats.load_ply(tmp_path / "a.ply"), g.to_dtype(np.float32))


@pytest.mark.parametrize("byte_order", ["<", ">", "a"])
@pytest.mark.parametrize("prefix", ["", "diffuse_"])
def test_load_points_ply_reads_points_and_colors(tmp_path, rng, byte_order, prefix):
    points = rng.normal(size=(9, 3))
    colors = rng.integers(0, 256, size=(9, 3), dtype=np.uint8)
    columns = {f"{prefix}{n}": colors[:, i] for i, n in enumerate(["red", "green", "blue"])}
    columns |= {n: points[:, i] for i, n in enumerate("xyz")}
    types = dict.fromkeys(columns, "u1") | dict.fromkeys("xyz", "f8")
    write_table(tmp_path / "a.ply", columns, byte_order, types)
    found_points, found_colors = load_points_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(found_points, points)
    np.testing.assert_array_equal(found_colors, colors)
    assert found_points.dtype == np.float64 and found_colors.dtype == np.uint8


def test_load_points_ply_skips_rows_of_nothing_at_once(tmp_path):
    header = "ply\nformat ascii 1.0\nelement camera 900000000000000\nelement vertex 1\n"
    header += "".join(f"property float {name}\n" for name in "xyz") + "end_header\n"
    (tmp_path / "a.ply").write_text(header + "1 2 3\n")
    assert load_points_ply(tmp_path / "a.ply")[0].tolist() == [[1.0, 2.0, 3.0]]


def test_load_points_ply_without_colors_is_mid_grey(tmp_path):
    columns = {name: np.zeros(2, np.float32) for name in "xyz"}
    write_table(tmp_path / "a.ply", columns, "<", dict.fromkeys("xyz", "f4"))
    assert np.all(load_points_ply(tmp_path / "a.ply")[1] == 128)


def test_load_points_ply_with_float_colors_scales_and_clamps(tmp_path):
    columns = {name: np.zeros(3, np.float32) for name in "xyz"}
    for name in ("red", "green", "blue"):
        columns[name] = np.array([0.5, 2.0, np.nan], np.float32)
    write_table(tmp_path / "a.ply", columns, "<", dict.fromkeys(columns, "f4"))
    assert load_points_ply(tmp_path / "a.ply")[1][:, 0].tolist() == [128, 255, 0]


@pytest.mark.parametrize(
    ("kind", "levels", "white"),
    [("f4", [51, 255, 0], 255), ("f8", [13107, 65535, 0], 65535), ("u2", [13107, 65535, 0], 65535)],
)
def test_load_points_ply_with_colors_of_an_unusual_range_says_so(tmp_path, kind, levels, white):
    columns = {name: np.zeros(3, np.float32) for name in "xyz"}
    for name in ("red", "green", "blue"):
        columns[name] = np.array(levels, kind)
    types = dict.fromkeys("xyz", "f4") | dict.fromkeys(("red", "green", "blue"), kind)
    write_table(tmp_path / "a.ply", columns, "<", types)
    notes = []
    assert load_points_ply(tmp_path / "a.ply", notes)[1][:, 0].tolist() == [51, 255, 0]
    assert [f"numbers of 0 to {white}" in note for note in notes] == [True]
    columns["red"] = np.array([0, 1e6, 0], np.float32)
    write_table(tmp_path / "b.ply", columns, "<", types | {"red": "f4"})
    with pytest.raises(InputError, match="neither of 0 to 1"):
        load_points_ply(tmp_path / "b.ply")
