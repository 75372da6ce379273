"""`gsut convert`: a scene in another format."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import FILE_SUFFIXES, add_json, print_result
from gsut.files import refuse_existing

HELP = "a scene in another format: SPZ, SOG, glTF, USD, PLY, a page for any browser"
DESCRIPTION = (
    "Writes a run's scene, or a file of Gaussians, in the format that the suffix of OUT says, and "
    "says what that format could not hold. An OUT of .html is one page that draws the scene "
    "exactly, through the run's lenses and any other, beside some held-out photographs; it needs "
    "no network and no graphics card. IN is left as it is; an OUT that exists is refused."
)


_WORKING = 6.5  # of the Gaussians' numbers, beside them: written, read again and compared
_PAGE = ".html"
_PHOTOGRAPHS = 6  # most held-out photographs in a page: each takes about 100 kB


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source", metavar="IN",
        help="a finished run, a file of Gaussians of any known format, or streamed levels",
    )  # fmt: skip
    parser.add_argument("out", metavar="OUT", help="the file to write; its suffix says the format")
    parser.add_argument(
        "--for", choices=("gsut", "viewers"), default="gsut", dest="reader",
        help="viewers: fine-tune a run's scene so that viewers, which draw every Gaussian affinely "
        "and 0.3 pixels wider, show it as gsut does; gsut itself then shows it a little thinner "
        "[default gsut: as it is]",
    )  # fmt: skip
    parser.add_argument(
        "--stream", action="store_true",
        help="OUT is a new folder of levels of detail, which PlayCanvas, SuperSplat and Babylon "
        "load piece by piece (streamed SOG, lod-meta.json); IN is a run, on whose photographs each "
        "level is measured",
    )  # fmt: skip
    pages = parser.add_argument_group("of a page (.html)")
    pages.add_argument("--title", help="[default: the run's or file's name]")
    pages.add_argument("--credit", help="who made the scene; shown on the page and beside links")
    pages.add_argument(
        "--view", action="append", metavar="NAME=WHERE", default=[], dest="views",
        help="a view to choose by its name: WHERE is a photograph's name, or a JSON file of the "
        "viewer's Screenshot or Path (several poses are a flight); the page starts at the first "
        "[repeatable]",
    )  # fmt: skip
    pages.add_argument(
        "--address", metavar="URL",
        help="where the page will be published: a picture for previews of links (Open Graph) is "
        "written beside it, as .jpg",
    )  # fmt: skip
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.formats import (
        WriteSettings,
        check_room,
        choose_format,
        read_scene_file,
    )

    out = Path(arguments.out)
    if out.suffix.lower() == _PAGE and not arguments.stream:
        refuse_existing(out)
        return _write_page(arguments, out)
    named = ("title", "credit", "views", "address")
    if any(getattr(arguments, name) not in (None, []) for name in named):
        raise InputError(
            f"{out}: only a page has --title, --credit, --view and --address; give an .html"
        )
    if arguments.stream:
        return _write_stream(arguments, out)
    chosen = choose_format(out)
    refuse_existing(out)
    path = find_scene_file(Path(arguments.source))
    found = read_scene_file(path)
    gaussians, tuning = found.gaussians, None
    check_room("converting", [gaussians], _WORKING)
    if arguments.reader == "viewers":
        gaussians, tuning = _tune_for_viewers(arguments)
    settings = WriteSettings(antialiased=found.antialiased)
    figures = {
        "source": str(path),
        "source_bytes": _count_bytes(path),
        "out": str(out),
        "format": chosen.name,
        "num_gaussians": len(gaussians),
        "surfels": gaussians.are_surfels,
        "sh_degree": gaussians.sh_degree,
        "antialiased": found.antialiased,
        "light": _describe_light(Path(arguments.source)),
        "for_viewers": tuning,
        **_write(out, gaussians, settings),
    }
    return print_result(arguments, figures, _summarize(figures))


def _write_stream(arguments: argparse.Namespace, out: Path) -> int:
    """Writes levels of detail of a run, and prints the PSNR of each."""
    from gsut.files import whole_folder
    from gsut.formats import check_room, write_levels
    from gsut.run import RunFile, RunFolder
    from gsut.terminal import say
    from gsut.training import load_run
    from gsut.training.tuning import make_levels

    if arguments.reader == "viewers":
        raise InputError("levels hold the scene as gsut draws it; leave --for viewers out")
    if out.suffix.lower() in FILE_SUFFIXES:
        raise InputError(f"{out}: --stream writes a folder; give a name without {out.suffix}")
    if not (Path(arguments.source) / RunFile.OPTIONS).is_file():
        raise InputError(
            f"{arguments.source} is no run: --stream measures its levels on a run's photographs; "
            "give the folder of a run"
        )
    with whole_folder(out) as folder:
        trained = load_run(RunFolder.open(arguments.source).path)
        check_room("making levels of", [trained.gaussians], _WORKING)

        def on_level(count: int, psnr: float) -> None:
            if not arguments.json:
                say(f"{count:,} Gaussians: {psnr:.2f} dB")

        levels = make_levels(trained, on_level)
        written = write_levels(folder, levels.gaussians, levels.psnrs, levels.environment)
    figures = {
        "source": str(arguments.source), "out": str(out), "format": "streamed SOG",
        "psnr": levels.psnrs, **dataclasses.asdict(written),
    }  # fmt: skip
    lines = [
        f"{count:,} Gaussians, {psnr:.2f} dB, {size / 1e6:.2f} MB in {chunks} piece"
        + ("s" if chunks > 1 else "")
        for count, psnr, chunks, size in zip(
            written.counts, levels.psnrs, written.chunks, written.level_bytes, strict=True
        )
    ]
    if written.environment_bytes:
        lines.append(f"far surroundings, in every level: {written.environment_bytes / 1e6:.2f} MB")
    lines.append(f"first picture after {written.first_bytes / 1e3:.0f} kB: {out} (streamed SOG)")
    return print_result(arguments, figures, [*lines, *written.left_out])


def _write_page(arguments: argparse.Namespace, out: Path) -> int:
    """Writes the viewer's own page with the scene in it."""
    from gsut.view import Session, open_stage

    if arguments.reader == "viewers":
        raise InputError("a page draws the scene as gsut does; leave --for viewers out")
    stage = open_stage(arguments.source, None)
    if stage.gaussians is None or stage.kind == "data":
        raise InputError(f"{arguments.source}: no Gaussians to show; give a run or a scene file")
    if arguments.address is not None:
        refuse_existing(out.with_suffix(".jpg"))
    written = Session(stage).write_page(
        out, _PHOTOGRAPHS, arguments.title, arguments.views, arguments.address, arguments.credit
    )
    figures = {
        "source": str(arguments.source), "out": str(out), "format": "HTML",
        "bytes": out.stat().st_size, "num_gaussians": len(stage.gaussians),
        "clipped": written.clipped, "left_out": list(written.left_out),
    }  # fmt: skip
    _link_in_report(out)
    line = (
        f"{figures['num_gaussians']:,} Gaussians, {out.stat().st_size / 1e6:.1f} MB: {out} "
        "(a page of one file; a double click opens it)"
    )
    return print_result(arguments, figures, [line, *written.left_out])


