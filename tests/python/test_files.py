"""The writer of files: whole or not at all, with a clear sentence where it cannot."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest

import gsut
from formats.scene_cases import plain_scene
from gsut import InputError, formats
from gsut.data.assemble import fit_camera
from gsut.files import (
    WriteError,
    check_shape,
    claim_name,
    copy_file,
    read_json,
    read_text,
    refuse_existing,
    to_file_name,
    whole_file,
    write_file,
    write_json,
    write_picture,
)
from gsut.output_folder import claim_folder
from gsut.sfm.photographs.stages import Stages


def test_file_whose_writing_fails_leaves_the_old_one(tmp_path):
    path = tmp_path / "rows.json"
    write_json(path, [{"a": 1}])

    with pytest.raises(KeyboardInterrupt), whole_file(path) as temporary:
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt
    assert json.loads(path.read_text()) == [{"a": 1}]
    assert [entry.name for entry in tmp_path.iterdir()] == ["rows.json"]


@pytest.mark.parametrize("write", [write_picture, lambda path, _: copy_file(__file__, path)])
def test_a_full_disk_is_told_of_the_file_that_is_written(write, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", __file__)

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    monkeypatch.setattr("shutil.copyfile", full)
    with pytest.raises(WriteError, match=r"cannot write .*a\.jpg: No space left on device"):
        write(tmp_path / "a.jpg", np.zeros((4, 4, 3), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_file_into_no_folder_is_refused_and_named(tmp_path):
    with pytest.raises(InputError, match=r"cannot write .*absent/a.txt: No such file"):
        write_file(tmp_path / "absent" / "a.txt", "text")


@pytest.mark.parametrize("name", ["absent/a.ply", "file/a.ply", "loop/a.ply"])
def test_a_name_that_nothing_can_have_is_refused_before_work_is_done(tmp_path, name):
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=r"a\.ply cannot be written: .* is no folder that is"):
        refuse_existing(tmp_path / name)
    refuse_existing(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "safe"),
    [("/..", "unnamed"), ("/cam0/left", "cam0_left"), ("..\\..\\x", "x"), ("a\0b", "a_b"),
     ("C:con", "C_con"), (".git", "git"), ("Straße 1", "Straße_1"), ("", "unnamed"),
     ("x" * 300, "x" * 60)],
)  # fmt: skip
def test_name_of_any_origin_becomes_one_part_of_a_path(name, safe, tmp_path):
    assert to_file_name(name) == safe
    assert (tmp_path / to_file_name(name)).resolve().parent == tmp_path.resolve()


def test_claimed_names_that_are_taken_get_numbers_before_their_suffix():
    taken = set()
    names = ["a/b.png", "a/b.png", "a/b-2.png", "a/b", "a.d/b", "a.d/b"]
    claimed = [claim_name(name, taken) for name in names]
    assert claimed == ["a/b.png", "a/b-2.png", "a/b-2-2.png", "a/b", "a.d/b", "a.d/b-2"]
    assert taken == set(claimed)


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_file(path, "text"),
        lambda path: write_json(path, []),
        lambda path: refuse_existing(Path(path)),
        lambda path: formats.save_ply(path, plain_scene(np.random.default_rng(1), 3)),
        lambda path: claim_folder(path, "train"),
    ],
)
def test_a_name_with_a_zero_byte_is_refused_and_overwrites_nothing(write, tmp_path):
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(InputError, match="zero byte"):
        write(f"{tmp_path}/mine\0.json")
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]
    assert (tmp_path / "mine").read_text() == "mine"


@pytest.mark.parametrize(
    ("value", "shape", "said"),
    [
        ([], dict, r"the content is \[\]"),
        ({"a": 1}, {"a": str}, r"the content\['a'\] is 1"),
        ({}, {"a": str}, "the content lacks 'a'"),
        ({"a": True}, {"a": int}, r"\['a'\] is True"),
        ({"a": [1, "x"]}, {"a?": [int]}, r"\['a'\]\[1\] is 'x'"),
        ({"a": {"b": None}}, {"*": {"b": (int, str)}}, r"\['b'\] is None"),
        ({"level": []}, {"level": frozenset(("good",))}, r"\['level'\] is \[\]"),
    ],
)
def test_check_shape_of_another_value_says_where(value, shape, said):
    with pytest.raises(TypeError, match=said):
        check_shape(value, shape)


def test_check_shape_of_what_fits_says_nothing():
    shape = {"a?": int, "b": [(str, type(None))], "c": {"*": [float]}, "d": frozenset("xy")}
    check_shape({"b": ["x", None], "c": {"k": [0.5]}, "d": "x", "more": []}, shape)


def test_ply_writer_leaves_files_and_links_beside_it_alone(tmp_path):
    beside, target, link = (tmp_path / name for name in ("a.ply.partial", "target", "link.ply"))
    target.write_text("mine")
    beside.symlink_to(target)
    scene = plain_scene(np.random.default_rng(1), 5)
    formats.save_ply(tmp_path / "a.ply", scene)
    assert beside.is_symlink()
    assert target.read_text() == "mine"
    link.symlink_to(tmp_path / "a.ply")
    formats.save_ply(link, scene[:2])
    assert link.is_symlink()
    assert len(formats.load_ply(tmp_path / "a.ply")) == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "a.ply", "a.ply.partial", "link.ply", "target"
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["features.npz", "key.txt"])
def test_stage_file_that_a_power_cut_left_empty_counts_as_absent(name, tmp_path):
    stages = Stages(tmp_path, {"k": 1})
    stages.save("features", {"a": np.arange(3)})
    (stages.folder / name).write_bytes(b"")
    assert Stages(tmp_path, {"k": 1}).load("features") is None


def test_equirectangular_camera_of_a_picture_that_is_no_panorama_is_refused():
    camera = gsut.Camera("equirectangular", [], 640, 480)
    with pytest.raises(InputError, match=r"640 x 480 .* panorama is twice as wide as high"):
        fit_camera(camera, 640, 480, Path("a.png"))
    panorama = gsut.Camera("equirectangular", [], 640, 320)
    assert fit_camera(panorama, 320, 160, Path("a.png")).width == 320


def test_text_of_zeros_is_not_text(tmp_path):
    path = tmp_path / "lens.yaml"
    path.write_bytes(bytes(64))
    with pytest.raises(InputError, match=r"lens\.yaml: is not text \(character 0 is 0\)"):
        read_text(path)


@pytest.mark.parametrize(
    ("advice", "said"), [({}, "save the file as UTF-8"), ({"advice": "remove it"}, "remove it")]
)
def test_bytes_in_place_of_json_get_the_advice_of_the_file(advice, said, tmp_path):
    (tmp_path / "a.json").write_bytes(b"\xff\xfe\xfd")
    with pytest.raises(InputError, match=f"is not text .*; {said}$"):
        read_json(tmp_path / "a.json", **advice)


def test_number_of_too_many_digits_names_its_key(tmp_path):
    (tmp_path / "a.json").write_text('{"a": [{"fl_x": ' + "1" * 400 + "}]}")
    with pytest.raises(InputError, match="key 'fl_x' has a number of 400 digits"):
        read_json(tmp_path / "a.json")
