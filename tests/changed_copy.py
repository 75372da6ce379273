"""Copies of a nerfstudio dataset with changed values."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

Values = dict[str, Any]


def copy_of(data: Path, folder: Path) -> Values:
    """A folder with links to a dataset's files; the values of its transforms.json."""
    folder.mkdir(parents=True)
    for each in data.iterdir():
        if each.name != "transforms.json":
            (folder / each.name).symlink_to(each)
    return json.loads((data / "transforms.json").read_text())


def write(values: Values, folder: Path, with_points: bool) -> Path:
    """Writes the transforms.json, without points if they are not wanted."""
    values = dict(values)
    if not with_points:
        values.pop("ply_file_path", None)
    (folder / "transforms.json").write_text(json.dumps(values))
    return folder
