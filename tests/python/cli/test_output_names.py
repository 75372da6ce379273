"""No command makes a folder that is named like a file, or a file of a kind nobody can play."""

import pytest

from gsut.cli import main

FOLDERS = ("train", "scene", "poses", "eval", "demo", "data")


@pytest.mark.parametrize("name", ["k.gif", "small.splat", "scan.LAZ", "photo.heic", "a.spz"])
@pytest.mark.parametrize("command", FOLDERS)
def test_folder_that_is_named_like_a_file_is_refused(command, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = {"demo": ["-o"], "data": ["convert", "DATA"]}.get(command, ["DATA", "-o"])
    assert main([command, *words, name]) == 2
    assert "ends as a file's name does" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("render in.ply -o small.splat", ".splat is no film that can be written"),
        ("render in.ply -o film.avi", ".avi is no film that can be written"),
        ("compact in.ply --keep 0.5 -o k.gif", "give a name ending in .ply"),
        ("convert in.ply k.gif", "no format to write has this suffix"),
        ("edit in.ply -o k.gif", "no format to write has this suffix"),
    ],
)
def test_file_of_another_kind_is_refused(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.ply").write_bytes(b"ply\n")
    assert main(words.split()) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["in.ply"]
