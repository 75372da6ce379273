"""Commands run where names of one platform do not exist, as on macOS and Windows."""

import os
import subprocess
import sys
import types

import pytest

import gsut
from gsut import files, output_folder, system
from small_videos import walk_past

# What macOS lacks of Linux, and Windows of both. `os.name` stays, because the standard library
# chooses by it.
MISSING_NAMES = {
    "os": (
        *("sched_getaffinity", "sched_setaffinity", "fork", "getuid", "geteuid", "chown"),
        *("mkfifo", "killpg", "setsid", "getloadavg", "sysconf", "statvfs", "posix_fallocate"),
    ),
    "signal": ("SIGKILL", "SIGHUP", "SIGUSR1", "SIGALRM", "alarm", "pthread_sigmask"),
}
MISSING_MODULES = ("resource", "pwd", "grp", "termios")
STRANGER = f"""
import builtins, os, signal, sys
for module, names in {MISSING_NAMES!r}.items():
    for name in names:
        if hasattr(sys.modules[module], name):
            delattr(sys.modules[module], name)
for name in {MISSING_MODULES!r}:
    sys.modules[name] = None
true_open = builtins.open
def open_without_proc(file, *args, **kwargs):
    if isinstance(file, (str, os.PathLike)) and os.fspath(file).startswith(("/proc", "/sys")):
        raise FileNotFoundError(2, "no such file", os.fspath(file))
    return true_open(file, *args, **kwargs)
builtins.open = open_without_proc
import io
io.open = open_without_proc
from gsut.cli import main
for command in sys.argv[1:]:
    status = main(command.split())
    print("ended", status, command, flush=True)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A film and its lens."""
    folder = tmp_path_factory.mktemp("platform")
    walk_past(folder / "walk.mp4")
    camera = gsut.Camera("pinhole", [300.0, 300.0, 160.0, 120.0], 320, 240)
    gsut.save_camera(camera, folder / "lens.yaml")
    return folder


COMMANDS = (  # each uses what those before it made
    "poses walk.mp4 -o posed --camera lens.yaml --frames 6",
    "scene walk.mp4 -o scene --camera lens.yaml --frames 6 --preset fast --steps 20",
    "train posed -o run --steps 10 --max-gaussians 500",
    "eval run",
    "render run -o renders",
    "doctor posed",
    "compact run -o small --keep 0.5",
    "convert run run.splat",
)


@pytest.mark.slow
def test_commands_run_without_names_of_one_platform(folder):
    done = subprocess.run(
        [sys.executable, "-c", STRANGER, *COMMANDS],
        capture_output=True, text=True, cwd=folder, check=False,
    )  # fmt: skip
    ended = [line for line in done.stdout.splitlines() if line.startswith("ended")]
    assert ended == [f"ended 0 {command}" for command in COMMANDS], done.stderr
    assert "Traceback" not in done.stderr, done.stderr


def test_output_folder_is_locked_where_there_is_no_fcntl(monkeypatch, tmp_path):
    held: set[int] = set()

    def locking(descriptor: int, mode: int, count: int) -> None:
        assert (mode, count) == (2, 1)
        if held:
            raise PermissionError(13, "Permission denied")
        held.add(descriptor)

    monkeypatch.setattr(output_folder, "fcntl", None)
    monkeypatch.setattr(
        output_folder, "msvcrt", types.SimpleNamespace(locking=locking, LK_NBLCK=2), raising=False
    )
    with output_folder.claim_folder(tmp_path / "run", "train", None) as claim:
        assert len(held) == 1
        marker = claim.path / output_folder.MARKER
        assert marker.read_text(encoding="utf-8").startswith("{")
        monkeypatch.setattr(output_folder, "_claims", {})  # as another process has it
        with pytest.raises(gsut.InputError, match="another gsut is writing"):
            output_folder.claim_folder(tmp_path / "run", "train", None)


def test_files_appear_on_windows_once_the_scanner_has_let_go(monkeypatch, tmp_path):
    refusals = iter([PermissionError(13, "in use")] * 2)
    replace = os.replace

    def refuse_twice(source, target):
        for refusal in refusals:
            raise refusal
        replace(source, target)

    monkeypatch.setattr(system, "_IS_WINDOWS", True)
    monkeypatch.setattr(os, "replace", refuse_twice)
    files.write_file(tmp_path / "a.txt", b"new")
    assert (tmp_path / "a.txt").read_bytes() == b"new"
    (tmp_path / "out").mkdir()  # empty, which Windows renames nothing over
    monkeypatch.setattr(os, "replace", lambda a, b: (os.rename(a, b), b.exists())[1])
    with files.whole_folder(tmp_path / "out") as folder:
        (folder / "b.txt").write_text("b")
    assert (tmp_path / "out/b.txt").read_text() == "b"


def test_commands_to_type_are_quoted_for_the_shell_of_the_system(monkeypatch):
    words = ["gsut", "view", "my run"]
    assert system.format_command(words) == "gsut view 'my run'"
    monkeypatch.setattr(system, "_IS_WINDOWS", True)
    assert system.format_command(words) == 'gsut view "my run"'
