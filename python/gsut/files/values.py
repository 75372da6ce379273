"""Reads and writes JSON, YAML and tables of text: bounded, in linear time, of a stated shape."""

from __future__ import annotations

import csv
import json
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gsut.files.errors import COPY_AGAIN, Fails, FileError, reading
from gsut.files.opening import SAVE_AS_UTF8, PathLike, decode_text, read_text
from gsut.files.shapes import check_shape
from gsut.files.writing import write_file

_MOST_JSON = 256 << 20  # bytes: values take ten times the memory of their text
_MOST_YAML = 4 << 20  # bytes: its parser takes seconds for one of these
_MOST_ALIASES = 16  # of a YAML file: each can double what it refers to
_MOST_NESTED = 200  # lists and objects within each other: functions that call themselves read them
_MOST_DIGITS = 40  # of a whole number: states of random numbers have 128 bits
_CORRECT = "correct it"
_DECIMAL_COMMA = re.compile(r"^(-?\d+),(\d+)$")
_Pairs = list[tuple[str, Any]]


def read_json(
    path: PathLike,
    shape: Any = None,
    *,
    advice: str = COPY_AGAIN,
    most_bytes: int = _MOST_JSON,
    fails: Fails = FileError,
) -> Any:
    """Reads a JSON file.

    Args:
        path: the file.
        shape: of its content, see `check_shape`; None: any.
        advice: what to do about a damaged file.
        most_bytes: of the file.
        fails: makes the error.

    Raises:
        FileError: it cannot be opened or is too large, is not UTF-8 or not JSON (with line and
            column), nests too deeply, has a key twice or a number of too many digits, or another
            shape.
    """
    advice_on_bytes = SAVE_AS_UTF8 if advice == COPY_AGAIN else advice
    text = read_text(path, most_bytes, advice=advice_on_bytes, fails=fails)
    return parse_json(text, path, shape, advice=advice, fails=fails)


def parse_json(
    text: str | bytes,
    where: object,
    shape: Any = None,
    *,
    advice: str = COPY_AGAIN,
    fails: Fails = FileError,
) -> Any:
    """Parses JSON from somewhere, see `read_json`."""
    with reading(where, advice, fails):
        if isinstance(text, bytes):
            text = decode_text(text, where)
        try:
            values = json.loads(text, object_pairs_hook=_make_object)
        except json.JSONDecodeError as error:
            place = f"line {error.lineno}, column {error.colno}"
            raise FileError(where, f"not valid JSON at {place} ({error.msg})", advice) from error
        _check_depth(values)
        if shape is not None:
            check_shape(values, shape)
        return values


def _make_object(pairs: _Pairs) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice!r:.40} is there twice")
    return values


def _check_depth(values: Any) -> None:
    """Checks level by level how deep values nest, and how many digits whole numbers have."""
    largest = 10**_MOST_DIGITS
    level, depth = [values] if isinstance(values, (dict, list)) else [], 0
    while level:
        if depth > _MOST_NESTED:
            raise RecursionError
        below: list[Any] = []
        for each in level:
            entries = each.items() if type(each) is dict else enumerate(each)
            for key, entry in entries:
                kind = type(entry)
                if kind is dict or kind is list:
                    below.append(entry)
                elif kind is int and abs(entry) >= largest:
                    digits = len(str(abs(entry)))
                    raise OverflowError(f"key {key!r:.40} has a number of {digits} digits")
        level, depth = below, depth + 1
    if type(values) is int and abs(values) >= largest:
        raise OverflowError(f"a number of {len(str(abs(values)))} digits")


def read_yaml(path: PathLike) -> dict[str, Any]:
    """Reads the keys and values of a YAML file, also as OpenCV writes it.

    Raises:
        FileError: see `read_json`; or no keys and values.
    """
    return parse_yaml(read_text(path, _MOST_YAML), path)


