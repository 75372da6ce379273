"""Reads the files of datasets; errors name the file and, where known, the line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gsut.data.errors import DatasetError
from gsut.files import check_regular, parse_yaml


def read_bytes(source: Path) -> bytes:
    """Reads the bytes of a file.

    Raises:
        DatasetError: it cannot be opened.
    """
    try:
        return check_regular(source).read_bytes()
    except OSError as error:
        raise DatasetError(
            source, f"cannot be opened ({error.strerror})", "check the path"
        ) from error


def read_text(source: Path) -> str:
    """Reads the text of a file.

    Raises:
        DatasetError: missing, or not UTF-8 text.
    """
    try:
        return check_regular(source).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DatasetError(
            source, f"cannot be opened ({error.strerror})", "check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise DatasetError(
            source, f"byte {error.start} is not UTF-8 text", "save the file as UTF-8"
        ) from error


def read_json(source: Path) -> Any:
    """Parses a JSON file.

    Raises:
        DatasetError: missing, not text, or not JSON (with line and column).
    """
    try:
        return json.loads(read_text(source))
    except json.JSONDecodeError as error:
        raise DatasetError(
            source,
            f"not valid JSON at line {error.lineno}, column {error.colno} ({error.msg})",
            "the file may be cut off: copy or export it again",
        ) from error
    except RecursionError as error:
        raise DatasetError(
            source, "cannot be understood: nested too deeply", "export it again"
        ) from error


def read_yaml(source: Path) -> dict[str, Any]:
    """Reads the keys and values of a YAML file.

    Raises:
        DatasetError: missing, not text, not YAML (with line), or no keys and values.
    """
    values = parse_yaml(
        read_text(source),
        lambda at, what: DatasetError(f"{source}{at}", f"not YAML ({what})", "correct it"),
    )
    if not isinstance(values, dict):
        raise DatasetError(
            source, f"expected keys with values, found {type(values).__name__}", "correct it"
        )
    return values


def read_rows(source: Path) -> list[tuple[int, list[str]]]:
    """Reads line numbers from 1 and fields, parted by commas or blanks; '#' begins a comment.

    Raises:
        DatasetError: missing, or not UTF-8 text.
    """
    rows = []
    for number, line in enumerate(read_text(source).splitlines(), 1):
        text = line.strip()
        if text and not text.startswith("#"):
            fields = text.split(",") if "," in text else text.split()
            rows.append((number, [field.strip() for field in fields]))
    return rows
