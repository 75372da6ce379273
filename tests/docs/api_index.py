"""Makes the index of the Python API: every public name, by task."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import NamedTuple

import gsut
from public_names import list_public_names

ROOT = Path(__file__).resolve().parents[2]
NOTE = "<!-- Written by `./run docs` from the code: edit that. -->\n"
# The task of each submodule's names, besides the headings of `gsut.__all__`.
TASK_OF_MODULE = {
    "gsut.lens": "Lenses",
    "gsut.poses": "Find poses",
    "gsut.loop": "Write a training loop",
    "gsut.rendering": "Render",
    "gsut.surface": "Make a mesh",
    "gsut.metrics": "Judge",
    "gsut.edit": "Edit",
    "gsut.formats": "Save",
    "gsut.machine": "Machine",
}


class Task(NamedTuple):
    """The public names that serve one purpose, as (module, name)."""

    heading: str
    names: list[tuple[str, str]]

    @property
    def slug(self) -> str:
        return self.heading.lower().replace(",", "").replace(" ", "-")


@functools.cache
def find_tasks() -> list[Task]:
    """Returns the tasks of the comments in `gsut.__all__`, each with its submodule's names."""
    tasks: dict[str, list[tuple[str, str]]] = {}
    text = Path(gsut.__file__).read_text().partition("__all__ = [")[2].partition("]")[0]
    for part in re.split(r"^    # ", text, flags=re.MULTILINE)[1:]:
        heading, _, names = part.partition("\n")
        found = [n for n in re.findall(r'"(\w+)"', names) if n != "__version__"]
        tasks[heading] = [("gsut", name) for name in found]
    for module, names in list_public_names().items():
        if module != "gsut":
            tasks.setdefault(TASK_OF_MODULE[module], []).extend((module, name) for name in names)
    return [Task(heading, names) for heading, names in tasks.items()]


def make_index() -> str:
    """Returns the index of all tasks and names, which stands in the repository."""
    rows = "".join(
        f"| [{task.heading}](examples/{task.slug}.py) | "
        + ", ".join(f"`{module}.{name}`".replace("`gsut.", "`") for module, name in task.names)
        + " |\n"
        for task in find_tasks()
    )
    return (
        f"{NOTE}# Python API\n\nEvery public name of `gsut`, by task, with a program that uses it. "
        "`help(gsut.render)` prints shapes, units,\nerrors and sources. "
        "Axes and pixel centres: [conventions](conventions.md).\n\n"
        f"| Task | Names |\n|---|---|\n{rows}"
    )
