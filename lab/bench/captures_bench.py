"""`lab/run bench captures FOLDER ...`: what people bring through `gsut scene`, as table and page.

A capture is a film, a folder of photographs, or a folder that holds one of them; a folder of other
folders holds captures. README.md beside them may have a table with the columns Capture, Known and
Eye, whose words are shown beside what was found.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.capture.video import is_video
from gsut.data.images import IMAGE_SUFFIXES, decode_image
from gsut.files import write_file
from gsut.page import build_page, build_table, embed_picture, render_template
from tests.bench.commands import run_gsut
from tests.bench.harness import (
    Benchmark,
    Column,
    Option,
    Row,
    Settings,
    format_table,
    measure_rows,
)

HELP = "gsut scene of what people bring: a row a capture, and a page of held-out pairs"
_PAIRS = 3  # held-out views of a capture on the page, from the worst to the best
_MOST_WIDE = 420  # pixels of a picture on the page
_PICTURES = """<h2>{{ name }}</h2><p>{{ words }}</p><div style="display: flex; flex-wrap: wrap">
{%- for truth, render, caption in pairs %}<figure style="margin: 0 1em 1em 0">
<img src="{{ truth }}" alt="photograph"> <img src="{{ render }}" alt="render">
<figcaption>{{ caption }}</figcaption></figure>{% endfor %}</div>"""


def find_captures(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yields name and input of each capture at or below a path."""
    inner = sorted(folder.iterdir()) if folder.is_dir() else []
    films = [path for path in inner if is_video(path)]
    if is_video(folder):
        yield folder.stem, folder
    elif len(films) == 1:
        yield folder.name, films[0]
    elif (folder / "images").is_dir() or any(p.suffix.lower() in IMAGE_SUFFIXES for p in inner):
        yield folder.name, folder
    else:
        for path in inner:
            if path.is_dir():
                yield from find_captures(path)


def read_judgements(folder: Path) -> dict[str, dict[str, str]]:
    """Reads the tables of FOLDER/README.md: rows by the first word of their first cell."""
    readme = folder / "README.md"
    lines = readme.read_text("utf-8").splitlines() if readme.is_file() else []
    cells = [
        [cell.replace("**", "").strip(" `") for cell in line.strip("| ").split("|")]
        for line in lines
    ]
    heading = next((row for row in cells if row[0] == "Capture"), None)
    if heading is None:
        return {}
    rows = (dict(zip(heading, row, strict=False)) for row in cells if len(row) == len(heading))
    return {row["Capture"].split("/")[0].strip(" `"): row for row in rows}


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists captures with what is known of them."""
    for given in map(Path, settings.folders):
        said = read_judgements(given)
        for name, source in find_captures(given):
            about = said.get(name) or said.get(source.name) or {}
            yield {"capture": name, "_source": source, "_known": about.get("Known"),
                   "_eye": about.get("Eye")}  # fmt: skip


def measure(case: Row, settings: Settings) -> Row:
    """Runs `gsut scene`; what it refuses is a row, too."""
    out = settings.folder / f"scene-{case['capture']}"
    row = {"known": case["_known"], "eye": case["_eye"], "folder": str(out)}
    try:
        row |= run_gsut(["scene", str(case["_source"]), "--preset", settings.preset], out)
    except InputError as error:
        return row | {"verdict": f"refused: {str(error).partition('error: ')[2] or error}"}
    state, poses, metrics = (
        json.loads((out / name).read_text("utf-8"))
        for name in ("scene.json", "poses/poses.json", "metrics.json")
    )
    lens = poses["lenses"][0]
    detail, said = metrics.get("detail"), state["verdict"]
    return row | {
        "frames": f"{state['registered']} of {state['pictures']}",
        "lens": f"{lens['model']} {lens['params'][0]:.0f} px at {lens['width']}",
        "psnr": state["psnr"], "shown": metrics.get("psnr_unit_gain"),
        "detail": None if detail is None else 100 * detail,
        "verdict": "; ".join([f"{said['level']}: {said['what']}", *said["reasons"]]),
    }  # fmt: skip


_TABLE = Benchmark(
    help=HELP,
    columns=(
        Column("capture"), Column("frames", form="s"), Column("lens", form="s"),
        Column("known", form="s"), Column("seconds", "time", "s", ".0f"),
        Column("cpu_seconds", "time", "CPU-s", ".0f"),
        Column("psnr", "as scored", "dB", ".2f"), Column("shown", "as shown", "dB", ".2f"),
        Column("detail", "detail", "%", ".0f"), Column("verdict", form="s"),
        Column("eye", form="s"),
    ),
    cases=list_cases,
    measure=measure,
    options=(Option("preset", "fast", "of gsut scene"), Option("folders", (), "of captures")),
)  # fmt: skip


def write_sheet(path: Path, rows: list[Row]) -> None:
    """Writes a page with the table and, of each capture, held-out photographs beside renders."""
    columns = _TABLE.columns
    table = [[column.show(row) for column in columns] for row in rows]
    parts: list[Any] = [
        build_table(
            table, [c.heading for c in columns], [0, 1, 2, 3, len(columns) - 2, len(columns) - 1]
        )
    ]
    for row in rows:
        pairs = _embed_pairs(Path(row["folder"])) if row.get("seconds") is not None else []
        words = f"{row['verdict']}. Eye: {row['eye'] or '-'}"
        parts.append(render_template(_PICTURES, name=row["capture"], words=words, pairs=pairs))
    write_file(path, build_page("Captures", [], parts))


def _embed_pairs(run: Path) -> list[tuple[str, str, str]]:
    metrics = json.loads((run / "metrics.json").read_text("utf-8"))
    views = [v for v in metrics["views"] if v.get("truth") and v["psnr"] is not None]
    views.sort(key=lambda view: view["psnr"])
    chosen = np.unique(np.linspace(0, len(views) - 1, min(_PAIRS, len(views))).round().astype(int))
    return [
        (*(embed_picture(decode_image(run / "renders" / view[kind])[0], _MOST_WIDE)
           for kind in ("truth", "render")), f"{Path(view['name']).name}, {view['psnr']:.1f} dB")
        for view in (views[k] for k in chosen)
    ]  # fmt: skip


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags."""
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help="of captures, or a capture")
    parser.add_argument("--preset", default="fast", help="of gsut scene [default: fast]")
    parser.add_argument(
        "--only", default="", metavar="WORDS", help="captures with this in the name"
    )
    parser.add_argument("--folder", type=Path, help="keep scenes and captures.html, use them again")


def run(arguments: argparse.Namespace) -> int:
    """Measures, prints the table and writes FOLDER/captures.html."""
    with tempfile.TemporaryDirectory(prefix="gsut-captures-") as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        settings = _TABLE.settings(
            folder.resolve(), preset=arguments.preset, folders=tuple(arguments.folders)
        )
        rows = measure_rows(_TABLE, settings, only=arguments.only)
        print(format_table(rows, _TABLE.columns))
        write_sheet(folder / "captures.html", rows)
        if arguments.folder:
            print(f"{folder / 'captures.html'}")
    return 0
