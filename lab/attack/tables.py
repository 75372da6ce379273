"""Lists the cases of the attack from tables: damaged files, flags, places, strange things."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gsut.cli import main
from lab.attack.damage import CAUSES, TO_ANY_FILE, TO_TEXT, Damage
from lab.attack.flags import BASES, list_flag_cases
from lab.attack.harness import Case, Spoil
from lab.attack.places import FILES, FOLDERS, list_place_cases
from lab.attack.queries import list_query_cases
from lab.attack.rigs import list_rig_cases
from lab.attack.strange import list_strange_cases
from lab.attack.world import LENSES, SCENES
from small_videos import (
    damage_packets,
    encode_film,
    stretch_second_half,
    texture,
    view,
    write_video,
)

# Of a run: the files that the command reads, whose damage must be reported.
OF_RUN: dict[tuple[str, ...], tuple[str, ...]] = {
    ("eval", "run"): ("options.json", "environment.json", "scene.ply"),
    ("render", "run", "-o", "out", "--frames", "1", "--size", "16x16"):
        ("options.json", "environment.json", "scene.ply"),
    ("convert", "run", "out.spz"): ("scene.ply",),
    ("edit", "run", "-o", "out.ply", "--scale", "2"): ("scene.ply",),
    ("compact", "run", "-o", "out", "--keep", "0.5", "--method", "lightgaussian"):
        ("options.json", "environment.json", "scene.ply"),
    ("mesh", "run", "-o", "out.ply"): ("options.json", "environment.json", "scene.ply"),
    ("measure", "run", "--point", "0", "0", "0", "--point", "1", "0", "0"):
        ("options.json", "environment.json", "scene.ply"),
    ("localize", "ds/images/003.png", "--run", "run"):
        ("options.json", "environment.json", "scene.ply"),
    ("train", "ds", "-o", "run", "--resume", "--quiet"): ("options.json", "checkpoint.npz"),
    ("data", "convert", "run", "out"): ("options.json", "environment.json"),
}  # fmt: skip
# What is no file of a run is none of its.
ABSENT = "absent|does not exist|holds no run|does not say which dataset|no dataset found"
# Files that do not say how long they are or what they hold.
HEADLESS = {
    ("positions.csv", "cut in half"),
    ("f.splat", "cut in half"),
    ("f.splat", "noise"),
    ("02.png", "missing"),
}  # a folder of photographs is what is in it
TEXTS = (".json", ".yaml", ".txt", ".xml", ".csv", ".cameramodel", ".jsonl")


def list_damages(name: str) -> dict[str, Callable[[Path], object]]:
    """Lists what may happen to a file."""
    return TO_ANY_FILE | (TO_TEXT if name.endswith(TEXTS) else {})


def spoil_file(name: str, damage: Callable[[Path], object]) -> Spoil:
    return lambda folder: damage(folder / name)


def match_name(path: str) -> str:
    return re.escape(Path(path).name)


def list_file_cases() -> Iterator[Case]:
    """Lists damage to every file that a command is given or finds."""
    singles: list[tuple[str, str, tuple[str, ...]]] = [
        *(("lens", f"lenses/{n}", ("camera", "convert", f"lenses/{n}", "pinhole")) for n in LENSES),
        *(("scene", f"scenes/{n}", ("convert", f"scenes/{n}", "out.ply")) for n in SCENES),
        ("scene", "scenes/a.ply", ("edit", "scenes/a.ply", "-o", "out.ply", "--scale", "2")),
        ("scene", "scenes/a.ply", ("compact", "scenes/a.ply", "-o", "out.ply", "--keep", "0.5")),
        ("scene", "scenes/a.ply", ("render", "scenes/a.ply", "-o", "out", "--frames", "1")),
        ("scene", "scenes/a.ply", ("view", "scenes/a.ply", "--serve", "127.0.0.1:0")),
        ("scene", "scenes/a.ply", ("measure", "scenes/a.ply", "--point", "0", "0", "0",
                                   "--point", "1", "0", "0")),
        ("table", "path.json", ("render", "scenes/a.ply", "-o", "out", "--path", "path.json",
                                "--size", "16x16")),
        ("table", "lenses/opencv.yaml", ("render", "scenes/a.ply", "-o", "out", "--camera",
                                         "lenses/opencv.yaml", "--frames", "1")),
        ("table", "positions.csv", ("edit", "run", "-o", "out.ply", "--positions",
                                    "positions.csv")),
        ("table", "photo.png", ("localize", "photo.png", "--run", "run")),
        ("table", "lens48.json", ("localize", "photo.png", "--run", "run", "--camera",
                                  "lens48.json")),
        ("table", "rig.yaml", ("poses", "folder", "-o", "out", "--rig", "rig.yaml")),
        ("table", "lens320.json", ("poses", "film.mp4", "-o", "out", "--quiet", "--camera",
                                   "lens320.json")),
        ("film", "film.mp4", ("poses", "film.mp4", "-o", "out", "--quiet")),
        ("film", "film.mp4", ("scene", "film.mp4", "-o", "out", "--quiet")),
        ("board", "boards/02.png", ("calibrate", "boards", "--board", "5x4", "--spacing", "0.05",
                                    "--lens", "fisheye", "--solver", "opencv", "-o", "out.yaml")),
        ("blocks", "blocks/blocks/plan.json", ("train", "ds", "-o", "blocks", "--resume",
                                               "--quiet")),
    ]  # fmt: skip
    for kind, file, words in singles:
        needs = [file, *_find_needs(words)]
        for name, damage in list_damages(file).items():
            yield Case(
                kind, f"{Path(file).name} is {name}", words, tuple(dict.fromkeys(needs)),
                spoil_file(file, damage), (match_name(file), CAUSES.get(name, "")),
                may_pass=(Path(file).name, name) in HEADLESS,
                keeps=("out",) if words[0] == "scene" else (),
            )  # fmt: skip
    for words, files in OF_RUN.items():
        for file in files:
            for name, damage in list_damages(file).items():
                if file == "checkpoint.npz" and name in CAUSES:
                    continue  # none yet: it begins anew
                yield Case(
                    "run", f"{file} is {name}", words, ("ds", "run"),
                    spoil_file(f"run/{file}", damage),
                    (match_name(file) + r"|\brun\b", f"{CAUSES[name]}|{ABSENT}" if name in CAUSES
                     else ""),
                )  # fmt: skip


def list_film_cases() -> Iterator[Case]:
    """Lists films that can be used in part, or that do not say of themselves what they are."""
    walk = "walk.mp4"  # of 40 frames
    rows: dict[str, tuple[Spoil, str]] = {
        "damaged inside": (
            lambda folder: damage_packets(folder / walk, folder / walk, (14, 15)),
            "frames of walk.mp4 .* damaged",
        ),
        "pasted from two": (
            lambda folder: (folder / walk).write_bytes(2 * (folder / walk).read_bytes()),
            "walk.mp4 is 2 films pasted together, of which the first is read",
        ),
        "cut to another place": (
            lambda folder: write_video(folder / walk, draw_places()), "walk.mp4 is cut at"
        ),
        "of a variable rate": (lambda folder: stretch_second_half(folder / walk), ""),
        "interlaced": (
            lambda folder: encode_film(folder / walk, "libx264", draw_walk(), flags="+ilme+ildct"),
            "frames of walk.mp4 are interlaced",
        ),
    }  # fmt: skip
    for name, (spoil, noted) in rows.items():
        words = ("poses", walk, "-o", "out", "--camera", "lens320.json")
        yield Case("film", f"{walk} is {name}", words, (walk, "lens320.json"), spoil,
                   ("nothing fails",), True, noted)  # fmt: skip


def draw_walk() -> Iterator[np.ndarray]:
    return (view(texture(), 50 + 6.0 * i) for i in range(30))


def draw_places() -> Iterator[np.ndarray]:
    """Draws a walk past one place, and on past another."""
    for ground in (texture(), texture()[::-1, ::-1].copy()):
        yield from (view(ground, 50 + 6.0 * i) for i in range(30))


def list_stage_cases() -> Iterator[Case]:
    """Lists damage to what a command wrote to go on from."""
    words = ("poses", "film.mp4", "-o", "out", "--camera", "lens320.json", "--quiet")

    def make(file: str, damage: Damage) -> Spoil:
        def spoil(folder: Path) -> None:
            with contextlib.redirect_stdout(io.StringIO()):
                assert main(list(words)) == 0, "the attack's own poses cannot be found"
            damage(folder / "out" / file)

        return spoil

    for file in ("capture/capture.json", "poses.json"):
        for name in ("empty", "cut in half", "noise", "one line of text"):
            yield Case(
                "stage", f"{file} is {name}", words, ("film.mp4", "lens320.json"),
                make(file, TO_ANY_FILE[name]), (match_name(file), "remove"),
            )  # fmt: skip


def list_base_cases(spoiled: list[Case]) -> Iterator[Case]:
    """Lists every command before its input is spoiled: it must end well, or the rest means nothing.

    Left out: those that take minutes or wait, and a rig whose folder has no photographs of
    it, where the rig's file must at least be read."""
    bases = {case.words: case.needs for case in spoiled}
    for command, (words, needs) in BASES.items():
        bases[(*command.split(), *words)] = needs
    for words, needs in (FILES | FOLDERS).items():
        bases[tuple(word.replace("OUT", "out") for word in words)] = needs
    for words, needs in bases.items():
        if "--rig" in words:
            yield Case("base", "as it is", words, needs, said=("folder",))
        elif words[0] not in ("demo", "scene", "view"):
            keeps = ("blocks/blocks/stages",) if "blocks" in words else ()  # a run that goes on
            yield Case("base", "as it is", words, needs, None, ("nothing fails",), True, "", keeps)


def _find_needs(words: tuple[str, ...]) -> list[str]:
    known = ("scenes/a.ply", "ds", "run", "folder", "photo.png", "film.mp4", "boards", "blocks")
    found = [each for each in known if any(w == each or w.startswith(each + "/") for w in words)]
    return ["ds", *found] if "run" in found else found


def list_cases() -> list[Case]:
    """Lists all cases but those of datasets."""
    files = list(list_file_cases())
    return [
        *list_base_cases(files),
        *files,
        *list_film_cases(),
        *list_stage_cases(),
        *list_rig_cases(),
        *list_flag_cases(),
        *list_place_cases(),
        *list_query_cases(),
        *list_strange_cases(),
    ]
