"""Turns options dataclasses into command-line flags."""

from __future__ import annotations

import argparse
import functools
import typing
from typing import Any

from gsut.run.options.fields import (
    OptionInfo,
    describe_option,
    format_flag,
    get_info,
    has_flag,
    list_fields,
    strip_none,
)


def add_option_flags(parser: argparse.ArgumentParser, *classes: type) -> None:
    """Adds the flags of options dataclasses, grouped, with units and defaults.

    Fields that their class does not list in FLAGS are set in Python only. Options that are not
    given leave nothing in the namespace, so that `collect_given` distinguishes a given value from a
    default.
    """
    groups: dict[str, Any] = {}
    for options, field in ((each, field) for each in classes for field in list_fields(each)):
        info, kind = get_info(field), strip_none(_find_kinds(options)[field.name])
        words = describe_option(field).replace("%", "%%")
        if not has_flag(options, field.name):
            continue
        if info.group not in groups:
            groups[info.group] = parser.add_argument_group(info.group)
        settings: dict[str, Any] = {"action": argparse.BooleanOptionalAction}
        if kind is not bool:
            read = functools.partial(_read, kind=kind, info=info)
            settings = {"type": read, "metavar": _write_metavar(kind, info)}
        groups[info.group].add_argument(
            format_flag(field.name), dest=field.name, default=argparse.SUPPRESS, help=words,
            **settings,
        )  # fmt: skip


def collect_given(options: type, namespace: argparse.Namespace) -> dict[str, Any]:
    """Returns the options that were given on the command line, by field name."""
    given = vars(namespace)
    return {f.name: given[f.name] for f in list_fields(options) if f.name in given}


_find_kinds = functools.cache(typing.get_type_hints)  # evaluates all fields of a class each time


def _write_metavar(kind: Any, info: OptionInfo) -> str:
    if info.choices:
        return "{" + ",".join(info.choices) + "}"
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        return "A,B,..." if entries[-1] is Ellipsis else ",".join("XYZW"[: len(entries)])
    return {int: "N", float: "X", str: "WORD"}[kind]


def _read(text: str, kind: Any, info: OptionInfo) -> Any:
    """Returns the value of a text.

    It checks nothing: text that is no number stays text, which `check_options` rejects with the
    same sentence that a wrong value gets in Python.
    """
    if text in info.words or info.choices:
        return text
    if typing.get_origin(kind) is tuple:
        entry = typing.get_args(kind)[0]
        return tuple(_read(part.strip(), entry, info) for part in text.split(",") if part)
    try:
        return kind(text)
    except ValueError:
        return text
