"""Gives every flag that takes numbers the numbers that it cannot mean."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator

from gsut.cli import build_parser
from gsut.cli._flags import Number
from lab.attack.harness import Case

# Command -> what it is given beside the flag, and what that needs.
BASES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "calibrate": (
        ("boards", "--board", "5x4", "--spacing", "0.05", "-o", "out.yaml"), ("boards",)
    ),
    "camera convert": (("lenses/opencv.yaml", "kannala_brandt"), ("lenses/opencv.yaml",)),
    "camera find": (("hero9",), ()),
    "compact": (("scenes/a.ply", "-o", "out.ply", "--keep", "0.5"), ("scenes/a.ply",)),
    "convert": (("scenes/a.ply", "out.ply"), ("scenes/a.ply",)),
    "data convert": (("plane", "out"), ("plane",)),
    "demo": (("--no-open", "-o", "out", "--steps", "1"), ()),
    "edit": (("scenes/a.ply", "-o", "out.ply"), ("scenes/a.ply",)),
    "eval": (("run",), ("ds", "run")),
    "measure": (
        ("scenes/a.ply", "--point", "0", "0", "0", "--point", "1", "0", "0"), ("scenes/a.ply",)
    ),
    "mesh": (("run", "-o", "out.ply"), ("ds", "run")),
    "poses": (
        ("film.mp4", "-o", "out", "--camera", "lens320.json", "--quiet"),
        ("film.mp4", "lens320.json"),
    ),
    "render": (
        ("scenes/a.ply", "-o", "out", "--frames", "1", "--size", "16x16"), ("scenes/a.ply",)
    ),
    "scene": (("film.mp4", "-o", "out", "--quiet"), ("film.mp4",)),
    "train": (("ds", "-o", "out", "--steps", "2", "--quiet"), ("ds",)),
}  # fmt: skip
NO_NUMBERS = ("nan", "inf", "-inf", "x", "", "1,2;3", "1e999")
MANY = "9" * 25
ODD = ("-1", "0", "1e300", MANY)  # of few flags a number in a good sense: these
COORDINATES = ("-1", "0", MANY)
GOOD: dict[tuple[str, str], tuple[str, ...]] = {
    ("edit", "--up"): COORDINATES,  # its direction counts
    ("measure", "--point"): COORDINATES,
    ("measure", "--length"): (MANY,),  # of what was measured, in any unit
    # Nothing of it, none left out, all or a number found by gsut, as their help says.
    **{
        (command, flag): ("0",)
        for command, flags in {
            "compact": ("--finetune",),
            "edit": ("--min-opacity",),
            "mesh": ("--holes", "--support"),
            "poses": ("--nadir-cap", "--threads", "--seed"),
            "scene": ("--nadir-cap",),
            "train": ("--seed", "--threads", "--max-side", "--test-every", "--sh-degree"),
        }.items() for flag in flags
    },
}  # fmt: skip
# What is wrong before the number is looked at.
SOONER = {
    ("demo", "--rig"): "unrecognized arguments: -inf",  # its number may be left out
}
LONG = ("calibrate", "demo", "scene")  # with a number in a good sense these take their time


def list_flag_cases() -> Iterator[Case]:
    """Lists every flag that takes numbers, with each number that it cannot mean."""
    for command, (base, needs) in BASES.items():
        for action in find_numeric_flags(command):
            flag = action.option_strings[-1]
            count = action.nargs if isinstance(action.nargs, int) else 1
            for value in NO_NUMBERS + (() if command in LONG else ODD):
                words = (*command.split(), *_drop_flag(base, flag, count), f"{flag}")
                given = [value] + ["1"] * (count - 1)
                names = ["[-_ ]".join(map(re.escape, flag.strip("-").split("-")))]
                names += [re.escape(action.dest), *filter(None, [SOONER.get((command, flag))])]
                yield Case(
                    "flag", f"{flag} {value!r}", (*words, *given), needs,
                    said=("|".join(names),), may_pass=value in GOOD.get((command, flag), ()),
                    keeps=("out",),
                )  # fmt: skip


def find_numeric_flags(command: str) -> list[argparse.Action]:
    name, *inner = command.split()
    parser = _find_command(build_parser([name]), name)
    for each in inner:
        parser = _find_command(parser, each)
    return [
        action for action in parser._actions
        if action.option_strings and action.nargs != 0
        and (action.type is int or isinstance(action.type, Number) or action.metavar in ("N", "X"))
    ]  # fmt: skip


def _find_command(parser: argparse.ArgumentParser, name: str) -> argparse.ArgumentParser:
    commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return commands.choices[name]


def _drop_flag(base: tuple[str, ...], flag: str, count: int) -> tuple[str, ...]:
    """Drops a flag, which is given otherwise, from the base's words."""
    if flag not in base:
        return base
    at = base.index(flag)
    return base[:at] + base[at + 1 + count :]
