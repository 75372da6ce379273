"""What goes wrong around a command ends in one sentence and an exit status, never a traceback."""

import argparse
import contextlib
import errno
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

import gsut
import small_datasets
from formats.scene_cases import plain_scene
from gsut import _starting
from gsut.cli import EXIT_INPUT, EXIT_PIPE, main, run_command

ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(gsut.__file__).parent.parent)}
GSUT = [sys.executable, "-m", "gsut"]
_BLAS = "OPENBLAS_NUM_THREADS"
# Runs many commands in one process whose files cannot grow beyond 64 bytes, as on a full disk.
ON_FULL_DISK = """
import contextlib, io, json, resource, sys
sys.dont_write_bytecode = True  # Python keeps what a full disk leaves of it, and fails on it later
import av, cv2, numpy  # what opens files of its own
from gsut.cli import main

commands = json.loads(sys.stdin.read())
resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))
told = []
for words in commands:
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        status = main(words)
    told.append([status, errors.getvalue()])
print(json.dumps(told))
"""


def status_of(error: Exception) -> int:
    def run(_):
        raise error

    def parser_of(_):
        parser = argparse.ArgumentParser()
        parser.set_defaults(run=run)
        return parser

    return run_command(parser_of, [])


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "memory does not suffice: use smaller images"),
        (RecursionError("maximum"), "nested too deeply"),
        (OSError(28, "No space left on device"), "No space left on device"),
        (OSError(28, "No space left on device", "a.ply"), "a.ply: No space left on device"),
        (UnicodeDecodeError("utf-8", b"x", 0, 1, "bad"), None),
    ],
)
def test_failures_of_the_system_are_one_sentence(error, said, capsys):
    if said is None:  # a bug of ours is shown as one
        with pytest.raises(UnicodeDecodeError):
            status_of(error)
        return
    assert status_of(error) == EXIT_INPUT
    told = capsys.readouterr().err
    assert told.startswith("gsut: error: ")
    assert said in told
    assert told.count("\n") == 1


def test_output_that_nobody_reads_ends_quietly():
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*GSUT, "camera", "find", "gopro"], stdout=writer, stderr=subprocess.PIPE, env=ENVIRONMENT,
        check=False,
    )  # fmt: skip
    os.close(writer)
    assert (done.returncode, done.stderr) == (EXIT_PIPE, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_output_onto_a_full_disk_is_told():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*GSUT, "camera", "find", "gopro"], stdout=full, stderr=subprocess.PIPE,
            env=ENVIRONMENT, check=False,
        )  # fmt: skip
    assert done.returncode == EXIT_INPUT
    assert done.stderr == b"gsut: error: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_error_that_cannot_be_told_keeps_its_status(monkeypatch):
    with open("/dev/full", "w") as full:
        monkeypatch.setattr("sys.stderr", full)
        assert main(["doctor", "nowhere"]) == EXIT_INPUT
        with contextlib.suppress(OSError):
            full.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_standard_error_on_a_full_disk_ends_no_command(monkeypatch, tmp_path, capsys):
    with open("/dev/full", "w", buffering=1) as full:
        monkeypatch.setattr("sys.stderr", full)
        (tmp_path / "lens.json").write_text(
            '{"model": "pinhole", "width": 8, "height": 8, "params": [9, 9, 4, 4]}'
        )
        with monkeypatch.context() as patch:
            patch.setattr("gsut.cli._refuse_empty", lambda _: print("a", file=sys.stderr))
            status = main(["camera", "convert", str(tmp_path / "lens.json"), "opencv5"])
        assert (status, sys.stderr is full) == (0, False)  # which flushes nothing at the end
        with contextlib.suppress(OSError):
            full.close()


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(), OSError(errno.ENOMEM, "Cannot allocate memory"),
        cv2.error("(-4:Insufficient memory) Failed to allocate 9 bytes in OutOfMemoryError"),
        RuntimeError("can't start new thread"), RuntimeError("std::bad_alloc"),
    ],
)  # fmt: skip
def test_memory_that_is_short_is_said_alike_whoever_finds_it(error, monkeypatch, capsys):
    def fail(_):
        raise error

    monkeypatch.setattr("gsut.cli._refuse_empty", fail)
    assert main(["doctor", "data"]) == EXIT_INPUT
    assert capsys.readouterr().err.startswith("gsut: error: the memory does not suffice: use")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ImportError("cv2.so: failed to map segment\nIMPORTANT", path="cv2.so"), "cv2.so: failed"),
        (MemoryError(), "not enough memory"),
    ],
)
def test_what_cannot_be_imported_is_one_sentence(error, said, capsys):
    with pytest.raises(SystemExit) as ended:
        _starting._report_error(type(error), error, None)
    assert ended.value.code == EXIT_INPUT
    told = capsys.readouterr().err
    assert told.startswith("gsut: error: ") and said in told and told.count("\n") == 1
    if isinstance(error, ImportError):
        assert status_of(error) == EXIT_INPUT


