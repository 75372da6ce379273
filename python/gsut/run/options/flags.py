"""Turns options dataclasses into command-line flags and into names that --set takes."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import typing
from collections.abc import Callable, Sequence
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

    Fields that their class does not list in FLAGS get no flag of their own: `--set NAME=VALUE`
    sets them, and `--help-all` lists them; those of UNLISTED_FLAGS have a flag, too. Options that
    are not given leave nothing in the namespace, so that `collect_given` distinguishes a given
    value from a default.
    """
    groups: dict[str, Any] = {}
    others = []
    for options, field in ((each, field) for each in classes for field in list_fields(each)):
        if not has_flag(options, field.name):
            others.append((options, field))
            continue
        info, kind = get_info(field), _find_kind(options, field)
        if info.group not in groups:
            groups[info.group] = parser.add_argument_group(info.group)
        settings: dict[str, Any] = {"default": argparse.SUPPRESS, "help": _write_help(field)}
        if kind is bool:
            settings["action"] = argparse.BooleanOptionalAction
        else:
            settings |= {"type": _make_reader(kind, info), "metavar": _write_metavar(kind, info)}
        groups[info.group].add_argument(format_flag(field.name), dest=field.name, **settings)
    if others:
        action = _find_set(parser)
        for options in classes:
            for field in list_fields(options):
                kind, info = _find_kind(options, field), get_info(field)
                action.readers[field.name] = _make_reader(kind, info)
                if (options, field) in others:
                    action.listed.append(
                        (info.group, field.name, _write_metavar(kind, info), _write_help(field))
                    )
                if field.name in getattr(options, "UNLISTED_FLAGS", ()):
                    settings = {"type": _make_reader(kind, info), "default": argparse.SUPPRESS}
                    flag = format_flag(field.name)
                    parser.add_argument(flag, help=argparse.SUPPRESS, **settings)


def add_rare_option(
    parser: argparse.ArgumentParser,
    name: str,
    read: Callable[[str], Any] | Sequence[str],
    default: Any,
    *,
    metavar: str = "X",
    help: str,
) -> None:
    """Adds an option that few people set: `--set NAME=VALUE` sets it, `--help-all` lists it.

    Args:
        parser: of a command, with all its flags.
        name: in the namespace, too.
        read: makes the value of its text, and raises ArgumentTypeError; or the words to choose
            from; `bool` takes true and false.
        default: where it is not given.
        metavar: of the value. help: a sentence with the default.
    """
    if isinstance(read, Sequence):
        metavar, read = "{" + ",".join(read) + "}", functools.partial(_read_word, words=read)
    elif read is bool:
        metavar, read = "{true,false}", _read_truth
    action = _find_set(parser)
    action.readers[name] = read
    action.listed.append(("Other options", name, metavar, help))
    parser.set_defaults(**{name: default})


_SET = "_set_option"  # of a parser: its --set


def _find_set(parser: argparse.ArgumentParser) -> _SetOption:
    """Returns the --set of a parser, which gets it with --help-all where it has none."""
    if (action := parser.get_default(_SET)) is None:
        group = parser.add_argument_group("Other options")
        action = group.add_argument(
            "--set", action=_SetOption, metavar="NAME=VALUE", default=argparse.SUPPRESS,
            help="set any other option; --help-all lists them; may be given several times",
        )  # fmt: skip
        group.add_argument(
            "--help-all", action=_HelpAll, nargs=0, default=argparse.SUPPRESS,
            help="show every option, also those of --set, and exit",
        )  # fmt: skip
        parser.set_defaults(**{_SET: action})
    return action


def show_every_option(parser: argparse.ArgumentParser) -> None:
    """Lets the parser's help list the options that only --set reaches.

    They are listed as positional arguments, which makes the parser useless for parsing.
    """
    parser.usage = parser.format_usage().removeprefix("usage: ").rstrip().replace("%", "%%")
    groups: dict[str, Any] = {}
    action = parser.get_default(_SET)
    for group, name, metavar, words in () if action is None else action.listed:
        if group not in groups:
            groups[group] = parser.add_argument_group(f"{group}, by --set NAME=VALUE")
        groups[group].add_argument(name, metavar=f"{name}={metavar}", help=words)


def collect_given(options: type, namespace: argparse.Namespace) -> dict[str, Any]:
    """Returns the options that were given on the command line, by field name."""
    given = vars(namespace)
    return {f.name: given[f.name] for f in list_fields(options) if f.name in given}


class _HelpAll(argparse.Action):
    """`--help-all`."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        show_every_option(parser)
        parser.print_help()
        parser.exit()


class _SetOption(argparse.Action):
    """`--set NAME=VALUE`: puts the value where the option's own flag would put it.

    Attributes:
        readers: of each option that it takes, what makes a value of a text.
        listed: (group, name, metavar, help) of the options that have no flag.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.readers: dict[str, Callable[[str], Any]] = {}
        self.listed: list[tuple[str, str, str, str]] = []

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any
    ) -> None:
        name, equals, text = values.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            raise InputError(f"--set takes NAME=VALUE, such as {next(iter(self.readers))}=..., "
                             f"found {values!r}")  # fmt: skip
        if name not in self.readers:
            raise InputError(f"--set {name}: no such option; {parser.prog} --help-all lists them")
        try:
            setattr(namespace, name, self.readers[name](text.strip()))
        except argparse.ArgumentTypeError as error:
            raise InputError(f"--set {name} {error}") from None


_find_kinds = functools.cache(typing.get_type_hints)  # evaluates all fields of a class each time


def _find_kind(options: type, field: dataclasses.Field) -> Any:
    return strip_none(_find_kinds(options)[field.name])


def _write_help(field: dataclasses.Field) -> str:
    return describe_option(field).replace("%", "%%")


def _write_metavar(kind: Any, info: OptionInfo) -> str:
    if info.choices:
        return "{" + ",".join(info.choices) + "}"
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        return "A,B,..." if entries[-1] is Ellipsis else ",".join("XYZW"[: len(entries)])
    return {int: "N", float: "X", str: "WORD", bool: "{true,false}"}[kind]


def _make_reader(kind: Any, info: OptionInfo) -> Any:
    """Returns the function that turns the text of a flag into a value.

    It checks nothing: text that is no number stays text, which `check_options` rejects with the
    same sentence that a wrong value gets in Python.
    """

    def read(text: str) -> Any:
        if text in info.words or info.choices:
            return text
        if typing.get_origin(kind) is tuple:
            entry = typing.get_args(kind)[0]
            return tuple(_parse_text(part.strip(), entry) for part in text.split(",") if part)
        return _parse_text(text, kind)

    return read


def _read_word(text: str, words: Sequence[str]) -> str:
    if text not in words:
        raise argparse.ArgumentTypeError(f"takes {', '.join(words)}, found {text[:80]!r}")
    return text


def _read_truth(text: str) -> bool:
    if text.lower() not in _TRUTH:
        raise argparse.ArgumentTypeError(f"takes true or false, found {text[:80]!r}")
    return _TRUTH[text.lower()]


def _parse_text(text: str, kind: Any) -> Any:
    """Returns text as a value of this type, or the text itself if it is none."""
    if kind is bool:
        return _TRUTH.get(text.lower(), text)
    try:
        return kind(text) if kind in (int, float) else text
    except ValueError:
        return text
