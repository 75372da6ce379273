"""Makes the pages of the Python API from the docstrings: an index, and a page for each task."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import re
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import gsut
from public_names import list_public_names

ROOT = Path(__file__).resolve().parents[2]
STUB = ROOT / "python" / "gsut" / "_core.pyi"
EXAMPLES = ROOT / "docs" / "examples"  # one program for each page
NOTE = "<!-- Written by `./run docs` from the code: edit that. -->\n"
SECTION = re.compile(r"^(Args|Attributes|Returns|Raises):$")
# The task of each submodule's names; a heading that `gsut.__all__` lacks becomes a page of its own.
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
    """One page: the public names that serve one purpose, as (module, name)."""

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


class Signature(NamedTuple):
    """What the stub of the C++ module says about a function."""

    arguments: str
    returns: str


@functools.cache
def read_stub() -> dict[str, Signature]:
    """Returns the signatures in the stub of the C++ module, by "name" and "Class.name"."""
    found = {}
    for node in ast.parse(STUB.read_text()).body:
        members = [node] if isinstance(node, ast.FunctionDef) else getattr(node, "body", [])
        for member in members:
            if isinstance(member, ast.FunctionDef):
                name = member.name if member is node else f"{node.name}.{member.name}"
                for argument in (*member.args.args, *member.args.kwonlyargs):
                    argument.annotation = None
                member.args.args = [a for a in member.args.args if a.arg != "self"]
                returns = ast.unparse(member.returns) if member.returns else ""
                found[name] = Signature(ast.unparse(member.args), returns)
    return found


def read_signature(member: object, name: str) -> Signature:
    """Returns the arguments of a function or class without types, and what it returns.

    The types of arguments are in the text, with shapes and units.
    """
    key = name if not inspect.isclass(member) else f"{name}.__init__"
    if key in read_stub() and getattr(member, "__module__", "").endswith("_core"):
        return read_stub()[key]
    signature = inspect.signature(member)  # type: ignore[arg-type]
    shown = [
        p.replace(annotation=inspect.Parameter.empty)
        for p in signature.parameters.values()
        if p.name != "self"
    ]
    text = re.sub(r"<function .* at \w+>", "...", str(inspect.Signature(shown))[1:-1])
    returns = signature.return_annotation
    if returns is inspect.Signature.empty:
        return Signature(text, "")
    return Signature(
        text, returns if isinstance(returns, str) else inspect.formatannotation(returns)
    )


def format_call(name: str, signature: Signature, *, is_class: bool) -> str:
    """Returns a call with its return type, as a reader would write it."""
    returns = re.sub(r"\b(?:np|npt|numpy|os|_core|gsut)\.(?:typing\.)?", "", signature.returns)
    shown = "" if is_class or returns in ("", "None") else f" -> {returns}"
    return f"{name}({signature.arguments}){shown}"


def read_docstring(member: object, *, bound: bool) -> str:
    """Returns a docstring without the signature that pybind11 writes first."""
    text = inspect.cleandoc(inspect.getdoc(member) or "")
    return text.partition("\n")[2].strip() if bound else text


def format_docstring(text: str) -> str:
    """Returns a docstring's sections as paragraphs and lists of Markdown."""
    out: list[str] = []
    for block in text.split("\n\n"):
        head, _, rest = block.partition("\n")
        if not SECTION.match(head):
            out.append(" ".join(block.split()))
            continue
        body = textwrap.dedent(rest)
        if head in ("Args:", "Attributes:", "Raises:") or re.match(r"\w+: ", body):
            entries = re.split(r"\n(?=\S)", body)
            rows = [" ".join(entry.split()) for entry in entries]
            rows = [re.sub(r"^([\w, *]+?(?: \(an InputError\))?):", r"`\1`:", row) for row in rows]
            out.append(f"{head[:-1]}:\n\n" + "\n".join(f"- {row}" for row in rows))
        else:
            out.append(f"{head[:-1]}: " + " ".join(body.split()))
    return "\n\n".join(out)


def list_members(member: type, name: str) -> list[str]:
    """Returns the methods and properties of a class, a line each."""
    rows = []
    for part, value in vars(member).items():
        if part.startswith("_") or not (callable(value) or isinstance(value, property)):
            continue
        text = read_docstring(value, bound=type(value).__name__ == "instancemethod")
        summary = " ".join(text.partition("\n\n")[0].split())
        called = f".{part}"
        if not isinstance(value, property):
            signature = read_signature(value, f"{name}.{part}")
            called = format_call(called, signature, is_class=False)
        rows.append(f"- `{called}`: {summary}")
    return rows


def make_section(module: str, name: str) -> str:
    """Returns the section of one public name."""
    member = getattr(importlib.import_module(module), name)
    if not callable(member):
        return f"## {name}\n\n`{member!r}`\n"
    bound, is_class = inspect.isbuiltin(member), inspect.isclass(member)
    out = [f"## {name}\n"]
    if not (is_class and issubclass(member, Exception)):
        text = format_call(f"{module}.{name}", read_signature(member, name), is_class=is_class)
        lines = textwrap.wrap(text, 96, subsequent_indent="    ", break_on_hyphens=False)
        out.append("```text\n" + "\n".join(lines) + "\n```\n")
    out.append(format_docstring(read_docstring(member, bound=bound)) + "\n")
    if is_class:
        rows = list_members(member, name)
        out.append("Members:\n\n" + "\n".join(rows) + "\n" if rows else "")
    return "\n".join(out)


def make_page(task: Task) -> str:
    """Returns the page of a task: its example, then every name."""
    tree = ast.parse(text := (EXAMPLES / f"{task.slug}.py").read_text())
    about = re.sub(
        r"(?<!-->)$", "\n", ast.get_docstring(tree) or ""
    )  # a marker stands above the code
    code = "\n".join(text.splitlines()[tree.body[0].end_lineno :]).strip()
    sections = "\n".join(make_section(module, name) for module, name in task.names)
    block = f"```python\n{code}\n```"
    return f"{NOTE}# {task.heading}\n\n{about}\n{block}\n\n{sections}"


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
        "`help(gsut.render)` prints shapes, units,\nerrors and sources; `./run docs` writes the "
        "same as pages, `docs/api/`. Axes and pixel centres: [conventions](conventions.md).\n\n"
        f"| Task | Names |\n|---|---|\n{rows}"
    )


# Made for a release, not kept in the repository.
API_PAGES: dict[str, Callable[[], str]] = {
    **{f"api/{task.slug}.md": functools.partial(make_page, task) for task in find_tasks()},
}
