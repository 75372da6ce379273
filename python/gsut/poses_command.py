"""`gsut poses`: flags, progress bars and words; the work is done by gsut.structure."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.option_fields import add_option_flags, given_options
from gsut.structure.options import PosesOptions

_BAR = "{desc:<9}{percentage:3.0f}% {bar:20} {n_fmt}/{total_fmt}, {remaining} left{postfix}"
_LOG_INTERVAL = 15.0  # seconds between refreshes where standard error is no terminal


def add_poses_flags(parser: argparse.ArgumentParser) -> None:
    """The arguments of `gsut poses`."""
    parser.add_argument(
        "images",
        metavar="IMAGES",
        help="folder of photographs, or a dataset (its poses are not looked at)",
    )
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file, or a dataset whose lens is used [default: the one beside the images; if "
        "there is none the lens is estimated]",
    )
    parser.add_argument(
        "--unknown-lens",
        action="store_true",
        help="estimate the lens even where one lies beside the images",
    )
    parser.add_argument(
        "--fov",
        type=float,
        metavar="DEGREES",
        help="rough horizontal field of view of an unknown lens [default: several are tried]",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="DATA",
        required=True,
        help="folder for transforms.json, points3D.ply, sparse/0 (COLMAP), poses.json and "
        "report.html; a run that was killed goes on here",
    )
    parser.add_argument(
        "--photometric",
        action="store_true",
        help="for a video in the order of names: find each pose by the colours of Gaussians that "
        "grow image by image, instead of by bundle adjustment, which is more exact where features "
        "are many (lens known)",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bars, no summary")
    parser.add_argument("--json", action="store_true", help="print poses.json without the views")
    add_option_flags(parser, PosesOptions)


def poses(arguments: argparse.Namespace) -> int:
    """`gsut poses IMAGES -o DATA`."""
    from gsut.structure.estimate import estimate_poses

    if arguments.camera and arguments.unknown_lens:
        raise InputError("--unknown-lens contradicts --camera; give one of them")
    options = PosesOptions(**given_options(PosesOptions, arguments))
    mapper = None
    if arguments.photometric:
        if arguments.unknown_lens:
            raise InputError("--photometric needs a known lens; give it by --camera")
        from gsut.photometric_poses import grow_poses
        from gsut.structure.stages import FOLDER

        mapper = functools.partial(grow_poses, keep=Path(arguments.out) / FOLDER / "growth.npz")
        if options.pairs == "auto":
            options = dataclasses.replace(options, pairs="sequential")
    with StageBars(enabled=not arguments.quiet) as bars:
        result = estimate_poses(
            arguments.images,
            arguments.out,
            camera=arguments.camera,
            unknown_lens=arguments.unknown_lens,
            fov_degrees=arguments.fov,
            options=options,
            mapper=mapper,
            on_progress=bars.show,
            notes_to=bars.note,
        )
    figures = result.figures
    if arguments.json:
        print(json.dumps({k: v for k, v in figures.items() if k != "views"}, indent=2))
    elif not arguments.quiet:
        error = figures["reprojection_error_px"]
        print(
            f"{figures['registered']} of {figures['images']} images registered, "
            f"{figures['points']:,} points, median error {error['median']:.3f} px, "
            f"{figures['seconds']['total']:.1f} s"
        )
        for lens in figures["lenses"] if figures["lens"] == "estimated" else []:
            values = " ".join(f"{value:.6g}" for value in lens["params"])
            print(f"lens found: {lens['model']} {values}")
        print(f"report: {Path(arguments.out) / 'report.html'}")
    return 0


class StageBars:
    """One progress bar a stage, on standard error."""

    def __init__(self, enabled: bool) -> None:
        self._enabled = enabled
        self._bar: Any = None
        self._stage = ""

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """Moves the stage's bar; a new stage begins a new one."""
        if not self._enabled or total == 0:
            return
        from tqdm import tqdm

        if stage != self._stage or (self._bar is not None and done < self._bar.n):
            self.close()
            self._stage = stage
            interval = 0.1 if sys.stderr.isatty() else _LOG_INTERVAL
            self._bar = tqdm(
                total=total, desc=stage, bar_format=_BAR, dynamic_ncols=True,
                mininterval=interval, maxinterval=interval,
            )  # fmt: skip
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def note(self, text: str) -> None:
        """A line of words above the bar."""
        if self._enabled:
            from tqdm import tqdm

            tqdm.write(f"note: {text}", file=sys.stderr)

    def close(self) -> None:
        """Leaves the last state standing."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> StageBars:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
