"""Describes, checks and turns into command-line flags the fields of an options dataclass."""

from __future__ import annotations

import argparse
import dataclasses
import math
import operator
import pkgutil
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError

_UNITS = {"B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9}


MOST_WHOLE = 2**31 - 1  # of options without a limit of their own


@dataclasses.dataclass(frozen=True)
class OptionInfo:
    """What a field of an options dataclass may hold and what to say about it.

    Attributes:
        group: heading under which --help and the report list the option.
        help: what it does, in a few words.
        unit: unit of the value; empty for pure numbers.
        low, high: allowed range (of every entry of a tuple); None = no limit.
        low_open, high_open: the limit itself is not allowed.
        choices: allowed words.
        words: words allowed instead of a value.
        none: what None means; empty where None is not allowed.
        reason: why the default is what it is.
    """

    group: str
    help: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    high_open: bool = False
    choices: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    none: str = ""
    reason: str = ""

    def format_range(self) -> str:
        """The allowed range in words, as used in messages."""
        if self.low is None and self.high is None:
            return "any value"
        above = ">" if self.low_open else ">="
        below = "<" if self.high_open else "<="
        parts = [f"{above} {self.low:g}"] if self.low is not None else []
        parts += [f"{below} {self.high:g}"] if self.high is not None else []
        return " and ".join(parts)

    def holds(self, number: float) -> bool:
        """Whether a number lies in the range; NaN never does."""
        above = self.low is None or (number > self.low if self.low_open else number >= self.low)
        below = self.high is None or (number < self.high if self.high_open else number <= self.high)
        return bool(above and below and math.isfinite(number))


def option(default: Any, group: str, help: str, **info: Any) -> Any:
    """A dataclass field with its `OptionInfo` as metadata (see there for the arguments)."""
    return dataclasses.field(default=default, metadata={"option": OptionInfo(group, help, **info)})


def choices_in(folder: str, first: str) -> tuple[str, ...]:
    """Names of the modules in a folder of gsut, each a choice; nothing is imported.

    Args:
        folder: below the package. A dash in a choice is an underscore in its module's name.
        first: the default, which is listed before the others.
    """
    modules = pkgutil.iter_modules([str(Path(__file__).parents[1] / folder)])
    names = (module.name.replace("_", "-") for module in modules)
    return tuple(sorted(names, key=lambda name: (name != first, name)))


def option_info(field: dataclasses.Field) -> OptionInfo:
    """The `OptionInfo` that `option` has put into a field."""
    return field.metadata["option"]


def _described(options: Any) -> list[dataclasses.Field]:
    """The fields that `option` made; others are arguments of another kind."""
    return [field for field in dataclasses.fields(options) if "option" in field.metadata]


def flag_name(name: str) -> str:
    """The command line's name of an option: max_gaussians -> --max-gaussians."""
    return "--" + name.replace("_", "-")


def default_text(field: dataclasses.Field) -> str:
    """The default as the command line would take it, or what None stands for."""
    if field.default is None:
        return option_info(field).none
    if isinstance(field.default, bool):
        return "on" if field.default else "off"
    if isinstance(field.default, tuple):
        return ",".join(v if isinstance(v, str) else f"{v:g}" for v in field.default) or "none"
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default)


def words_of(options: Any, default: Any, but: Sequence[str] = ()) -> list[str]:
    """Words of the command line that make `options` of `default`, an object of the same class;
    nothing of the fields `but`."""
    words = []
    for field in _described(options):
        value = getattr(options, field.name)
        if value is None or value == getattr(default, field.name) or field.name in but:
            continue
        if isinstance(value, bool):
            words.append(flag_name(field.name if value else f"no_{field.name}"))
        else:
            values = value if isinstance(value, tuple) else (value,)
            words += [flag_name(field.name), ",".join(map(str, values))]
    return words


def describe_options(options: type) -> type:
    """Lists the fields of an options dataclass in its docstring, before what it raises."""
    doc, _, raises = (options.__doc__ or "").partition("    Raises:")
    rows = "".join(f"        {f.name}: {option_text(f)}.\n" for f in _described(options))
    options.__doc__ = f"{doc}    Args:\n{rows}\n    Raises:{raises}"
    return options


def option_text(field: dataclasses.Field) -> str:
    """What an option does, with its unit, default and reason."""
    info = option_info(field)
    notes = [info.unit, f"default {default_text(field)}", info.reason]
    return f"{info.help} [{'; '.join(note for note in notes if note)}]"


def check_options(options: Any) -> None:
    """Checks every field of an options dataclass and brings numbers to plain int and float.

    Raises:
        InputError: names the option, the value and what is allowed.
    """
    kinds = typing.get_type_hints(type(options))
    for field in _described(options):
        value = getattr(options, field.name)
        checked = _checked(flag_name(field.name), value, option_info(field), kinds[field.name])
        object.__setattr__(options, field.name, checked)


