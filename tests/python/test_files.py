"""The writer of files: whole or not at all, with a clear sentence where it cannot."""

import errno
import json

import numpy as np
import pytest

from gsut import InputError
from gsut.data.export import copy_file
from gsut.files import (
    WriteError,
    check_shape,
    refuse_existing,
    to_file_name,
    whole_file,
    write_file,
    write_json,
    write_picture,
)


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
