"""The pages: generated ones are current, code runs, commands parse, links lead somewhere."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import gsut
import tolerances
from demo_hall import write_hall
from generate import PAGES, ROOT, page
from gsut.cli import build_parser, list_commands, main
from public_names import list_public_names
from readme_figures import write_readme
from tests.bench.__main__ import build_parser as bench_parser

READMES = [ROOT / folder / "README.md" for folder in (".", "calib", "tests/bench", "lab")]
PAGE_FILES = [
    *READMES,
    *(ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"),
    *sorted((ROOT / "docs").glob("*.md")),
]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
NOT_RUN = "<!-- not run:"  # and the reason, on the line before the block
ONES_OF_RUN = {
    script: set(re.findall(r"^  ([a-z]+) ", (ROOT / script).read_text(), re.MULTILINE))
    for script in ("run", "lab/run")
}


class Block(NamedTuple):
    page: str
    line: int
    language: str
    runs: bool
    text: str


def blocks() -> list[Block]:
    found = []
    for path in PAGE_FILES:
        lines = path.read_text().splitlines()
        begin = None
        for number, line in enumerate(lines):
            if line.startswith("```") and begin is None:
                begin = number
            elif line.startswith("```"):
                language = lines[begin][3:].strip()
                runs = not lines[max(0, begin - 1)].startswith(NOT_RUN)
                text = "\n".join(lines[begin + 1 : number]) + "\n"
                found.append(Block(path.name, begin + 1, language, runs, text))
                begin = None
        assert begin is None, f"{path}: a block of code does not end"
    return found


def of(language: str, *, runs: bool | None = None) -> list[Block]:
    return [b for b in blocks() if b.language == language and runs in (None, b.runs)]


def label(block: Block) -> str:
    return f"{block.page}:{block.line}"


def commands(block: Block) -> list[list[str]]:
    """The words of each line of a shell block."""
    text = block.text.replace("\\\n", " ")
    return [words for line in text.splitlines() if (words := shlex.split(line, comments=True))]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """A folder with what the pages name: DATA, a small dataset; RUN, trained on it; a lens file."""
    folder = tmp_path_factory.mktemp("docs")
    write_hall(folder / "DATA", views=8, test_views=2, size=48)
    scene = gsut.load_dataset(folder / "DATA")
    options = gsut.TrainOptions(steps=20, max_gaussians=800)
    gsut.train(scene, options, out=folder / "RUN", progress=False)
    gsut.save_camera(scene.camera(0), folder / "fisheye.yaml")
    return folder


@pytest.mark.parametrize("block", of("python", runs=True), ids=label)
def test_python_of_the_pages_runs(block, data, monkeypatch):
    monkeypatch.chdir(data)
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(block.text, label(block), "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_of_a_task_runs(path, data, monkeypatch):
    if NOT_RUN in (text := path.read_text()):
        pytest.skip("its docstring says why")
    monkeypatch.chdir(data)
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(text, str(path), "exec"), {"__name__": "__main__"})


def test_readme_has_the_figures_of_the_tables():
    text = READMES[0].read_text()
    assert text == write_readme(text), "./run docs renews it"
    assert text.count("<!-- figures: ") == 2


def test_the_readmes_snippet_gives_the_psnr_that_eval_gives(data, monkeypatch, capsys):
    monkeypatch.chdir(data)
    found: dict = {}
    snippet = next(
        b
        for b in of("python", runs=True)
        if 'load_gaussians("RUN/scene.ply")' in b.text and "background=None" in b.text
    )
    assert snippet.page == "README.md"
    exec(snippet.text, found)
    scene = found["scene"]
    photograph = scene.image(0).astype(np.float32) / 255
    psnr = gsut.psnr(np.clip(found["rendered"].image, 0, 1), photograph, scene.mask(0))
    assert main(["eval", "RUN", "--split", "all", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["views"]
    wanted = next(row["psnr"] for row in rows if row["name"] == scene.views[0].name)
    assert abs(psnr - wanted) < tolerances.SAME_FRAME_DB


def is_public(name: str) -> bool:
    """Whether gsut has this name, or one of its submodules has it ("edit.merge_gaussians")."""
    module, _, short = f"gsut.{name}".rpartition(".")
    public = list_public_names()
    return short in public.get(module, ()) or f"gsut.{name}" in public or is_public_member(name)


def is_public_member(name: str) -> bool:
    """Whether a name continues a public one: `TrainOptions.resolve`."""
    first, _, rest = name.partition(".")
    return bool(rest) and first in gsut.__all__ and hasattr(getattr(gsut, first), rest)


@pytest.mark.parametrize("block", of("python", runs=False), ids=label)
def test_python_that_is_not_run_uses_public_names(block):
    compile(block.text, label(block), "exec")
    names = re.findall(r"(?<!from )\bgsut\.([\w.]+)", block.text)
    assert names and [name for name in names if not is_public(name)] == []


@pytest.mark.parametrize("block", of("bash"), ids=label)
def test_commands_of_the_pages_parse(block):
    parser = build_parser()
    for name, *words in commands(block):
        if Path(name).name == "gsut":
            parser.parse_args(words)
        elif [name, *words[:1]] == ["./run", "bench"]:
            bench_parser().parse_args(words[1:])
        elif name.endswith("run"):
            assert words[0] in ONES_OF_RUN[name.removeprefix("./")]
        else:
            assert name in ("pip", "cmake", "sudo"), f"{label(block)} calls {name}"


@pytest.mark.parametrize("block", of("bash", runs=True), ids=label)
def test_commands_of_the_pages_run(block, data, monkeypatch, capsys):
    monkeypatch.chdir(data)
    for name, *words in commands(block):
        assert Path(name).name == "gsut"
        assert main(words) == 0, capsys.readouterr().err


def test_training_loop_fits_forty_lines():
    (block,) = (b for b in of("python") if b.page == "training-loop.md")
    assert len(block.text.splitlines()) <= 40


def test_calls_of_the_commands_are_public_names():
    text = (ROOT / "docs" / "python.md").read_text()
    names = re.findall(r"`gsut\.([\w.]+)", text)
    wrong = [name for name in names if not is_public(name) and not name.startswith("cli")]
    assert len(names) >= 15 and wrong == []


def test_every_command_has_its_call_or_is_said_to_have_none():
    text = (ROOT / "docs" / "python.md").read_text().partition("## Each command as a call")[2]
    calls = set(re.findall(r"^\| `gsut (\w+)", text, re.MULTILINE))
    sentence = re.search(r"^(.*) are for people", text, re.MULTILINE)
    assert sentence is not None
    others = set(re.findall(r"`(\w+)`", sentence[1]))
    assert calls | others == set(list_commands()) and not calls & others


def test_blocks_were_found():
    assert len(of("python", runs=True)) >= 8 and len(of("bash")) >= 8
    assert {b.language for b in blocks()} <= {"bash", "cmake", "python", "text"}


@pytest.mark.parametrize("name", PAGES)
def test_generated_page_is_current(name):
    is_current = (ROOT / "docs" / name).read_text(encoding="utf-8") == page(name)
    assert is_current, "./run docs renews it"


def anchors(path: Path) -> set[str]:
    seen: Counter[str] = Counter()
    found = set()
    for heading in re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE):
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found.add(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
        seen[anchor] += 1
    return found


@pytest.mark.parametrize("path", PAGE_FILES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_links_lead_somewhere(path):
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", path.read_text()):
        if "://" in link:
            continue
        file, _, anchor = link.partition("#")
        target = path.parent / file if file else path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def test_architecture_names_every_folder():
    text = (ROOT / "docs" / "architecture.md").read_text()
    parts = [p for folder in ("python/gsut", "cpp/gsut") for p in (ROOT / folder).iterdir()]
    names = [p.name for p in parts if p.is_dir() or p.suffix == ".py"]
    names = [name for name in names if not name.startswith("_")]
    assert len(names) >= 20
    assert [name for name in names if f"`{name}`" not in text] == []


def test_every_lens_has_a_picture_and_every_page_is_linked():
    pictures = {path.stem for path in (ROOT / "docs" / "lenses").glob("*.jpg")}
    assert set(gsut.lens.camera_models()) <= pictures, "./run docs draws them"
    readme = READMES[0].read_text()
    pages = [path.name for path in PAGE_FILES if path.parent == ROOT / "docs"]
    assert [name for name in pages if f"docs/{name}" not in readme] == []
    shown = [line for line in readme.splitlines() if not line.startswith("<!--")]
    assert len(shown) <= 90


def test_table_of_lenses_in_the_readme_names_all_with_the_errors_that_tests_hold():
    rows = re.findall(
        r"^\|(.*)\|(.*)\|(.*)\|$", READMES[0].read_text().split("\n## ")[3], re.MULTILINE
    )[2:]
    named = {word for lenses, _, _ in rows for word in re.findall(r"\w+", lenses)}
    assert set(gsut.lens.camera_models()) <= named
    held = (ROOT / "tests" / "tolerances" / "lens.py").read_text()
    errors = [number for row in rows for number in re.findall(r"\d[\d.]*e-\d+", row[2])]
    assert len(errors) == len(rows) and [number for number in errors if number not in held] == []
