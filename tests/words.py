"""Checks names, docstrings, comments and constants against the style guide, room by room.

`python tests/words.py [PATH...]` prints each finding as path:line: kind: text.
"""

import ast
import collections
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("python/gsut", "python/bindings", "cpp/gsut", "calib")

# Verbs that a function's name may begin with; its docstring begins with the third person.
VERBS = set((ROOT / "tests/verbs.txt").read_text("utf-8").split())
# A function may also be a question, a conversion or a named constructor ...
PREFIXES = {"is", "has", "are", "can", "to", "from", "as", "with", "without", "needs", "main", "on"}
# ... or carry the field's own name of a quantity: `psnr`, `world_from_camera`.
QUANTITIES = {"psnr", "ssim", "slerp", "logit", "sigmoid", "exp", "log"}

# Words that make a sentence a riddle; most stand for a plain one.
BANNED = (
    r"fore?told|tells?|telling|untold|told",
    r"so many|so much|so long as|as many as|many a",
    r"asked for|asks? for|meanwhile|begun|thereof|whereof|therein|wherein|hitherto",
    r"worth a word|'s word\b|by the word",
    r"where it stands|goes on where|stands for all|as it was given",
    r"foreseen|unforeseen|betwixt|lest",
)
BANNED_RE = re.compile(r"\b(?:" + "|".join(BANNED) + r")", re.IGNORECASE)
DATA_RE = re.compile(r"\b(?:sponza\w*|fox|helmet|karma|kitti-\d+)\b|\d dB\b", re.IGNORECASE)
FILE_RE = re.compile(r"(?<![\w.*{<-])(?:[\w-]+/)*[\w-]{3,}\.(?:py|h|cpp|inc|md)\b(?![*\w(-])")
FOREIGN_FILES = {"conf.py", "setup.py", "readme.md"}  # not of this tree


class Finding(NamedTuple):
    """One place that breaks a rule of the style guide."""

    path: str
    line: int
    kind: str
    text: str


def third_person(verb: str) -> str:
    """Returns the third person singular of a verb."""
    if verb in {"do", "go"} or re.search(r"(?:s|x|z|ch|sh)$", verb):
        return verb + "es"
    if re.search(r"[^aeiou]y$", verb):
        return verb[:-1] + "ies"
    return verb + "s"


OPENINGS = {third_person(verb) for verb in VERBS} | {"has", "is"}


def is_property(node: ast.FunctionDef) -> bool:
    """Returns whether a method is read like an attribute."""
    words = {ast.unparse(d).split("(")[0].split(".")[-1] for d in node.decorator_list}
    return bool(words & {"property", "cached_property", "setter", "fixture", "contextmanager"})


def check_name(name: str) -> bool:
    """Returns whether a function's name begins with a verb or a known prefix."""
    if name.startswith("__"):
        return True
    words = name.strip("_").split("_")
    return words[0] in VERBS | PREFIXES or "from" in words[1:-1] or bool(QUANTITIES & set(words))