@pytest.mark.parametrize(
    ("program", "given", "used"), [("gsut", None, "1"), ("gsut", "2", "2"), ("other", None, "None")]
)
def test_commands_add_up_alike_on_any_number_of_processors(program, given, used):
    code = "import os, sys; del sys.argv[0]; import gsut; print(os.environ.get(sys.argv[1]))"
    environment = {name: value for name, value in os.environ.items() if name != _BLAS}
    done = subprocess.run(
        [sys.executable, "-c", code, program, _BLAS], capture_output=True, text=True, check=True,
        env=environment | ({} if given is None else {_BLAS: given}),
    )  # fmt: skip
    assert done.stdout.strip() == used


def test_name_that_the_terminal_cannot_show_is_shown_escaped(tmp_path):
    name = os.fsdecode(b"caf\xe9-\xff.ply")
    done = subprocess.run(
        [*GSUT, "convert", str(tmp_path / name), str(tmp_path / "out.ply")], capture_output=True,
        env=ENVIRONMENT | {"PYTHONIOENCODING": "ascii"}, check=False,
    )  # fmt: skip
    assert done.returncode == EXIT_INPUT
    assert done.stderr.startswith(b"gsut: error: ")
    assert b"Traceback" not in done.stderr


def test_every_writer_on_a_full_disk_fails_and_names_the_file(tmp_path, rng):
    ply, lens = tmp_path / "in.ply", tmp_path / "in.yaml"
    gsut.formats.save_ply(ply, plain_scene(rng, 200, 16))
    gsut.save_camera(gsut.Camera("kannala_brandt", [99, 99, 64, 48, 0.1, 0, 0, 0], 128, 96), lens)
    small_datasets.write_nerfstudio(tmp_path / "plane")
    (tmp_path / "out").mkdir()
    scenes = ("a.ply", "b.compressed.ply", "c.spz", "d.sog", "e.glb", "f.splat")
    films = ("h.mp4", "i.webm", "j.gif", "folder")
    size = ["--frames", "2", "--size", "128x96"]
    asked = [
        *(["convert", str(ply), name] for name in scenes),
        *(["render", str(ply), *size, "-o", name] for name in films),
        ["edit", str(ply), "-o", "k.ply", "--scale", "2"],
        ["compact", str(ply), "-o", "l.ply", "--keep", "0.5"],
        ["camera", "convert", str(lens), "kannala_brandt", "-o", "m.json"],
        ["data", "convert", str(tmp_path / "plane"), "data"],
        ["train", str(tmp_path), "-o", "run"],
    ]
    done = subprocess.run(
        [sys.executable, "-c", ON_FULL_DISK], input=json.dumps(asked), capture_output=True,
        env=ENVIRONMENT, check=True, text=True, cwd=tmp_path / "out",
    )  # fmt: skip
    told = json.loads(done.stdout)
    for words, (status, said) in zip(asked, told, strict=True):
        name = {"edit": "k.ply", "compact": "l.ply"}.get(words[0], words[-1])
        assert status == EXIT_INPUT and "error: " in said and name in said, (words, said)
    left = [p for p in (tmp_path / "out").rglob("*") if p.is_file()]
    assert left == []


def test_closed_output_is_no_fault(monkeypatch):
    monkeypatch.setattr("sys.stdout", None)
    monkeypatch.setattr("sys.stderr", None)
    assert main(["camera", "find", "gopro"]) == 0
    assert main(["doctor", "nowhere"]) == EXIT_INPUT


def test_current_folder_that_is_gone_is_said(tmp_path, monkeypatch, capsys):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main(["train", str(tmp_path), "-o", "out"]) == EXIT_INPUT
    assert "the current folder is not there any more" in capsys.readouterr().err


def test_unknown_instruction_set_is_told_in_a_sentence():
    done = subprocess.run(
        [sys.executable, "-m", "gsut", "--version"], env=ENVIRONMENT | {"GSUT_ISA": "bogus"},
        capture_output=True, check=False, text=True,
    )  # fmt: skip
    assert done.returncode == EXIT_INPUT
    assert re.fullmatch(r'gsut: error: instruction set "bogus" \(GSUT_ISA\) .*\n', done.stderr)