def parse_yaml(
    text: str, where: object, shape: Any = None, *, fails: Fails = FileError
) -> dict[str, Any]:
    """Reads YAML, also as OpenCV writes it: with a directive of its own and tagged matrices."""
    import yaml  # here, because gsut --help needs none

    class Loader(yaml.SafeLoader):
        """Stops at an excess of aliases, and at a key that is there twice."""

        aliases = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.aliases += self.check_event(yaml.AliasEvent)
            if self.aliases > _MOST_ALIASES:
                mark = self.peek_event().start_mark
                raise yaml.composer.ComposerError(
                    None, None, f"more than {_MOST_ALIASES} aliases", mark
                )
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen = set()
            for key, _ in getattr(node, "value", ()):
                if isinstance(key, yaml.ScalarNode) and (key.tag, key.value) in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {key.value!r:.40} is there twice", key.start_mark
                    )
                seen.add((key.tag, str(key.value)))
            return super().construct_mapping(node, deep=deep)

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda loader, node: loader.construct_mapping(node, deep=True),
    )
    if len(text) > _MOST_YAML:
        raise fails(where, f"has more than {_MOST_YAML:,} letters", "is it a file of settings?")
    # OpenCV's directive "%YAML:1.0" is not YAML; an empty line keeps the line numbers.
    first, newline, rest = text.partition("\n")
    body = newline + rest if first.startswith("%YAML:") else text
    if body.rstrip().endswith("\n---"):  # `ros2 topic echo` ends each message so
        body = body.rstrip()[:-3]
    with reading(where, _CORRECT, fails):
        try:
            values = yaml.load(body, Loader=Loader)  # a SafeLoader
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            line = f", line {mark.line + 1}" if mark is not None else ""
            problem = getattr(error, "problem", None) or "cannot be parsed"
            raise FileError(f"{where}{line}", f"not YAML ({problem})", _CORRECT) from error
        if not isinstance(values, dict):
            found = type(values).__name__
            raise FileError(where, f"expected keys with values, found {found}", _CORRECT)
        json.dumps(values, default=str, skipkeys=True)  # ValueError: an alias within itself
        _check_depth(values)
        if shape is not None:
            check_shape(values, shape)
        return values


def read_rows(path: PathLike) -> list[tuple[int, list[str]]]:
    """Reads line numbers from 1 and fields; '#' begins a comment.

    Fields are parted by commas or blanks, or by semicolons, beside which a comma is a point.

    Raises:
        FileError: see `read_text`.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.strip()
        if text and not text.startswith("#"):
            if ";" in text:
                text = text.replace(",", ".").replace(";", ",")
            fields = text.split(",") if "," in text else text.split()
            rows.append((number, [field.strip() for field in fields]))
    return rows


def read_table(
    path: PathLike, names: Mapping[str, str], key: str
) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Reads a table whose heading names its columns.

    Fields are parted by commas, semicolons, tabs or blanks; where not by commas, these may be
    points of numbers. Capitals, units in brackets and a '#' before the heading do not count; of
    "X/Easting" the part that is known does.

    Args:
        path: the file.
        names: of columns by what programs call them.
        key: a column of every such table: the first line that has it is the heading.

    Returns:
        The names of the columns, of the first line if none is a heading, and each line's number
        from 1 and its texts by column.

    Raises:
        FileError: see `read_text`.
    """
    lines = read_text(path).splitlines()
    heads = [_parse_heading(line, names) for line in lines]
    place = next((k for k, (_, head) in enumerate(heads) if key in head), 0)
    if not lines or key not in heads[place][1]:
        return (heads[place][1] if lines else []), []
    mark, head = heads[place]
    rows = []
    for number, line in enumerate(lines[place + 1 :], place + 2):
        if line.strip() and not line.startswith("#"):
            fields = next(csv.reader([line.strip()], delimiter=mark, skipinitialspace=True))
            if mark != ",":
                fields = [_DECIMAL_COMMA.sub(r"\1.\2", field) for field in fields]
            texts = dict.fromkeys(head, "") | dict(zip(head, map(str.strip, fields), strict=False))
            rows.append((number, texts))
    return head, rows


def _parse_heading(line: str, names: Mapping[str, str]) -> tuple[str, list[str]]:
    """Returns by what a heading's columns are parted, and their names."""
    text = line.strip().lstrip("#").strip().lower()
    mark = next((mark for mark in ";\t," if mark in text), " ")
    found = []
    for field in text.split(mark):
        parts = [re.sub(r"[\[(].*", "", part).strip() for part in field.strip(' "').split("/")]
        known = [names.get(part, part) for part in parts]
        found.append(next((part for part in reversed(known) if part in names.values()), known[0]))
    return mark, found


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Writes `format_json`, see `whole_file`."""
    write_file(path, format_json(value) + "\n")


def format_json(value: Any) -> str:
    """Returns JSON with two spaces of indent; NaN and infinities, which JSON lacks, become null."""
    return json.dumps(to_plain(value), indent=2)


def to_plain(value: Any) -> Any:
    """Turns numpy's types into plain ones, and numbers that JSON lacks into None."""
    if isinstance(value, dict):
        return {str(key): to_plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, np.generic):
        return to_plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value
