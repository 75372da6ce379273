"""Tolerances: no name twice, none unused."""

import ast
import collections
import re
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
AREAS = sorted((TESTS / "tolerances").glob("[!_]*.py"))


def defined() -> list[str]:
    """Every name that tests/tolerances assigns, as often as it does."""
    nodes = [node for path in AREAS for node in ast.parse(path.read_text()).body]
    targets = [target for node in nodes if isinstance(node, ast.Assign) for target in node.targets]
    return [target.id for target in targets if isinstance(target, ast.Name)]


def test_no_tolerance_is_named_twice():
    assert len(defined()) >= 200
    assert [name for name, count in collections.Counter(defined()).items() if count > 1] == []


def test_no_tolerance_is_unused():
    text = "\n".join(path.read_text() for path in TESTS.rglob("*.py") if path not in AREAS)
    # One tolerance may be derived from another.
    text += "\n".join(re.findall(r" = (.*)", "\n".join(path.read_text() for path in AREAS)))
    used = set(re.findall(r"[A-Z][A-Z0-9_]+", text))
    assert [name for name in defined() if name not in used] == []
