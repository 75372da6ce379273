"""The writer of files: whole or not at all, with a clear sentence where it cannot."""

import json

import pytest

from gsut import InputError
from gsut.files import refuse_existing, whole_file, write_file, write_json


def test_file_whose_writing_fails_leaves_the_old_one(tmp_path):
    path = tmp_path / "rows.json"
    write_json(path, [{"a": 1}])

    with pytest.raises(KeyboardInterrupt), whole_file(path) as temporary:
        temporary.write_bytes(b"half")
        raise KeyboardInterrupt
    assert json.loads(path.read_text()) == [{"a": 1}]
    assert [entry.name for entry in tmp_path.iterdir()] == ["rows.json"]


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
