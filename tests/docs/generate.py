"""Writes the pages of docs/ that come from the code, and the pictures of lenses that have none.

./run docs
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import itertools
import json
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
from gsut.cli import build_parser
from gsut.run.options import show_every_option
from lens_pictures import FOLDER, draw, seen_angle, widest_example
from public_names import list_public_names

ROOT = Path(__file__).resolve().parents[2]
MODELS = ROOT / "cpp" / "gsut" / "cameras" / "models"
STUB = ROOT / "python" / "gsut" / "_core.pyi"
VECTORS = ROOT / "tests" / "oracles" / "lens_vectors.json"
NOTE = "<!-- Written by `./run docs` from the code: edit that. -->\n"
SECTION = re.compile(r"^(Args|Attributes|Returns|Raises):$")
# Lenses that tests/python/lens compares with a program and not with recorded vectors.
CV2 = ("kannala_brandt", "opencv12", "opencv14", "opencv4", "opencv5", "opencv8", "pinhole")
ORACLES = dict.fromkeys(CV2, "OpenCV") | {
    "mei": "OpenCV's omnidir",
    "double_sphere": "its formula in long double",
    "ftheta": "its formula in long double",
    "orthographic": "its formula",
}


# --- lenses ---------------------------------------------------------------------------------------


def comment_blocks(path: Path) -> Iterator[tuple[bool, str]]:
    """(is a formula, text) of the blocks of the comment at the top of a lens file."""
    lines = []
    for line in path.read_text().splitlines():
        if not line.startswith("//"):
            break
        lines.append(line[2:])
    for block in "\n".join(lines).split("\n\n"):
        for is_formula, part in itertools.groupby(
            block.splitlines(), lambda r: r.startswith("   ")
        ):
            text = "\n".join(part)
            yield is_formula, textwrap.dedent(text) if is_formula else " ".join(text.split())


def capitalised(head: str) -> str:
    """What a lens is, from the first line of its file."""
    text = head.partition(": ")[2]
    return text[:1].upper() + text[1:]


def oracle_of(model: str) -> str:
    vectors = json.loads(VECTORS.read_text())
    found = {vector["oracle"] for vector in vectors if vector["model"] == model}
    return ", ".join(sorted(found)) or ORACLES.get(model, "")


def lens_section(model: str) -> str:
    (_, head), *blocks = comment_blocks(MODELS / f"{model}.h")
    about, camera = widest_example(model)
    out = [f"## {model}\n", f"{capitalised(head)}\n"]
    out.append(f"![The demo's hall through {model}](lenses/{model}.jpg)\n")
    out.append(f"Picture: {about}.\n")
    family = re.search(r"families/\w+\.h", str(blocks))
    if family:  # whose comment has the formula
        blocks += list(comment_blocks(MODELS.parent / family[0]))[1:]
    for is_formula, text in blocks:
        out.append(f"```text\n{text}\n```\n" if is_formula else f"{text}\n")
    largest = np.degrees(camera.max_angle)
    out.append(
        f"In the picture: `{camera.param_names}`, up to {np.degrees(seen_angle(camera)):.0f} "
        f"degrees off-axis; one-to-one up to {largest:.0f}."
    )
    if oracle_of(model):
        out.append(f"Tested against: {oracle_of(model)}.")
    return "\n".join(out) + "\n"


def lenses_page() -> str:
    models = gsut.lens.camera_models()
    heads = {model: next(comment_blocks(MODELS / f"{model}.h"))[1] for model in models}
    rows = "".join(f"| [{m}](#{m}) | {capitalised(head)} |\n" for m, head in heads.items())
    return (
        f"{NOTE}# Lens models\n\n"
        f"The {len(models)} lenses that `Camera`, every command and every dataset reader take. "
        "Each is one file in\n`cpp/gsut/cameras/models`, and below is the comment at its top. "
        "[Which lens do I have?](which-lens.md)\nhelps to choose.\n\n"
        f"| Lens | What it is |\n|---|---|\n{rows}\n" + "\n".join(map(lens_section, models))
    )


# --- command line ---------------------------------------------------------------------------------


def flag_row(action: argparse.Action) -> str:
    names = ", ".join(f"`{name}`" for name in action.option_strings)
    metavar = action.metavar or (
        "{" + ",".join(map(str, action.choices)) + "}" if action.choices else ""
    )
    if isinstance(metavar, tuple):
        metavar = " ".join(metavar)
    shown = f"{names} `{metavar}`" if names and metavar and action.nargs != 0 else names
    text = (action.help or "") % {"default": action.default, "prog": "gsut"}
    cells = (shown or f"`{metavar or action.dest}`", text)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def command_section(name: str, parser: argparse.ArgumentParser, level: str = "##") -> str:
    show_every_option(parser)
    out = [f"{level} gsut {name}\n", f"{parser.description or ''}\n"]
    for group in parser._action_groups:
        actions = [
            action
            for action in group._group_actions
            if action.help != argparse.SUPPRESS and "--help" not in action.option_strings
        ]
        inner = [a for a in actions if isinstance(a, argparse._SubParsersAction)]
        rows = [flag_row(action) for action in actions if action not in inner]
        if rows:
            title = {"positional arguments": "Arguments", "options": "Options"}.get(
                group.title or "", group.title or ""
            )
            out.append(f"| {title} | |\n|---|---|\n" + "\n".join(rows) + "\n")
        for action in inner:
            for word, child in action.choices.items():
                out.append(command_section(f"{name} {word}", child, level + "#"))
    return "\n".join(out)


def cli_page() -> str:
    parser = build_parser()
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    about = {action.dest: action.help for action in commands._choices_actions}
    rows = "".join(f"| [gsut {n}](#gsut-{n}) | {about[n]} |\n" for n in commands.choices)
    return (
        f"{NOTE}# Command line\n\nWrong input ends with one sentence on standard error and exit "
        "status 2; `GSUT_DEBUG=1` adds the traceback.\n\n"
        f"| Command | What it does |\n|---|---|\n{rows}\n"
        + "\n".join(command_section(n, p) for n, p in commands.choices.items())
    )


# --- Python ---------------------------------------------------------------------------------------


def tasks() -> Iterator[tuple[str, list[str]]]:
    """(heading, names) of `gsut.__all__`, by the comments between them."""
    source = Path(gsut.__file__).read_text().partition("__all__ = [")[2].partition("]")[0]
    for part in re.split(r"^    # ", source, flags=re.MULTILINE)[1:]:
        heading, _, names = part.partition("\n")
        yield heading, re.findall(r'"(\w+)"', names)


def sections() -> Iterator[tuple[str, str, list[str]]]:
    """Yields (module, heading, names): the tasks of `gsut`, then its submodules."""
    for heading, names in tasks():
        yield "gsut", heading, names
    for module, names in list_public_names().items():
        if module != "gsut":
            about = (importlib.import_module(module).__doc__ or "").partition("\n")[0]
            yield module, f"{module}: {about[:1].lower()}{about[1:].rstrip('.')}", names


def stub_signatures() -> dict[str, str]:
    """Arguments of the functions and classes of the C++ module: "name" and "Class.name"."""
    found = {}
    for node in ast.parse(STUB.read_text()).body:
        members = [node] if isinstance(node, ast.FunctionDef) else getattr(node, "body", [])
        for member in members:
            if isinstance(member, ast.FunctionDef):
                name = member.name if member is node else f"{node.name}.{member.name}"
                for argument in (*member.args.args, *member.args.kwonlyargs):
                    argument.annotation = None
                member.args.args = [a for a in member.args.args if a.arg != "self"]
                found[name] = ast.unparse(member.args)
    return found


STUBS = stub_signatures()


def arguments_of(member: object, name: str) -> str:
    """The arguments without types, which the text has."""
    key = name if not inspect.isclass(member) else f"{name}.__init__"
    if key in STUBS and getattr(member, "__module__", "").endswith("_core"):
        return STUBS[key]
    signature = inspect.signature(member)  # type: ignore[arg-type]
    shown = [
        p.replace(annotation=inspect.Parameter.empty)
        for p in signature.parameters.values()
        if p.name != "self"
    ]
    text = str(inspect.Signature(shown))[1:-1]
    return re.sub(r"<function .* at \w+>", "...", text)


def docstring(member: object, *, bound: bool) -> str:
    text = inspect.cleandoc(inspect.getdoc(member) or "")
    return text.partition("\n")[2].strip() if bound else text


def as_markdown(text: str) -> str:
    """A docstring's sections as paragraphs and lists."""
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