def _tune_for_viewers(arguments: argparse.Namespace) -> tuple[Any, dict[str, Any]]:
    """Fine-tunes a run's Gaussians for viewers; returns them and the gain."""
    from gsut.render import choose_solid
    from gsut.run import Progress, RunFolder
    from gsut.training import read_trained
    from gsut.training.tuning import VIEWER_STEPS, tune_for_viewers

    if not Path(arguments.source).is_dir():
        raise InputError(
            f"--for viewers looks from where photographs were taken; {arguments.source} is a file, "
            "give the folder of a run"
        )
    options, scene, gaussians = read_trained(RunFolder.open(arguments.source), None)
    steps = VIEWER_STEPS
    with Progress(not arguments.json) as bars:
        tuned = tune_for_viewers(
            scene, gaussians, steps, background=choose_solid(options.background),
            on_step=lambda step, loss: bars.show("for viewers", step, steps, f"loss {loss:.4f}"),
        )  # fmt: skip
    figures = {
        "steps": steps,
        "psnr_before": tuned.psnr_before,
        "psnr_after": tuned.psnr_after,
    }
    return tuned.gaussians, figures


def _describe_light(source: Path) -> str | None:
    """Describes the light that a run's Gaussians show; None if its photographs do not differ."""
    from gsut.render import Light
    from gsut.run import RunFile, RunFolder

    found = source.is_dir() and "light" in (RunFolder(source).read_json(RunFile.METRICS) or {})
    return Light.SHOWN if found else None


