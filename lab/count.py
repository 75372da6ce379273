"""Counts what the house holds: lines by room, options, tuned constants, words of docs.

lab/run count [TREE]    TREE: another checkout [default: this one]
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

TEXT = {*(".py", ".pyi", ".h", ".cpp", ".inc", ".js", ".html", ".css", ".wgsl", ".txt")}
GENERATED = {"cli.md", "api.md", "lenses.md"}  # pages written by ./run docs


def count_lines(*folders: Path) -> int:
    """Returns the number of lines of all text files in `folders`, blank ones included."""
    files = [f for folder in folders for f in folder.rglob("*") if f.suffix in TEXT]
    return sum(file.read_bytes().count(b"\n") for file in files)


def is_number(node: ast.expr) -> bool:
    """Returns whether an expression is made of numbers alone, such as 3, -1e-3 or 2**20."""
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def count_constants(*folders: Path) -> int:
    """Returns the number of module-level names in `folders` that stand for one number."""
    total = 0
    for file in (f for folder in folders for f in folder.rglob("*.py")):
        for node in ast.parse(file.read_text("utf-8")).body:
            value = node.value if isinstance(node, (ast.Assign, ast.AnnAssign)) else None
            total += value is not None and is_number(value)
    return total


def list_counts(root: Path) -> list[tuple[str, int]]:
    """Lists what the tree at `root` holds: rooms first, then sums and other counts."""
    rooms = [
        room
        for folder in (root / "python/gsut", root / "cpp/gsut")
        for room in sorted(folder.iterdir())
        if room.is_dir() and room.name != "__pycache__"
    ]
    counts = [(str(room.relative_to(root)), count_lines(room)) for room in rooms]
    pages = [page for page in (root / "docs").glob("*.md") if page.name not in GENERATED]
    options = re.findall(r"(?m)^\| `", (root / "docs/cli.md").read_text("utf-8"))
    return [
        *counts,
        ("python/gsut", count_lines(root / "python/gsut")),
        ("cpp/gsut and bindings", count_lines(root / "cpp/gsut", root / "python/bindings")),
        ("tests", count_lines(root / "tests")),
        ("lab, without its notebook", count_lines(root / "lab")),
        ("rows of options in docs/cli.md", len(options)),
        ("numeric constants of modules", count_constants(root / "python/gsut", root / "calib")),
        ("words of docs by hand", sum(len(page.read_text("utf-8").split()) for page in pages)),
    ]


if __name__ == "__main__":
    tree = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]
    for name, number in list_counts(tree):
        print(f"{number:8,}  {name}")