def _checked(flag: str, value: Any, info: OptionInfo, kind: Any) -> Any:
    """`value` as the plain type of `kind`, or InputError."""
    if value is None and info.none:
        return None
    if isinstance(value, str) and value in info.words:
        return value
    if info.choices:
        if value not in info.choices:
            raise InputError(f"{flag} must be one of {', '.join(info.choices)}, found {value!r}")
        return value
    plain = _plain_kind(kind)
    if typing.get_origin(plain) is tuple:
        entries = typing.get_args(plain)
        if not isinstance(value, (tuple, list)):
            raise InputError(f"{flag} must be {_kind_text(plain, info)}, found {value!r}")
        if entries[-1] is not Ellipsis and len(value) != len(entries):
            raise InputError(
                f"{flag} must be {_kind_text(plain, info)}, found {len(value)} values: {value!r}"
            )
        return tuple(_checked(flag, entry, info, entries[0]) for entry in value)
    try:
        if plain is bool or isinstance(value, bool):
            if plain is not bool or not isinstance(value, bool):
                raise TypeError
            return value
        if plain is str:
            if not isinstance(value, str) or not value:
                raise TypeError
            return value
        number = operator.index(value) if plain is int else float(value)
    except (TypeError, ValueError):
        raise InputError(f"{flag} must be {_kind_text(plain, info)}, found {value!r}") from None
    if plain is int and info.high is None:
        info = dataclasses.replace(info, high=MOST_WHOLE)
    if not info.holds(number):
        raise InputError(f"{flag} must be {info.format_range()}, found {value!r}")
    return number


def _plain_kind(kind: Any) -> Any:
    """`int` of `int | None`; kinds that are no union as they are."""
    if typing.get_origin(kind) in (None, tuple):
        return kind
    return next(k for k in typing.get_args(kind) if k is not type(None))


def _kind_text(kind: Any, info: OptionInfo) -> str:
    """A kind in words, for messages."""
    words = "".join(f" or {word}" for word in info.words)
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        if entries[-1] is Ellipsis:
            return f"a list of {'names' if entries[0] is str else 'numbers'}" + words
        return f"{len(entries)} numbers" + words
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a word"}
    return names[kind] + words


class _Help(argparse.Action):
    """`--help` shows the common options, `--help all` every one."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, values: Any, *__: Any) -> None:
        if values == "all":
            show_every_option(parser)
        parser.print_help()
        parser.exit()


def show_every_option(parser: argparse.ArgumentParser) -> None:
    """Lets the parser's help list the options that `add_option_flags` hid, too."""
    for action in parser._actions:
        action.help = getattr(action, "full_help", action.help)


def add_option_flags(
    parser: argparse.ArgumentParser, options: type, common: Sequence[str] | None = None
) -> None:
    """Adds one flag for each field of an options dataclass, grouped, with units and defaults.

    Flags that are not given leave nothing in the namespace, so that `given_options` can tell a
    given value from a default.

    Args:
        parser: gets the flags.
        options: the dataclass.
        common: fields that `--help` lists; the others are listed by `--help all`. None: all.
    """
    if common is not None:
        # Another --help takes the place of argparse's own.
        parser.add_argument_group("Help", conflict_handler="resolve").add_argument(
            "-h", "--help", action=_Help, nargs="?", metavar="all", default=argparse.SUPPRESS,
            help="show these options; with the word 'all' every option there is",
        )  # fmt: skip
    kinds = typing.get_type_hints(options)
    groups: dict[str, Any] = {}
    for field in _described(options):
        info = option_info(field)
        if info.group not in groups:
            groups[info.group] = parser.add_argument_group(info.group)
        text = option_text(field).replace("%", "%%")
        plain = _plain_kind(kinds[field.name])
        settings: dict[str, Any] = {"default": argparse.SUPPRESS, "help": text}
        if plain is bool:
            settings["action"] = argparse.BooleanOptionalAction
        else:
            settings["type"] = _reader(plain, info)
            settings["metavar"] = _metavar(plain, info)
        name = flag_name(field.name)
        action = groups[info.group].add_argument(name, dest=field.name, **settings)
        if common is not None and field.name not in common:
            action.full_help, action.help = action.help, argparse.SUPPRESS


def given_options(options: type, namespace: argparse.Namespace) -> dict[str, Any]:
    """Those options that were given on the command line, by field name."""
    given = vars(namespace)
    return {f.name: given[f.name] for f in _described(options) if f.name in given}


def _metavar(kind: Any, info: OptionInfo) -> str:
    if info.choices:
        return "{" + ",".join(info.choices) + "}"
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        return "A,B,..." if entries[-1] is Ellipsis else ",".join("XYZW"[: len(entries)])
    return {int: "N", float: "X", str: "WORD"}[kind]


def _reader(kind: Any, info: OptionInfo) -> Any:
    """The function that argparse calls to turn a flag's text into a value.

    It checks nothing: text that is no number stays text, which `check_options` refuses with the
    same sentence that a wrong value gets in Python.
    """

    def read(text: str) -> Any:
        if text in info.words or info.choices:
            return text
        if typing.get_origin(kind) is tuple:
            entry = typing.get_args(kind)[0]
            return tuple(_parsed(part.strip(), entry) for part in text.split(",") if part)
        return _parsed(text, kind)

    return read


def _parsed(text: str, kind: Any) -> Any:
    """Text as a number where the kind is one, else (or where it is none) the text itself."""
    try:
        return kind(text) if kind in (int, float) else text
    except ValueError:
        return text


def parse_size(text: str, flag: str = "--target-size") -> int:
    """Bytes of a size such as 5MB, 800kB or 123456.

    Raises:
        InputError: no such size.
    """
    number = text.strip().upper().rstrip("BKMG")
    unit = text.strip().upper()[len(number) :] or "B"
    try:
        size = float(number) * _UNITS[unit]
    except (ValueError, KeyError):
        raise InputError(f"{flag} must be like 5MB or 800kB, found {text!r}") from None
    if not (math.isfinite(size) and size >= 1):
        raise InputError(f"{flag} must be a positive size, found {text!r}")
    return int(size)
