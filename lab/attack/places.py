"""Has every command write to places where none may write, and to odd names that are allowed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from lab.attack.harness import Case

# What writes one file, and what writes a folder; OUT is where.
FILES: dict[tuple[str, ...], tuple[str, ...]] = {
    ("convert", "scenes/a.ply", "OUT.spz"): ("scenes/a.ply",),
    ("convert", "scenes/a.ply", "OUT.html"): ("scenes/a.ply",),
    ("edit", "scenes/a.ply", "-o", "OUT.ply", "--scale", "2"): ("scenes/a.ply",),
    ("compact", "scenes/a.ply", "-o", "OUT.ply", "--keep", "0.5"): ("scenes/a.ply",),
    ("render", "scenes/a.ply", "-o", "OUT.mp4", "--frames", "1", "--size", "32x32"):
        ("scenes/a.ply",),
    ("camera", "convert", "lenses/opencv.yaml", "pinhole", "-o", "OUT.json"):
        ("lenses/opencv.yaml",),
    ("mesh", "run", "-o", "OUT.ply"): ("ds", "run"),
    ("data", "convert", "plane", "OUT.txt"): ("plane",),
}  # fmt: skip
FOLDERS: dict[tuple[str, ...], tuple[str, ...]] = {
    ("train", "ds", "-o", "OUT", "--steps", "2", "--quiet"): ("ds",),
    ("eval", "run", "-o", "OUT"): ("ds", "run"),
    ("render", "scenes/a.ply", "-o", "OUT", "--frames", "1", "--size", "32x32"):
        ("scenes/a.ply",),
    ("compact", "run", "-o", "OUT", "--keep", "0.5", "--method", "lightgaussian"): ("ds", "run"),
    ("data", "convert", "plane", "OUT"): ("plane",),
    ("poses", "film.mp4", "-o", "OUT", "--camera", "lens320.json", "--quiet"):
        ("film.mp4", "lens320.json"),
    ("scene", "film.mp4", "-o", "OUT", "--quiet"): ("film.mp4",),
    ("demo", "--no-open", "-o", "OUT", "--steps", "1"): (),
}  # fmt: skip
Prepare = Callable[[Path], object]


def make(path: str, content: bytes | None = b"mine\n") -> Prepare:
    """A file, or a folder where there is no content, in the scratch folder."""

    def prepare(folder: Path) -> None:
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.mkdir() if content is None else target.write_bytes(content)

    return prepare


def make_link(path: str, target: str) -> Prepare:
    return lambda folder: (folder / path).symlink_to(target)


# Name -> (what stands for OUT, what lies there before, what must be said).
REFUSED_FILES: dict[str, tuple[str, Prepare | None, str]] = {
    "below a file": ("mine/out", make("mine"), "mine|out"),
    "a folder": ("out", lambda folder: [
        (folder / f"out{s}").mkdir() for s in (".spz", ".html", ".ply", ".mp4", ".json", ".txt")],
        "out"),
    "a name of 300 letters": ("o" * 300, None, "ooo"),
    "a folder without end": ("loop/out", make_link("loop", "loop"), "loop|out"),
    "a pipe": ("out", lambda folder: [
        os.mkfifo(folder / f"out{s}") for s in (".spz", ".html", ".ply", ".mp4", ".json", ".txt")],
        "out"),
}  # fmt: skip
REFUSED_FOLDERS: dict[str, tuple[str, Prepare | None, str]] = {
    "a file": ("out", make("out"), "out"),
    "someone's folder": ("out", make("out/thesis.tex"), "out"),
    "someone's run": ("out", make("out/scene.ply"), "out"),
    "a folder of hidden files": ("out", make("out/.git/config"), "out"),
    "below a file": ("mine/out", make("mine"), "mine|out"),
    "nothing": ("", None, "empty|name"),
    "here": (".", make("mine"), r"\.|folder"),
    "a link to nothing": ("out", make_link("out", "nowhere"), "out"),
    "a link to itself": ("out", make_link("out", "out"), "out"),
    "a name of 300 letters": ("o" * 300, None, "ooo"),
    "a name of a film": ("out.mp4", None, r"out\.mp4"),
    "a pipe": ("out", lambda folder: os.mkfifo(folder / "out"), "out"),
    "a device": ("/dev/null", None, "/dev/null"),
    "the system's": ("/proc/gsut", None, "/proc/gsut"),
}
ODD_NAMES = (
    "a b'\"$(c);&",
    "--out",
    "naïve 写真",
    os.fsdecode(b"caf\xe9"),
    "new\nline",
    "~",
    "a/b/c",
)

ADDRESSES = ("http:a", "concat:a|b", "pipe:", "file:a")  # which FFmpeg takes for no file's names


def rename_film(name: str) -> Prepare:
    def prepare(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "film.mp4").rename(folder / name)

    return prepare


def list_place_cases() -> Iterator[Case]:
    """Lists every command that writes, with every place."""
    for commands, rows in ((FILES, REFUSED_FILES), (FOLDERS, REFUSED_FOLDERS)):
        for words, needs in commands.items():
            for name, (out, prepare, said) in rows.items():
                if (words[0], name) == ("render", "a name of a film"):
                    continue  # which is a film
                if words[0] == "demo" and name in ("someone's folder", "a folder of hidden files",
                                                   "someone's run", "here"):  # fmt: skip
                    continue  # its folders stand beside what is there
                given = tuple(word.replace("OUT", out) for word in words)
                yield Case("place", f"{name}", given, needs, prepare, (said,))
    for words, needs in FILES.items():
        if words[0] in ("convert", "edit", "camera"):
            for name in ODD_NAMES:
                given = tuple(
                    f"--out={word.replace('OUT', name)}" if before == "-o"
                    else "" if word == "-o" else word.replace("OUT", f"./{name}")
                    for before, word in zip(("", *words), words, strict=False)
                )  # fmt: skip
                yield Case(
                    "name", f"{name!r}", tuple(w for w in given if w), needs, make("a/b/x"),
                    may_pass=True,
                )  # fmt: skip
    for name in (*(each for each in ODD_NAMES if each != "~"), *ADDRESSES):
        words = ("poses", f"./{name}.mp4", "-o", "out", "--camera", "lens320.json", "--quiet")
        if ":" in name:
            words = (words[0], f"{name}.mp4", *words[2:])
        yield Case(
            "name", f"a film called {name!r}", words, ("film.mp4", "lens320.json"),
            rename_film(f"{name}.mp4"), ("nothing fails",), True,
        )  # fmt: skip
