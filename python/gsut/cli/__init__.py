"""The command line: finds the commands, one file each in this folder, and runs one.

A command is a module NAME.py with HELP (its line in `gsut --help`), DESCRIPTION, add_flags(parser)
and run(arguments) -> exit status; the files whose names begin with "_" are none. What takes long
to import is imported by `run`, so that `--help` and a wrong argument answer at once.
"""

from __future__ import annotations

import argparse
import ast
import errno
import importlib
import io
import itertools
import os
import pkgutil
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from gsut import _core, _starting
from gsut.terminal import TerminalStream, say

EXIT_INPUT = 2  # wrong arguments or data: one sentence says which
EXIT_INTERRUPTED = _starting.EXIT_INTERRUPTED
EXIT_PIPE = 141  # as shells report a reader of the output that has gone
DEBUG_VARIABLE = "GSUT_DEBUG"
# What libraries say, each by an error of its own, where memory is short.
_NO_MEMORY = ("Insufficient memory", "bad_alloc", "can't start new thread", "out of memory")
_STOPPED = "interrupted; no file was left half-written, and the same command starts again"


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one sentence, like all others.

    Flags cannot be shortened: a new flag would change what an old command line means.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def raise_error(self, message: str) -> NoReturn:
        raise _core.InputError(f"{message} (see {self.prog} --help)")

    error = raise_error  # the name that argparse calls

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parses all words; what none of the command's flags takes points to the command's help."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if unknown:
            raise _core.InputError(
                f"unrecognized arguments: {' '.join(unknown)} (see {parsed.command} --help)"
            )
        return parsed

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parses words; `command` of the result is the innermost command that was named."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if not hasattr(parsed, "command"):
            parsed.command = self.prog
        return parsed, unknown


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command; returns its exit status (see `run_command`)."""
    names = list_commands()

    def make_parser(words: Sequence[str]) -> argparse.ArgumentParser:
        chosen = next((word for word in words if not word.startswith("-")), "")
        known = chosen in names
        return build_parser([chosen] if known else names, with_flags=known)

    return run_command(make_parser, arguments)


def run_command(
    make_parser: Callable[[Sequence[str]], argparse.ArgumentParser],
    arguments: Sequence[str] | None = None,
) -> int:
    """Parses, and calls `run` of what was parsed.

    Args:
        make_parser: makes the parser for these words.
        arguments: the words after the program's name; those of the process if None.

    Returns:
        0; 2 after wrong input, or if something cannot be read or written, reported in one sentence
        on standard error (with GSUT_DEBUG=1 the traceback too); 130 after Ctrl-C; 141 where nobody
        reads the output any more.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    warnings.showwarning = _show_warning
    for name in ("stdout", "stderr"):  # closed before the command began
        if getattr(sys, name) is None:
            setattr(sys, name, io.StringIO())
    given = sys.stdout, sys.stderr
    for stream in given:  # a name that the terminal cannot show is shown escaped
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    lenient = TerminalStream(sys.stderr, lenient=True)  # a full disk there ends no command
    sys.stdout, sys.stderr = TerminalStream(sys.stdout), lenient
    try:
        try:
            _refuse_empty(words)
            parsed = make_parser(words).parse_args(words)
            _starting.finish_start()
            return parsed.run(parsed)
        finally:
            sys.stdout.flush()  # here its failure can be reported
    except KeyboardInterrupt as interrupt:
        say(str(interrupt) or _STOPPED, before="\n")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        _drop_output()
        return EXIT_PIPE
    except Exception as error:
        sentence = _describe_error(error)
        if sentence is None:  # a bug of ours is shown as one
            raise
        return _report(sentence)
    finally:
        sys.stdout, sys.stderr = given
        if lenient.failed:  # it is flushed at the end of the process
            sys.stderr = io.StringIO()


def _refuse_empty(words: Sequence[str]) -> None:
    """Raises InputError at an empty word: as a path it would mean the current folder."""
    for before, word in itertools.pairwise(("gsut", *words)):
        if not word:
            raise _core.InputError(
                f"after {before} the name is empty, or the value missing; is a variable of the "
                "shell not set?"
            )