def check_functions(path: str, tree: ast.Module) -> Iterator[Finding]:
    """Yields names without a verb and docstrings that do not begin with one."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if not is_property(node) and not check_name(node.name):
            yield Finding(path, node.lineno, "name", node.name)
        text = ast.get_docstring(node)
        if text is None:
            continue
        word = re.split(r"[^\w'-]", text.strip())[0]
        plain = word.lower()
        allowed = {"a", "an", "the"} if is_property(node) else set()
        if plain not in OPENINGS | allowed and not (is_property(node) and len(text) < 60):
            yield Finding(path, node.lineno, "docstring", text.splitlines()[0])


def check_constants(path: str, tree: ast.Module) -> Iterator[Finding]:
    """Yields assignments that give several constants on one line."""
    bodies = [tree.body] + [n.body for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    for node in (statement for body in bodies for statement in body):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            names = [e.id for e in node.targets[0].elts if isinstance(e, ast.Name)]
            if names and all(name.upper() == name for name in names):
                yield Finding(path, node.lineno, "packed constants", ", ".join(names))


def python_texts(source: str) -> Iterator[tuple[int, str]]:
    """Yields (line, text) of each comment and string."""
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", -1)}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in kinds:
            for offset, text in enumerate(token.string.splitlines()):
                yield token.start[0] + offset, text


def cpp_texts(source: str) -> Iterator[tuple[int, str]]:
    """Yields (line, text) of each comment and string."""
    for number, line in enumerate(source.splitlines(), 1):
        if match := re.search(r"//(.*)", line):
            yield number, match.group(1)
        for text in re.findall(r'"((?:[^"\\]|\\.)*)"', re.sub(r"//.*|#\s*include.*", "", line)):
            yield number, text


def check_words(path: str, texts: Iterator[tuple[int, str]], known: set[str]) -> Iterator[Finding]:
    """Yields banned words, data sets by name, figures in dB and files that do not exist."""
    for line, text in texts:
        if match := BANNED_RE.search(text):
            yield Finding(path, line, "banned word", f"{match.group(0)!r} in {text.strip()[:90]}")
        if match := DATA_RE.search(text):
            yield Finding(path, line, "history", f"{match.group(0)!r} in {text.strip()[:90]}")
        for name in FILE_RE.findall(text) if text.lstrip().startswith(("#", "//", " ")) else ():
            if name.lower() not in FOREIGN_FILES and not any(f.endswith("/" + name) for f in known):
                yield Finding(path, line, "missing file", name)


def check_cpp_constants(path: str, source: str) -> Iterator[Finding]:
    """Yields declarations that give several constants on one line."""
    for number, line in enumerate(source.splitlines(), 1):
        if re.match(r"\s*(?:inline |static )*constexpr [\w:]+ k\w+ = [^;{(]+, k\w+ =", line):
            yield Finding(path, number, "packed constants", line.strip())


def list_sources() -> list[Path]:
    """Returns every source file of the product, sorted."""
    endings = {".py", ".h", ".cpp", ".inc"}
    return sorted(p for f in FOLDERS for p in (ROOT / f).rglob("*") if p.suffix in endings)


def list_kernels() -> dict[str, list[Path]]:
    """Returns the sources whose share of comments counts, by room: .cpp and -inl.h files."""
    rooms = collections.defaultdict(list)
    for path in list_sources():
        if path.suffix == ".cpp" or path.name.endswith("-inl.h"):
            rooms[room_of(str(path.relative_to(ROOT)))].append(path)
    return rooms


def find_all() -> list[Finding]:
    """Returns every finding in the product's sources."""
    known = {"/" + str(p.relative_to(ROOT)) for p in ROOT.glob("*") if p.is_file()}
    for folder in ("python", "cpp", "calib", "tests", "lab", "docs", ".ci"):
        known |= {"/" + str(p.relative_to(ROOT)) for p in (ROOT / folder).rglob("*")}
    found: list[Finding] = []
    for source in list_sources():
        path, text = str(source.relative_to(ROOT)), source.read_text("utf-8")
        if source.suffix == ".py":
            tree = ast.parse(text)
            found += [*check_functions(path, tree), *check_constants(path, tree)]
            found += check_words(path, python_texts(text), known)
        else:
            found += check_words(path, cpp_texts(text), known)
            found += check_cpp_constants(path, text)
    return found


def room_of(path: str) -> str:
    """Returns the room of a file: the folder under its source tree."""
    parts = Path(path).parts
    return "/".join(parts[:3]) if len(parts) > 3 else "/".join(parts[:-1])


def comment_share(paths: list[Path]) -> float:
    """Returns the share of lines that hold nothing but a comment."""
    lines = [line.strip() for path in paths for line in path.read_text().splitlines()]
    return sum(line.startswith("//") for line in lines) / max(len(lines), 1)


def main(arguments: list[str]) -> int:
    """Prints the findings below the paths given; returns 1 if there are any."""
    found = [f for f in find_all() if not arguments or f.path.startswith(tuple(arguments))]
    for finding in found:
        print(f"{finding.path}:{finding.line}: {finding.kind}: {finding.text}")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