def _link_in_report(out: Path) -> None:
    """Links a page written into a run's folder from the run's report."""
    from gsut.evaluate import write_report
    from gsut.run import RunFile, RunFolder

    if out.name == RunFile.PAGE and (out.parent / RunFile.REPORT).is_file():
        write_report(RunFolder.open(out.parent))


def find_scene_file(source: Path) -> Path:
    """Returns the scene file of a run, or the file itself."""
    from gsut.formats import TABLE
    from gsut.run import RunFile, RunFolder

    if not source.exists():
        raise InputError(
            f"{source}: no such file or folder; give a finished run or a file of Gaussians"
        )
    if not source.is_dir():
        return source
    if (source / TABLE).is_file():
        return source / TABLE
    path = RunFolder.open(source).path / RunFile.SCENE
    if not path.is_file():
        raise InputError(f"{path} is absent: the run is not finished; resume it")
    return path


def _count_bytes(path: Path) -> int:
    """Counts the bytes of a scene's file, or of all files of streamed levels."""
    from gsut.formats import TABLE

    files = path.parent.rglob("*") if path.name == TABLE else [path]
    return sum(file.stat().st_size for file in files)


def _write(out: Path, gaussians: Any, settings: Any) -> dict[str, Any]:
    """Writes, and reads again what was written: the errors are those of the file."""
    from gsut.formats import (
        choose_format,
        load_gaussians,
        measure_errors,
        prepare_for_file,
        save_gaussians,
    )

    started = time.perf_counter()
    written = save_gaussians(out, gaussians, settings)
    seconds = time.perf_counter() - started
    errors = None
    if choose_format(out).read is not None:
        stored: Any = prepare_for_file(gaussians)
        errors = measure_errors(stored[written.rows], load_gaussians(out))
    return {
        "bytes": out.stat().st_size,
        "write_seconds": seconds,
        "errors": errors,
        "clipped": written.clipped,
        "left_out": list(written.left_out),
    }


def _summarize(figures: dict[str, Any]) -> Iterator[str]:
    before, after = figures["source_bytes"] / 1e6, figures["bytes"] / 1e6
    kind = "surfels" if figures["surfels"] else "Gaussians"
    yield (
        f"{figures['num_gaussians']:,} {kind}, {before:.1f} -> {after:.1f} MB in "
        f"{figures['write_seconds']:.1f} s: {figures['out']} ({figures['format']})"
    )
    if figures["light"] is not None:
        yield figures["light"]
    tuning = figures["for_viewers"]
    if tuning is not None:
        yield (
            f"viewers' pictures against gsut's, {tuning['steps']} steps: PSNR "
            f"{tuning['psnr_before']:.2f} dB before, {tuning['psnr_after']:.2f} dB after"
        )
    for name, count in figures["clipped"].items():
        yield (
            f"{count:,} values of {name} lay beyond what {figures['format']} holds and were "
            "brought to its edge"
        )
    yield from figures["left_out"]
