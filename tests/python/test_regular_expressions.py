"""Regular expressions of the code against long runs: each search takes linear time."""

import ast
import itertools
import re
import signal
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LENGTH = 100_000
SECONDS = 1.0  # of a search; those that are not linear take minutes
RUNS = " \t\n0a(#-=./_", (" \n", "a ", "0 ", "a0", "a.", "=\n", ": ", "\n0")
# What may stand before a run, beside the beginnings of what a pattern accepts.
STARTS = ("", "1", "a", "#", "# a", "a=", '"key', ": '", "latitude", "00:00:00,000 -->", "/image")
CALLS = ("compile", "search", "match", "fullmatch", "sub", "split", "findall", "finditer")


def _list_patterns():
    """Yields place and compiled pattern of each call of `re` whose pattern the code states."""
    for folder in ("python/gsut", "calib", "lab"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                    continue
                of, name = node.func.value, node.func.attr
                if not (isinstance(of, ast.Name) and of.id == "re" and name in CALLS):
                    continue
                stated = _read_text(node.args[0])
                if stated is None:
                    continue
                given = [*node.args[1:], *(keyword.value for keyword in node.keywords)]
                names = [each.attr for tree in given for each in ast.walk(tree)
                         if isinstance(each, ast.Attribute) and each.attr.isupper()]  # fmt: skip
                flags = re.NOFLAG
                for each in names:
                    flags |= getattr(re, each, re.NOFLAG)
                yield f"{path.relative_to(ROOT)}:{node.lineno}", re.compile(stated, flags)


def _read_text(node):
    """Returns the pattern of a node; a name in it stands for the word "key"."""
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(p.value) if isinstance(p, ast.Constant) else "key" for p in node.values)
    return None


PATTERNS = dict(_list_patterns())


def _list_texts():
    pieces = [*RUNS[0], *RUNS[1], "/image", "iPhone ", ": 'a", "a.cpp"]
    for start, piece in [*itertools.product(("",), pieces), *itertools.product(STARTS, " \n0a")]:
        run = piece * (LENGTH // len(piece))
        yield from (start + run, start + run + "!")


TEXTS = list(_list_texts())


class _TooLongError(Exception):
    pass


def _stop(*_):
    raise _TooLongError


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="a timer of POSIX")
@pytest.mark.parametrize("place", PATTERNS)
def test_search_of_a_long_run_takes_linear_time(place):
    pattern = PATTERNS[place]
    before = signal.signal(signal.SIGPROF, _stop)
    try:
        for text in TEXTS:
            given = text.encode() if isinstance(pattern.pattern, bytes) else text
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            for _ in pattern.finditer(given):
                pass
            pattern.match(given)
            signal.setitimer(signal.ITIMER_PROF, 0)
    except _TooLongError:
        pytest.fail(f"{pattern.pattern!r} takes long over {text[:20]!r}... {text[-3:]!r}")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def test_patterns_of_the_code_are_found():
    assert len(PATTERNS) > 25