def _describe_error(error: Exception) -> str | None:
    """Returns the sentence for an error that is not a bug; None for a bug."""
    if isinstance(error, (_core.InputError, _core.CalibrationError, _core.SolveError)):
        return str(error)
    if _is_memory_short(error):
        return (
            "the memory does not suffice: use smaller images (--max-side, --scale), fewer "
            "Gaussians or fewer images"
        )
    if isinstance(error, RecursionError):
        return "a file is nested too deeply to be read; is it what it should be?"
    if isinstance(error, OSError):
        _drop_output()  # it may be what failed
        if isinstance(error, FileNotFoundError) and error.filename is None:
            return "the current folder is not there any more; go to another"
        where = f"{error.filename}: " if error.filename is not None else ""
        return f"{where}{error.strerror or error}"
    if isinstance(error, ImportError) and error.path and not error.path.endswith(".py"):
        return f"a library cannot be loaded: {error}; is memory short, or the installation damaged?"
    if isinstance(error, RuntimeError) and "Symlink loop" in str(error):  # before Python 3.13
        return f"{str(error).split(' from ')[-1]}: a symbolic link that leads to itself"
    return None


def _is_memory_short(error: Exception) -> bool:
    """Returns whether memory is short, in the words of Python, of the system or of a library."""
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return True
    return any(words in str(error) for words in _NO_MEMORY)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    say(f"note: {message}")


def _drop_output() -> None:
    """Sends standard output nowhere from now on, so that flushing it at the end cannot fail."""
    stream = getattr(sys.stdout, "stream", sys.stdout)
    if stream is sys.__stdout__ and stream is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report(message: str) -> int:
    if os.environ.get(DEBUG_VARIABLE, "0") not in ("", "0"):
        traceback.print_exc()
    say(f"error: {' '.join(message.split())}")
    return EXIT_INPUT


def list_commands() -> list[str]:
    """Lists the commands: the modules of this folder."""
    found = (module.name for module in pkgutil.iter_modules(__path__))
    return sorted(name for name in found if not name.startswith("_"))


class _Version(argparse.Action):
    """Prints what a report of a fault should name: versions, compiler, instruction set."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        build = dict(_core.describe_build())
        print(f"gsut {build.pop('version')}")
        for name, value in build.items():
            print(f"{name}: {value.strip() or 'none'}")
        print(f"isa: {_core.active_isa()} (of {', '.join(_core.available_isas())})")
        import cv2
        import numpy as np

        from gsut.sfm.learned import describe_weights

        print(f"python: {sys.version.split()[0]}, numpy {np.__version__}, OpenCV {cv2.__version__}")
        print(f"learned features: {describe_weights()}")
        parser.exit()


def build_parser(
    names: Iterable[str] | None = None, with_flags: bool = True
) -> argparse.ArgumentParser:
    """Returns the parser of these commands, or of all; each sets `run`, its function.

    Args:
        names: of the commands.
        with_flags: False: commands have a name and a line of help only, and none is imported.
    """
    parser = Parser(
        prog="gsut",
        description="3D Gaussian splatting for any real lens, on any machine, without a GPU.",
        epilog="`gsut COMMAND --help` lists a command's options.",
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="print versions and build, and exit"
    )
    wanted = list_commands() if names is None else names
    if with_flags:
        add_commands(parser, {name: f"gsut.cli.{name}" for name in wanted}, "commands", "COMMAND")
    else:
        listed = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
        for name in wanted:
            listed.add_parser(name, help=_read_help(name))
    return parser


def _read_help(name: str) -> str:
    """Reads the HELP of a command from its source: importing them all takes longer than a list."""
    source = Path(__path__[0], f"{name}.py").read_text(encoding="utf-8")
    values = {
        target.id: line.value
        for line in ast.parse(source).body
        if isinstance(line, ast.Assign)
        for target in line.targets
        if isinstance(target, ast.Name)
    }
    return str(ast.literal_eval(values["HELP"]))


def add_commands(
    parser: argparse.ArgumentParser, modules: Mapping[str, str], title: str, metavar: str
) -> None:
    """Adds commands, each from its module, to a parser."""
    commands = parser.add_subparsers(title=title, metavar=metavar, required=True)
    for name, module in modules.items():
        command = importlib.import_module(module)
        description = getattr(command, "DESCRIPTION", command.HELP)
        added = commands.add_parser(name, help=command.HELP, description=description)
        added.set_defaults(run=getattr(command, "run", None))
        command.add_flags(added)
