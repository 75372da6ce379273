"""The script `run` on a pretended bare machine: what it installs, as whom, and what it says."""

import os
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = (
    *("demo", "test", "setup", "build", "bench", "docs", "wheel", "lint"),
    "help",
)
# What a bare Debian has that `run` calls before the compiler is there.
BARE = (
    "awk",
    "bash",
    "cat",
    "cmp",
    "cut",
    "dirname",
    "env",
    "find",
    "grep",
    "head",
    "mkdir",
    "mv",
    "nproc",
)
BARE += ("rm", "sed", "sha256sum", "sort", "tail", "tee", "tr", "wc")
TOOLS = ("c++", "cmake", "ninja")
LIBRARIES = ("libeigen3-dev", "libceres-dev", "libtbb-dev", "libhwy-dev", "libgtest-dev")

pytestmark = pytest.mark.skipif(not shutil.which("bash"), reason="needs bash")


class Machine:
    """A clone in a folder with a space, and a PATH that holds only what is put there."""

    def __init__(self, folder: Path) -> None:
        self.clone = folder / "my clone"
        self.bin = folder / "bin"
        self.calls = folder / "calls.txt"
        (self.clone / ".ci").mkdir(parents=True)
        self.bin.mkdir()
        for name in ("run", ".ci/run", "pyproject.toml"):
            shutil.copy(ROOT / name, self.clone / name)
        for name in BARE:
            if found := shutil.which(name):
                (self.bin / name).symlink_to(found)
        self.command("dpkg-query", 'grep -qx "${@: -1}" "$0.installed" && printf installed')
        self.command("apt-get", f'echo "apt-get $*" >>"{self.calls}"')
        self.installed()

    def command(self, name: str, body: str) -> None:
        path = self.bin / name
        path.write_text(f"#!{shutil.which('bash')}\n{body}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    def installed(self, *packages: str) -> None:
        (self.bin / "dpkg-query.installed").write_text("".join(f"{p}\n" for p in packages))

    def user(self, number: int) -> None:
        self.command("id", f"echo {number}")

    def python(self) -> None:
        """A Python that serves but can make no virtual environment, so that `run` ends there."""
        self.command("python3", '[[ "$1" == - ]] || { echo "venv asked for" >&2; exit 3; }')

    def run(self, *arguments: str, script: str = "run") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["bash", str(self.clone / script), *arguments],
            # Without GSUT_PYTHON the Python of /usr/bin would be found by its full path.
            env={"PATH": str(self.bin), "CI": "true", "GSUT_PYTHON": "python3"},
            cwd=self.bin,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )

    def apt_calls(self) -> list[str]:
        return self.calls.read_text().splitlines() if self.calls.exists() else []


@pytest.fixture
def machine(tmp_path) -> Machine:
    return Machine(tmp_path)


def test_run_help_lists_every_command(machine):
    for arguments in ((), ("help",), ("--help",)):
        done = machine.run(*arguments)
        assert done.returncode == 0
        assert [name for name in COMMANDS if f"\n  {name} " not in done.stdout] == []


def test_run_unknown_command_fails_with_the_list(machine):
    done = machine.run("tset")
    assert done.returncode == 1
    assert "no such command: tset" in done.stderr
    assert "  test " in done.stderr


def test_setup_without_root_and_sudo_says_what_to_type(machine):
    machine.user(1000)
    machine.installed("libeigen3-dev")
    done = machine.run("setup")
    assert done.returncode == 1
    assert (
        "  sudo apt-get install --no-install-recommends build-essential cmake ninja-build "
        "libceres-dev libtbb-dev libhwy-dev libgtest-dev python3 python3-venv python3-dev\n"
    ) in done.stderr
    assert machine.apt_calls() == []


def test_setup_as_root_installs_only_what_is_missing(machine):
    machine.user(0)
    machine.python()
    machine.installed(*LIBRARIES[:-1])
    machine.command("c++", "exit 1")
    machine.run("setup")
    update, install = machine.apt_calls()
    assert update.endswith(" update")
    packages = "cmake ninja-build libgtest-dev"
    assert install.endswith(f" install -y --no-install-recommends {packages}")


def test_setup_with_nothing_missing_leaves_apt_alone(machine):
    machine.user(1000)
    machine.python()
    machine.installed(*LIBRARIES)
    for name in TOOLS:
        machine.command(name, "exit 1")
    done = machine.run("setup")
    assert done.returncode != 0
    assert "venv asked for" in done.stderr  # it came to the step after the system packages
    assert machine.apt_calls() == []


def test_setup_with_sudo_never_waits_for_a_password_in_ci(machine):
    machine.user(1000)
    machine.python()
    machine.command("sudo", f'echo "sudo $*" >>"{machine.calls}"; [[ "$1" == -n ]] && "${{@:2}}"')
    machine.command("true", "exit 0")
    machine.run("setup")
    calls = [call for call in machine.apt_calls() if call.startswith("sudo")]
    assert len(calls) == 3  # may I; update; install
    assert all(call.startswith("sudo -n ") for call in calls)
    assert all("DEBIAN_FRONTEND=noninteractive" in call for call in calls[1:])


def test_setup_without_python_says_how_to_name_one(machine):
    machine.user(0)
    done = machine.run("setup")  # this apt-get installs nothing
    assert done.returncode == 1
    assert "GSUT_PYTHON=" in done.stderr


def test_ci_runs_the_command_that_people_type(machine):
    (machine.clone / "run").write_text('echo "run $*"\n')
    (machine.clone / "run").chmod(0o755)
    done = machine.run(script=".ci/run")
    assert done.stdout == "run test\n"
    assert os.access(ROOT / "run", os.X_OK)
