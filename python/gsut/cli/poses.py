"""`gsut poses`: flags, progress bars and words; the work is done by gsut.sfm."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsut._core import InputError
from gsut.capture import Capture, capture, is_video
from gsut.cli._flags import add_capture, add_json, add_quiet, degrees, folder_name, print_json
from gsut.data import CAPTURE_FOLDER, find_lens_file
from gsut.lens import is_lens_name, lens_by_name
from gsut.output_folder import claim_folder
from gsut.run import Progress, StagedProgress, Verdict, add_option_flags, given_options
from gsut.sfm import PosesOptions, check_lens, read_finished

if TYPE_CHECKING:
    from gsut.sfm import PosesResult

HELP = "camera poses and points of photographs, without COLMAP"
DESCRIPTION = (
    "Finds where photographs were taken, through any lens, and points that they see; writes a "
    "dataset that `gsut train` reads."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "images",
        metavar="IMAGES",
        help="folder of photographs, a video, or a dataset (its poses are not looked at)",
    )
    add_capture(parser)
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file, or a dataset whose lens is used; or the camera's name, such as 'GoPro "
        "HERO9 Black, Max Wide' (`gsut camera find`): the lens is then estimated from there "
        "[default: the one beside the images; if there is none the lens is estimated]",
    )
    parser.add_argument(
        "--unknown-lens",
        action="store_true",
        help="estimate the lens even where one lies beside the images",
    )
    parser.add_argument(
        "--fov",
        type=degrees,
        metavar="DEGREES",
        help="rough horizontal field of view of an unknown lens [default: several are tried]",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=folder_name,
        metavar="DATA",
        required=True,
        help="folder for transforms.json, points3D.ply, sparse/0 (COLMAP), poses.json and "
        "report.html; a run that was killed goes on here",
    )
    parser.add_argument(
        "--photometric",
        action="store_true",
        help="for a video in the order of its file names, lens known: estimate poses from colours, "
        "against Gaussians that grow image by image; where there are many features bundle "
        "adjustment, the default, is more accurate",
    )
    parser.add_argument(
        "--rig",
        metavar="RIG",
        help="file of several cameras that are fixed to each other: the report.json of "
        "`gsut calibrate --rig`, or a camchain of Kalibr. IMAGES then holds one folder a camera; "
        "images of one frame (of one name, or else in order) share one pose, and poses and points "
        "are in the rig's unit",
    )
    parser.add_argument(
        "--refine-rig",
        action="store_true",
        help="adjust the cameras' poses on the rig too; its size is kept: it sets the scale",
    )
    add_quiet(parser)
    add_json(parser)
    add_option_flags(parser, PosesOptions)


def run(arguments: argparse.Namespace) -> int:
    if arguments.camera and arguments.unknown_lens:
        raise InputError("--unknown-lens contradicts --camera; give one of them")
    options = PosesOptions(**given_options(PosesOptions, arguments))
    if arguments.refine_rig and not arguments.rig:
        raise InputError("--refine-rig needs a rig; give its file by --rig")
    with claim_folder(arguments.out, "poses", arguments.images):
        return _run(arguments, options)


def _run(arguments: argparse.Namespace, options: PosesOptions) -> int:
    mapper = None
    if arguments.photometric:
        if arguments.unknown_lens:
            raise InputError("--photometric needs a known lens; give it by --camera")
        from gsut.sfm import FOLDER
        from gsut.training import grow_poses

        mapper = functools.partial(grow_poses, keep=Path(arguments.out) / FOLDER / "growth.npz")
        if options.pairs == "auto":
            options = dataclasses.replace(options, pairs="sequential")
    images, camera = arguments.images, arguments.camera
    if arguments.rig is None:
        check_lens(camera)
    if arguments.rig is None and needs_capture(images, camera, arguments.unknown_lens):
        taken = capture_with_bars([images], Path(arguments.out) / CAPTURE_FOLDER, arguments)
        images, options = taken.path, with_readout(options, camera, taken)
    settings: dict[str, Any] = {
        "camera": camera,
        "unknown_lens": arguments.unknown_lens,
        "fov_degrees": arguments.fov,
        "options": options,
    }
    figures = None
    if arguments.rig is None and mapper is None:
        figures = read_finished(images, arguments.out, **settings)
    words = "done already" if figures else None
    if figures is None:
        settings |= {"mapper": mapper, "rig": arguments.rig, "refine_rig": arguments.refine_rig}
        figures = _estimate(images, arguments, settings)
    if arguments.json:
        print_json({key: value for key, value in figures.items() if key != "views"})
    elif not arguments.quiet:
        _print(figures, Path(arguments.out), words)
    return 0


def _estimate(
    images: str | os.PathLike[str], arguments: argparse.Namespace, settings: dict[str, Any]
) -> dict[str, Any]:
    """The content of poses.json; a stop says what is kept."""
    try:
        return estimate_with_bars(
            images, arguments.out, enabled=not arguments.quiet, **settings
        ).figures
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; the features and matches found so far are kept in {arguments.out}, and the "
            "same command goes on from there"
        ) from None


def _print(figures: dict[str, Any], out: Path, words: str | None) -> None:
    """What was found, in the terminal."""
    error = figures["reprojection_error_px"]
    print(
        f"{figures['registered']} of {figures['images']} images registered, "
        f"{figures['points']:,} points, median error {error['median']:.3f} px, "
        + (words or f"{figures['seconds']['total']:.1f} s")
    )
    if "rig" in figures:
        print(_rig_words(figures["rig"]))
    for lens in figures["lenses"] if figures["lens"] == "estimated" else []:
        values = " ".join(f"{value:.6g}" for value in lens["params"])
        print(f"lens found: {lens['model']} {values}")
    print(Verdict.of(figures["verdict"]))
    print(f"report: {out / 'report.html'}")


def estimate_with_bars(
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    enabled: bool = True,
    **settings: Any,
) -> PosesResult:
    """`find_poses` with one progress bar for all its stages, if enabled."""
    from gsut.sfm import PosesLog, find_poses

    with StagedProgress({}, enabled) as bars, contextlib.closing(PosesStages(bars)) as stages:
        log = PosesLog(stages.show, bars.note, stages.expect)
        return find_poses(images, out, log=log, **settings)


class PosesStages:
    """Moves the bar of a command through the stages of `find_poses`, as it tells of them."""

    def __init__(self, bars: StagedProgress) -> None:
        self._bars = bars
        self._names: list[str] = []
        self._stage = ""
        self._open = contextlib.ExitStack()

    @property
    def seconds(self) -> float:
        """Of all stages that are done."""
        return sum(self._bars.seconds.get(name, 0.0) for name in self._names)

    def expect(self, seconds: Mapping[str, float]) -> None:
        """What the stages take, as far as it is known; some that were expected may be absent."""
        for name in set(self._names) - set(seconds):
            self._bars.skip(name)
        self._names = list(seconds)
        for name, expected in seconds.items():
            self._bars.expect(name, expected)

    def show(self, stage: str, done: int, total: int, text: str) -> None:
        """A stage that was not expected is part of the one before."""
        if stage not in self._names:
            return
        if stage != self._stage:
            self._open.close()
            for name in self._names[: self._names.index(stage)]:
                if name not in self._bars.seconds:
                    self._bars.skip(name)
            self._stage = stage
            self._open.enter_context(self._bars.stage(stage))
        self._bars.show(done / max(1, total), text)

    def close(self) -> None:
        """Ends the last stage."""
        self._open.close()


def needs_capture(images: str, camera: str | None, unknown_lens: bool) -> bool:
    """Whether pictures are to be chosen, or to be asked for their lens, before poses are sought."""
    path = Path(images)
    if is_video(path):
        return True
    if not path.is_dir() or (path / "transforms.json").is_file():
        return False
    if camera is not None:
        return is_lens_name(camera)
    return unknown_lens or find_lens_file(path) is None


def capture_with_bars(inputs: Sequence[str], out: Path, arguments: argparse.Namespace) -> Capture:
    """`capture` with a progress bar and its notes, unless --quiet."""
    with Progress(not arguments.quiet) as bars:
        taken = capture(
            inputs,
            out,
            count=arguments.frames,
            on_progress=bars.show,
            caps=(arguments.nadir_cap, arguments.zenith_cap),
        )
        for note in taken.notes:
            bars.note(note)
    return taken


def with_readout(options: PosesOptions, camera: str | None, taken: Capture) -> PosesOptions:
    """The options of a rolling shutter with the readout time of a lens that was given by name."""
    wanted = options.shutter == "rolling" and options.readout_time is None
    if not (wanted and camera and is_lens_name(camera)):
        return options
    profile = lens_by_name(camera, tuple(taken.figures["size"]))
    share = profile.readout_share(taken.figures["name_rate"])
    backwards = (profile.readout_ms or 0) < 0
    direction = "bottom_to_top" if backwards else options.readout_direction
    return dataclasses.replace(options, readout_time=share, readout_direction=direction)


def _rig_words(rig: dict[str, Any]) -> str:
    if rig.get("found"):
        return (
            f"rig of two lenses found: {rig['frames_registered']} of {rig['frames_total']} frames, "
            f"the back one turned by {rig['turn_degrees']:.2f} degrees"
        )
    words = (
        f"rig: {rig['frames_registered']} of {rig['frames_total']} frames, in the unit of "
        f"{rig['file']} (baseline {rig['baseline']:.6g})"
    )
    if rig["scale_sigma_percent"] is not None:
        words += f", lengths good to {rig['scale_sigma_percent']:.2f} % (one sigma) if it is exact"
    if not rig["refined"]:
        return words
    changes = [
        f"{c['name']} turned {c['turned_degrees']:.3f} degrees, shifted {c['shifted']:.4g}"
        for c in rig["cameras"]
    ]
    return f"{words}; {'; '.join(changes)}"