def member_rows(member: type, name: str) -> list[str]:
    """Methods and properties of a class, a line each."""
    rows = []
    for part, value in vars(member).items():
        if part.startswith("_") or not (callable(value) or isinstance(value, property)):
            continue
        text = docstring(value, bound=type(value).__name__ == "instancemethod")
        summary = " ".join(text.partition("\n\n")[0].split())
        called = "" if isinstance(value, property) else f"({arguments_of(value, f'{name}.{part}')})"
        rows.append(f"- `.{part}{called}`: {summary}")
    return rows


def api_section(name: str, module: str = "gsut") -> str:
    member = getattr(importlib.import_module(module), name)
    if not callable(member):
        return f"### {name}\n\n`{member!r}`\n" if name != "__version__" else ""
    bound = inspect.isbuiltin(member)
    out = [f"### {name}\n"]
    if not (inspect.isclass(member) and issubclass(member, Exception)):
        text = f"{module}.{name}({arguments_of(member, name)})"
        lines = textwrap.wrap(text, 96, subsequent_indent="    ", break_on_hyphens=False)
        out.append("```text\n" + "\n".join(lines) + "\n```\n")
    out.append(as_markdown(docstring(member, bound=bound)) + "\n")
    if inspect.isclass(member):
        rows = member_rows(member, name)
        out.append("Members:\n\n" + "\n".join(rows) + "\n" if rows else "")
    return "\n".join(out)


def link_to(heading: str, taken: list[str]) -> str:
    """A link to a heading of the same page; equal anchors are numbered as GitHub numbers them."""
    anchor = heading.lower().replace(" ", "-")
    number = taken.count(anchor)
    taken.append(anchor)
    return f"[{heading}](#{anchor}{f'-{number}' if number else ''})"


def api_page() -> str:
    parts = [
        f"## {heading}\n\n" + "\n".join(filter(None, (api_section(n, module) for n in names)))
        for module, heading, names in sections()
    ]
    taken: list[str] = []
    contents = ""
    for _, heading, names in sections():
        link_to(heading, taken)
        links = [link_to(name, taken) for name in names if name != "__version__"]
        contents += f"- {heading}: {', '.join(links)}\n"
    return (
        f"{NOTE}# Python API\n\nEvery public name; `help(gsut.render)` prints the same. Axes, "
        f"pixel centres and units: [conventions](conventions.md).\n\n{contents}\n"
        + "\n".join(parts)
    )


PAGES = {"lenses.md": lenses_page, "cli.md": cli_page, "api.md": api_page}


def page(name: str) -> str:
    """The text of a generated page."""
    return re.sub(r"\n{3,}", "\n\n", PAGES[name]()).rstrip() + "\n"


def main() -> None:
    draw([model for model in gsut.lens.camera_models() if not (FOLDER / f"{model}.jpg").is_file()])
    for name in PAGES:
        (ROOT / "docs" / name).write_text(page(name))


if __name__ == "__main__":
    main()
