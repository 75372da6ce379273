"""Writes the pages of docs/ that come from the code.

docs/demo.html, the demo's scene as a page for a release, stays out of the repository; it is made if
`./run demo` has made the scene.

./run docs
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gsut
from api_index import NOTE, make_index
from gsut.cli import build_parser
from gsut.cli import main as gsut_main
from lens_examples import find_widest_example, measure_seen_angle
from readme_figures import write_readme

ROOT = Path(__file__).resolve().parents[2]
MODELS = ROOT / "cpp" / "gsut" / "cameras" / "models"
VECTORS = ROOT / "tests" / "oracles" / "lens_vectors.json"
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
    about, camera = find_widest_example(model)
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
        f"In the picture: `{camera.param_names}`, up to {measure_seen_angle(camera):.0f} degrees "
        f"off-axis; one-to-one up to {largest:.0f}."
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
        "[Which lens do I have?](which-lens.md)\nhelps to choose, and `gsut camera find` looks up "
        "a camera by its name:\n\n```bash\ngsut camera find hero9 max wide\n```\n\n"
        "Below the table stands the comment at the top of each lens' file in "
        "`cpp/gsut/cameras/models`.\n\n"
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


PAGES = {"lenses.md": lenses_page, "cli.md": cli_page, "api.md": make_index}


def page(name: str) -> str:
    """The text of a generated page."""
    return re.sub(r"\n{3,}", "\n\n", PAGES[name]()).rstrip() + "\n"


def write_demo_page() -> None:
    """Writes docs/demo.html from the scene of `./run demo`, if there is one."""
    run, out = ROOT / "demo" / "run", ROOT / "docs" / "demo.html"
    if run.is_dir():
        out.unlink(missing_ok=True)
        gsut_main(["convert", str(run), str(out)])
    else:
        print("docs/demo.html needs the demo's scene: ./run demo, then ./run docs")


def main() -> None:
    for name in PAGES:
        (ROOT / "docs" / name).write_text(page(name), encoding="utf-8")
    readme = ROOT / "README.md"
    readme.write_text(write_readme(readme.read_text(encoding="utf-8")), encoding="utf-8")
    write_demo_page()


if __name__ == "__main__":
    main()
