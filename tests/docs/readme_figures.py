"""Writes the figures of README from the tables of docs, with the machine of each."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_ORIGIN = re.compile(r"\b([a-z]): (commit [^;\n]+?)(?:;|\.\n|\.$)")

# What was measured; a sentence; for each {} of it the page, words of the table's heading or mark,
# the cells that name its row, and the column.
_Cell = tuple[str, str, tuple[str, ...], str]
_FAST, _BALANCED = ("sponza_fisheye", "--preset fast"), ("sponza_fisheye", "--preset balanced")
_FOX = tuple(
    ("fox", f"--scale 0.25 --steps {steps} --max-gaussians {most}")
    for steps, most in ((350, 40000), (700, 60000))
)
_KNOWN = ("sponza_fisheye", "known")
_WHOLE, _KEPT = ("sponza_fisheye", "whole model"), ("sponza_fisheye", "ghap")
_ROOM = ("synthetic_100k_640x480",)
_PSNR, _TIME, _VIEW = "held-out PSNR [dB]", "whole command [s]", "a view [CPU-ms]"
_TURN, _CPU = "rotation [degrees]", "time [CPU-s]"
FIGURES: dict[str, tuple[str, list[_Cell]]] = {
    "training, 60 fisheye views of 190 degrees, the whole command": (
        "{:.1f} dB held out in {:.0f} s, {:.1f} dB in {:.0f} s",
        [("results", "table: train", row, c) for row in (_FAST, _BALANCED) for c in (_PSNR, _TIME)],
    ),
    "50 phone photographs at 270 x 480, exposure drifting, the whole command": (
        "{:.1f} dB held out in {:.0f} s, {:.1f} dB in {:.0f} s",
        [("results", "table: train", row, c) for row in _FOX for c in (_PSNR, _TIME)],
    ),
    "poses of the 70 views by the known lens, without COLMAP": (
        "{:.3f} degrees in {:.0f} CPU-s",
        [("results", "--only gsut", _KNOWN, c) for c in (_TURN, _CPU)],
    ),
    "a drone's video of 12 s, lens not given: frames, lens, poses and scene": (
        "{:.0f} of {:.0f} frames, {:.1f} dB held out, {:.0f} s",
        [("results", "table: scene", ("karma",), c)
         for c in ("registered", "pictures", _PSNR, "time [s]")],
    ),
    "compaction of 500,000 Gaussians to a fifth": (
        "{:.2f} to {:.2f} dB, {:.0f} to {:.0f} CPU-ms a view",
        [("results", "table: compact", row, c) for c in (_PSNR, _VIEW) for row in (_WHOLE, _KEPT)],
    ),
    "rendering, 100,000 Gaussians at 640 x 480, fisheye": (
        "{:.1f} CPU-ms, image rms {:.0e}, {:.0f} x a scalar renderer",
        [("performance", "table: render", _ROOM, c)
         for c in ("blend [CPU-ms]", "image rms error", "blend, x scalar")],
    ),
}  # fmt: skip


def find_row(page: str, words: str, names: tuple[str, ...]) -> dict[str, str]:
    """Finds the row of a table of docs: heading -> cell; Origin in words."""
    text = (ROOT / "docs" / f"{page}.md").read_text()
    for part in re.split(r"^(?=#|<!-- table)", text, flags=re.MULTILINE):
        lines = [line for line in part.splitlines() if line.startswith("|")]
        if words not in part.partition("|")[0] or not lines:
            continue
        cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
        for row in cells[2:]:
            if tuple(row[: len(names)]) == names:
                found = dict(zip(cells[0], row, strict=True))
                origin = dict(_ORIGIN.findall(part)).get(found.get("Origin", ""))
                return found | ({"Origin": origin} if origin else {})
    raise LookupError(f"docs/{page}.md has no row {names} in a table of {words!r}")


def read_number(cell: str) -> float:
    return float(cell.replace(",", "").rstrip("%"))


def write_figures() -> str:
    """Writes README's table of figures, and below it the machine of each row."""
    lines, machines = [], {}
    for what, (sentence, cells) in FIGURES.items():
        rows = [find_row(page, words, names) for page, words, names, _ in cells]
        values = [read_number(row[cell[3]]) for row, cell in zip(rows, cells, strict=True)]
        for row in rows:
            machines.setdefault(row["Origin"].split(", ", 2)[2], []).append(len(lines) + 1)
        lines.append(f"| {what} | {sentence.format(*values)} |")
    where = "; ".join(
        machine if len(machines) == 1 else
        f"{machine} (rows {', '.join(str(number) for number in sorted(set(numbers)))})"
        for machine, numbers in machines.items()
    )  # fmt: skip
    return "\n".join([f"| On {where} | |", "|---|---|", *lines])


def write_first_minutes() -> str:
    """Writes how long the demo, the first build in it, and the tests take, by machine."""
    text = (ROOT / "docs" / "results.md").read_text().partition("## From nothing")[2]
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in text.partition("\n## ")[0].splitlines() if line.startswith("|")
    ][2:]  # fmt: skip
    minutes: dict[str, dict[str, str]] = {}
    for what, machine, time, *_ in rows:
        minutes.setdefault(machine, {})[what] = time
    parts = []
    for machine, found in minutes.items():
        details = {"first build": "{} of them to build", "tests": "`./run test` {}"}
        known = [words.format(found[what]) for what, words in details.items() if what in found]
        parts.append(
            f"{found['demo']} minutes on {machine}" + (f" ({', '.join(known)})" if known else "")
        )
    return f"From nothing `./run demo` takes {'; '.join(parts)}."


BLOCKS = {"results": write_figures, "from nothing": write_first_minutes}


def write_readme(text: str) -> str:
    """Renews the blocks between `<!-- figures: NAME -->` and `<!-- end -->` of README's text."""
    return re.sub(
        r"(<!-- figures: ([a-z ]+) -->\n).*?(<!-- end -->)",
        lambda found: f"{found[1]}{BLOCKS[found[2]]()}\n{found[3]}",
        text,
        flags=re.DOTALL,
    )
