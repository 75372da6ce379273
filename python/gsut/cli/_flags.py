"""Flags that mean the same in every command, in the same words."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsut._core import InputError
from gsut.bounds import check_number
from gsut.files import ENDINGS, format_json
from gsut.terminal import say

if TYPE_CHECKING:
    from gsut.run import RunFolder

# Of pictures, films, scenes and tables: nobody means a folder by such a name.
FILE_SUFFIXES = frozenset(
    f".{name}"
    for names in (
        "gif glb gltf fbx ksplat las laz obj ply rad sog splat spz stl usd usda usdc usdz xyz",
        "csv html json npz pdf txt zip",
    )
    for name in names.split()
).union(*ENDINGS.values())


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--json", action="store_true", help="print the figures as JSON instead of the summary"
    )


def add_quiet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no summary")


def add_force(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--force",
        action="store_true",
        help="go on where the photographs contradict the poses, the lens or the points",
    )


def check_first(
    scene: Any, force: bool, quiet: bool = False, mends: Sequence[str] = ()
) -> list[Any]:
    """Runs the doctor's quick checks and prints what will make the result worse.

    Args:
        scene: that is looked at.
        force: go on although the data contradict themselves. quiet: only errors.
        mends: "poses" or "lens", where they are refined: an error in them is only a note.

    Returns:
        The findings.

    Raises:
        InputError: the data contradict themselves, without --force.
    """
    from gsut.check import check_scene, stop_at_errors

    findings = check_scene(scene)
    mended = [each for each in findings if each.severity == "error" and each.subject in mends]
    others = [each for each in findings if each not in mended]
    for finding in [] if quiet else mended:
        say(
            f"note: {finding.where}: {finding.what}; that is refined by tracks of features before "
            "the training, whose verdict says whether it was mended"
        )
    _say_findings(others, quiet)
    stop_at_errors(others, force)
    return findings


def show_findings(scene: Any, run: RunFolder | None, quiet: bool = False) -> None:
    """Prints what the doctor says of a trained scene, where poses or lens make the result worse.

    Args:
        scene: whose poses and lenses are trusted.
        run: that trained it; `gsut train` kept the findings there. Else they are made now.
        quiet: print nothing.
    """
    from gsut.check import Finding, check_scene
    from gsut.run import RunFile

    if quiet:
        return
    kept = None if run is None else run.read_json(RunFile.FINDINGS)
    if kept is not None:
        findings = [Finding(**each) for each in kept["findings"]]
    else:
        findings = check_scene(scene)
    _say_findings(findings)


def keep_findings(run: RunFolder, findings: Sequence[Any]) -> None:
    """Writes what the doctor says of a run's data."""
    from gsut.run import RunFile

    rows = [dataclasses.asdict(each) for each in findings if each.severity != "info"]
    run.write_json(RunFile.FINDINGS, {"findings": rows})


def _say_findings(findings: Sequence[Any], quiet: bool = False) -> None:
    for finding in findings:
        if not quiet and finding.severity != "info":
            say(str(finding))


def add_capture(parser: argparse.ArgumentParser) -> None:
    """Adds the flags that choose pictures of a video or a 360-degree camera."""
    parser.add_argument(
        "--frames",
        type=count,
        metavar="N",
        help="frames to choose of a video [default: by how far the view moves, 60 to 300]",
    )
    parser.add_argument(
        "--nadir-cap",
        type=Number(0, 90),
        default=0.0,
        metavar="DEGREES",
        help="of 360-degree pictures: so far from straight down nothing counts (tripod, hand, "
        "selfie stick) [default: all counts]",
    )


def add_run(parser: argparse.ArgumentParser) -> None:
    """Adds a finished run as the first argument."""
    parser.add_argument("folder", metavar="RUN", help="folder of the run")


def add_moved_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data", metavar="DATA", help="the dataset, if it is not where training read it"
    )


class Number:
    """A number within bounds, for `type=`; NaN and infinities are refused.

    Args:
        low, high: allowed both; without bounds as far as squares are finite, or up to the
            largest 32-bit integer.
        whole: without digits behind the point.
        above: `low` itself is not allowed.
    """

    def __init__(
        self,
        low: float | None = None,
        high: float | None = None,
        *,
        whole: bool = False,
        above: bool = False,
    ) -> None:
        self.whole, self._above, self._low, self._high = whole, above, low, high

    def __call__(self, text: str) -> Any:
        try:
            return check_number(
                text, "", self._low, self._high, whole=self.whole, above=self._above
            )
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None


finite = Number()
whole = Number(whole=True)
count = Number(1, whole=True)
degrees = Number(0, 360, above=True)  # of a field of view
positive = Number(0, above=True)


def is_run(source: Path) -> bool:
    """Returns whether a folder holds a finished run."""
    from gsut.run import RunFile

    return (source / RunFile.OPTIONS).is_file() and (source / RunFile.SCENE).is_file()


def read_folder_name(text: str) -> str:
    """Reads the name of a folder to write, for `type=`; rejects an empty or a file's name."""
    if not text:
        raise argparse.ArgumentTypeError("a folder is written here, and the name is empty")
    if Path(text).suffix.lower() in FILE_SUFFIXES and not Path(text).is_dir():
        raise argparse.ArgumentTypeError(
            f"a folder is written here, and {text} ends as a file's name does; give another"
        )
    return text


def parse_image_size(text: str) -> tuple[int, int]:
    """Reads width and height of --size.

    Raises:
        InputError: not like 1280x720.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise InputError(f"--size must be like 1280x720, found {text!r}")
    return int(width), int(height)


def print_result(arguments: argparse.Namespace, figures: Any, lines: Iterable[str]) -> int:
    """Prints figures with --json, else the lines of a summary unless --quiet; the status is 0."""
    if arguments.json:
        print(format_json(figures))
    elif not getattr(arguments, "quiet", False):
        for line in lines:
            print(line)
    return 0
