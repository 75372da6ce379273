"""Turns options dataclasses into command-line flags and into names that --set takes."""

from __future__ import annotations

import argparse
import functools
import typing
from collections.abc import Callable
from typing import Any

from gsut._core import InputError
from gsut.run.options.fields import (
    OptionInfo,
    describe_option,
    format_flag,
    get_info,
    has_flag,
    list_fields,
    strip_none,
)

_TRUTH = {"true": True, "on": True, "yes": True, "false": False, "off": False, "no": False}


def add_option_flags(parser: argparse.ArgumentParser, *classes: type) -> None:
    """Adds the flags of options dataclasses, grouped, with units and defaults.

    Fields that their class does not list in FLAGS are set by `--set NAME=VALUE`. Options that are
    not given leave nothing in the namespace, so that `collect_given` distinguishes a given value
    from a default.
    """
    groups: dict[str, Any] = {}
    others = []
    for options, field in ((each, field) for each in classes for field in list_fields(each)):
        info, kind = get_info(field), strip_none(_find_kinds(options)[field.name])
        words = describe_option(field).replace("%", "%%")
        read, metavar = functools.partial(_read, kind=kind, info=info), _write_metavar(kind, info)
        if not has_flag(options, field.name):
            others.append((field.name, read, metavar, words))
            continue
        if info.group not in groups:
            groups[info.group] = parser.add_argument_group(info.group)
        settings: dict[str, Any] = {"type": read, "metavar": metavar}
        if kind is bool:
            settings = {"action": argparse.BooleanOptionalAction}
        groups[info.group].add_argument(
            format_flag(field.name), dest=field.name, default=argparse.SUPPRESS, help=words,
            **settings,
        )  # fmt: skip
    if others:
        group = parser.add_argument_group("Other options, by --set NAME=VALUE")
        action: Any = group.add_argument(
            "--set", action=_SetOption, group=group, metavar="NAME=VALUE",
            default=argparse.SUPPRESS, help="set one of these; may be given several times",
        )  # fmt: skip
        for other in others:
            action.add(*other)


def collect_given(options: type, namespace: argparse.Namespace) -> dict[str, Any]:
    """Returns the options that were given on the command line, by field name."""
    given = vars(namespace)
    return {f.name: given[f.name] for f in list_fields(options) if f.name in given}


class _SetOption(argparse.Action):
    """`--set NAME=VALUE`: puts the value where a flag of the option's own would put it."""

    def __init__(self, *, group: Any, **settings: Any) -> None:
        super().__init__(**settings)
        self._group = group
        self._readers: dict[str, Callable[[str], Any]] = {}

    def add(self, name: str, read: Callable[[str], Any], metavar: str, words: str) -> None:
        """Accepts an option, and lists it in the help of the group, which is all that rows of a
        group do."""
        self._readers[name] = read
        row = argparse.Action([], name, metavar=f"{name}={metavar}", help=words)
        self._group._group_actions.append(row)

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any
    ) -> None:
        name, equals, text = values.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            raise InputError(f"--set takes NAME=VALUE, such as {next(iter(self._readers))}=..., "
                             f"found {values!r}")  # fmt: skip
        if name not in self._readers:
            own, known = format_flag(name), ", ".join(self._readers)
            has_own = own in parser._option_string_actions
            hint = f"use {own}" if has_own else f"no such option; known are {known}"
            raise InputError(f"--set {name}: {hint}")
        setattr(namespace, name, self._readers[name](text.strip()))


_find_kinds = functools.cache(typing.get_type_hints)  # evaluates all fields of a class each time


def _write_metavar(kind: Any, info: OptionInfo) -> str:
    if info.choices:
        return "{" + ",".join(info.choices) + "}"
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        return "A,B,..." if entries[-1] is Ellipsis else ",".join("XYZW"[: len(entries)])
    return {int: "N", float: "X", str: "WORD", bool: "{true,false}"}[kind]


def _read(text: str, kind: Any, info: OptionInfo) -> Any:
    """Returns the value of a text.

    It checks nothing: text that is no number stays text, which `check_options` rejects with the
    same sentence that a wrong value gets in Python.
    """
    if text in info.words or info.choices:
        return text
    if kind is bool:
        return _TRUTH.get(text.lower(), text)
    if typing.get_origin(kind) is tuple:
        entry = typing.get_args(kind)[0]
        return tuple(_read(part.strip(), entry, info) for part in text.split(",") if part)
    try:
        return kind(text)
    except ValueError:
        return text
