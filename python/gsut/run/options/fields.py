"""Describes and checks the fields of an options dataclass."""

from __future__ import annotations

import dataclasses
import math
import operator
import pkgutil
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.bounds import MOST_WHOLE, show


@dataclasses.dataclass(frozen=True)
class OptionInfo:
    """What a field of an options dataclass may hold and how help describes it.

    Attributes:
        group: heading under which --help and the report list the option.
        help: what it does, in a few words.
        unit: unit of the value; empty for pure numbers.
        low, high: allowed range (of every entry of a tuple); None = no limit.
        low_open: the limit itself is not allowed.
        choices: allowed words.
        words: words allowed instead of a value.
        none: what None means; empty if None is not allowed.
        reason: why the default is what it is.
    """

    group: str
    help: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    choices: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    none: str = ""
    reason: str = ""

    def describe_range(self) -> str:
        """Returns the allowed range in words, for messages."""
        if self.low is None and self.high is None:
            return "any value"
        above = ">" if self.low_open else ">="
        parts = [f"{above} {self.low:g}"] if self.low is not None else []
        parts += [f"<= {self.high:g}"] if self.high is not None else []
        return " and ".join(parts)

    def is_in_range(self, number: float) -> bool:
        """Returns whether a number lies in the range; NaN never does."""
        above = self.low is None or (number > self.low if self.low_open else number >= self.low)
        below = self.high is None or number <= self.high
        return bool(above and below and math.isfinite(number))


def define_option(default: Any, group: str, help: str, **info: Any) -> Any:
    """Makes a dataclass field with an `OptionInfo` (see there for the arguments) as metadata."""
    return dataclasses.field(default=default, metadata={"option": OptionInfo(group, help, **info)})


def list_choices(folder: str, first: str) -> tuple[str, ...]:
    """Lists the modules in a folder of gsut, each of them a choice, without importing them.

    Args:
        folder: below the package. A dash in a choice is an underscore in its module's name.
        first: the default, listed before the others.
    """
    modules = pkgutil.iter_modules([str(Path(__file__).parents[2] / folder)])
    names = (module.name.replace("_", "-") for module in modules)
    return tuple(sorted(names, key=lambda name: (name != first, name)))


def get_info(field: dataclasses.Field) -> OptionInfo:
    """Returns the `OptionInfo` that `define_option` put into a field."""
    return field.metadata["option"]


def list_fields(options: Any) -> list[dataclasses.Field]:
    """Lists the fields made by `define_option` of an options dataclass or its instance."""
    return [field for field in dataclasses.fields(options) if "option" in field.metadata]


def has_flag(options: Any, name: str) -> bool:
    """Returns whether an option has a flag, rather than being set in Python only.

    Args:
        options: a dataclass or its instance; its class attribute FLAGS lists the fields with a
            flag. Without this attribute all have one.
        name: of the field.
    """
    flags = getattr(options, "FLAGS", None)
    return flags is None or name in flags


def format_flag(name: str) -> str:
    """Returns the flag of a field: max_gaussians -> --max-gaussians."""
    return "--" + name.replace("_", "-")


def label_option(options: Any, name: str) -> str:
    """Returns the name of an option for messages: --steps, or strategy, which has no flag."""
    return format_flag(name) if has_flag(options, name) else name


def format_default(field: dataclasses.Field) -> str:
    """Returns the default as the command line would take it, or what None stands for."""
    if field.default is None:
        return get_info(field).none
    if isinstance(field.default, bool):
        return "on" if field.default else "off"
    if isinstance(field.default, tuple):
        return ",".join(v if isinstance(v, str) else f"{v:g}" for v in field.default) or "none"
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default)


def list_words(options: Any, default: Any, but: Sequence[str] = ()) -> list[str]:
    """Lists the words of a command line that turn `default` into `options`, as far as flags do.

    Args:
        options, default: instances of one class.
        but: fields to leave out.
    """
    words = []
    for field in list_fields(options):
        name, value = field.name, getattr(options, field.name)
        if value is None or value == getattr(default, name) or name in but:
            continue
        if not has_flag(options, name):
            continue
        text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        if isinstance(value, bool):
            words.append(format_flag(name if value else f"no_{name}"))
        else:
            words += [format_flag(name), text]
    return words


def describe_options(options: type) -> type:
    """Lists the fields of an options dataclass in its docstring, above the errors."""
    doc, _, raises = (options.__doc__ or "").partition("    Raises:")
    rows = "".join(f"        {f.name}: {describe_option(f)}.\n" for f in list_fields(options))
    options.__doc__ = f"{doc}    Args:\n{rows}\n    Raises:{raises}"
    return options


def describe_option(field: dataclasses.Field) -> str:
    """Returns what an option does, with its unit, default and reason."""
    info = get_info(field)
    notes = [info.unit, f"default {format_default(field)}", info.reason]
    return f"{info.help} [{'; '.join(note for note in notes if note)}]"


def check_options(options: Any) -> None:
    """Checks every field of an options dataclass and turns numbers into plain int and float.

    Raises:
        InputError: names the option, the value and what is allowed.
    """
    kinds = typing.get_type_hints(type(options))
    for field in list_fields(options):
        label, value = label_option(options, field.name), getattr(options, field.name)
        checked = _check_value(label, value, get_info(field), kinds[field.name])
        object.__setattr__(options, field.name, checked)


def _check_value(label: str, value: Any, info: OptionInfo, kind: Any) -> Any:
    """Returns `value` as the plain type of `kind`, or raises InputError."""
    if value is None and info.none:
        return None
    if isinstance(value, str) and value in info.words:
        return value
    shown = show(repr(value))
    if info.choices:
        if value not in info.choices:
            raise InputError(f"{label} must be one of {', '.join(info.choices)}, found {shown}")
        return value
    plain = strip_none(kind)
    needed = f"{label} must be {_describe_kind(plain, info)}, found"
    if typing.get_origin(plain) is tuple:
        entries = typing.get_args(plain)
        if not isinstance(value, (tuple, list)):
            raise InputError(f"{needed} {shown}")
        if entries[-1] is not Ellipsis and len(value) != len(entries):
            raise InputError(f"{needed} {len(value)} values: {shown}")
        return tuple(_check_value(label, entry, info, entries[0]) for entry in value)
    is_word = isinstance(value, str) and value != ""
    if isinstance(value, bool) != (plain is bool) or (plain is str and not is_word):
        raise InputError(f"{needed} {shown}")
    if plain in (bool, str):
        return value
    try:
        number = operator.index(value) if plain is int else float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{needed} {shown}") from None
    if plain is int and info.high is None:
        info = dataclasses.replace(info, high=MOST_WHOLE)
    if not info.is_in_range(number):
        raise InputError(f"{label} must be {info.describe_range()}, found {shown}")
    return number


def strip_none(kind: Any) -> Any:
    """Returns `int` of `int | None`; types that are no union stay as they are."""
    if typing.get_origin(kind) in (None, tuple):
        return kind
    return next(k for k in typing.get_args(kind) if k is not type(None))


def _describe_kind(kind: Any, info: OptionInfo) -> str:
    """Returns a type in words, for messages."""
    words = "".join(f" or {word}" for word in info.words)
    if typing.get_origin(kind) is tuple:
        entries = typing.get_args(kind)
        if entries[-1] is Ellipsis:
            return f"a list of {'names' if entries[0] is str else 'numbers'}" + words
        return f"{len(entries)} numbers" + words
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a word"}
    return names[kind] + words
