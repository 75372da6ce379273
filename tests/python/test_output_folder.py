"""Folders that commands write: nobody's files are replaced, one process writes at a time."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import gsut
from gsut import InputError
from gsut.files import WriteError, write_file
from gsut.output_folder import MARKER, claim_folder

HOLD = (
    "import sys\n"
    "from gsut.output_folder import claim_folder\n"
    "held = claim_folder(sys.argv[1], 'train')\n"
    "(held.path / 'scene.ply').write_text('of the other process')\n"
    "print('held', flush=True)\n"
    "sys.stdin.read()\n"
)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_claim_marks_a_new_folder_with_command_version_and_input(tmp_path):
    with claim_folder(tmp_path / "a" / "run", "train", tmp_path / "data") as held:
        write_file(held.path / "scene.ply", "x")
    marker = json.loads((tmp_path / "a" / "run" / MARKER).read_text())
    assert marker["command"] == "gsut train"
    assert marker["version"] == gsut.__version__
    assert marker["input"] == str(tmp_path / "data")


def test_claim_of_what_the_same_command_wrote_goes_on_there(tmp_path):
    for text in ("first", "second"):
        with claim_folder(tmp_path / "run", "train") as held:
            write_file(held.path / "scene.ply", text)
    assert (tmp_path / "run" / "scene.ply").read_text() == "second"


def test_claim_again_changes_no_file(tmp_path):
    with claim_folder(tmp_path / "run", "train", tmp_path / "data") as held:
        write_file(held.path / "scene.ply", "x")
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "run").iterdir()}
    with claim_folder(tmp_path / "run", "train", tmp_path / "data"):
        pass
    assert len(before) == 2
    assert before == {path: path.stat().st_mtime_ns for path in (tmp_path / "run").iterdir()}


def test_claim_beside_somebody_elses_files_refuses_and_changes_nothing(tmp_path):
    (tmp_path / "transforms.json").write_text("precious")
    (tmp_path / "stages").mkdir()
    (tmp_path / "stages" / "notes.txt").write_text("precious")
    before = tree(tmp_path)
    with pytest.raises(InputError, match=r"other than gsut wrote \(stages, transforms.json\)"):
        claim_folder(tmp_path, "poses")
    assert tree(tmp_path) == before


def test_claim_of_another_commands_folder_names_that_command(tmp_path):
    with claim_folder(tmp_path / "run", "scene") as held:
        write_file(held.path / "scene.ply", "x")
    with pytest.raises(InputError, match=r"files that gsut scene wrote \(scene.ply\)"):
        claim_folder(tmp_path / "run", "train")


def test_claim_within_a_command_is_the_commands_own(tmp_path):
    with claim_folder(tmp_path / "run", "scene") as held:
        write_file(held.path / "scene.json", "x")
        assert claim_folder(tmp_path / "run", "train") is held


def test_claim_of_named_files_leaves_the_others_alone(tmp_path):
    (tmp_path / "photo.jpg").write_text("precious")
    with claim_folder(tmp_path, "calibrate", writes=("lens.yaml", "report.html")) as held:
        write_file(held.path / "lens.yaml", "x")
    claim_folder(tmp_path, "calibrate", writes=("lens.yaml", "report.html"))  # its own
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "report.html").write_text("precious")
    with pytest.raises(InputError, match=r"wrote \(report.html\)"):
        claim_folder(tmp_path / "other", "calibrate", writes=("lens.yaml", "report.html"))


def test_claim_that_nothing_came_of_leaves_no_trace(tmp_path):
    claim_folder(tmp_path / "made" / "run", "train")
    (tmp_path / "empty").mkdir()
    claim_folder(tmp_path / "empty", "train")
    assert not (tmp_path / "made" / "run").exists()
    assert list((tmp_path / "empty").iterdir()) == []


@pytest.mark.parametrize("name", ["", "file"])
def test_claim_of_no_folder_says_so(tmp_path, name):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(InputError, match=r"no name|is a file"):
        claim_folder(name and tmp_path / name, "train")


@pytest.mark.parametrize(
    "make", [Path.mkdir, os.mkfifo, lambda marker: marker.symlink_to("../precious")]
)
def test_claim_where_the_marker_is_something_else_is_refused(tmp_path, make):
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "run").mkdir()
    make(tmp_path / "run" / MARKER)
    with pytest.raises(InputError, match=r"gsut\.json is not a file of gsut; remove it"):
        claim_folder(tmp_path / "run", "train")
    assert (tmp_path / "precious").read_text() == "mine"


def test_claim_while_another_process_writes_is_refused_and_free_after_a_kill(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(Path(gsut.__file__).parent.parent)}
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "run")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
    )  # fmt: skip
    assert process.stdout.readline() == b"held\n"
    with pytest.raises(InputError, match="another gsut is writing"):
        claim_folder(tmp_path / "run", "train")
    process.kill()
    process.communicate()
    claim_folder(tmp_path / "run", "train")


@pytest.mark.parametrize(
    "content", ['{"command": null}', '{"command": ["gsut train"]}', "[]", '{"comm']
)
def test_claim_of_a_marker_that_names_no_command_goes_on(tmp_path, content):
    (tmp_path / "out").mkdir()
    for name, text in ((MARKER, content), ("scene.ply", "ply")):
        (tmp_path / "out" / name).write_text(text)
    with claim_folder(tmp_path / "out", "train"):
        assert (tmp_path / "out/scene.ply").read_text() == "ply"


def test_whole_file_through_a_link_writes_what_it_leads_to(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_file(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"


def test_whole_file_over_a_pipe_or_a_folder_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(WriteError, match="is not a file"):
            write_file(tmp_path / name, "x")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder", "pipe"]
