"""`gsut scene`: flags and words of `gsut.scene`."""

from __future__ import annotations

import argparse

from gsut.cli._flags import add_json, add_quiet, print_result, read_folder_name
from gsut.cli.view import LivePage, add_live_flags
from gsut.run import SceneOptions
from gsut.run.options import add_option_flags, collect_given
from gsut.system import format_command

HELP = "a scene from a video or photographs, in one command"
DESCRIPTION = (
    "Makes a scene from videos or photographs: chooses frames, finds the lens and the camera's "
    "poses, trains, and writes a report. If interrupted, run the same command again to resume."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "inputs",
        metavar="INPUT",
        nargs="+",
        help="videos, photographs and folders of photographs, all of one camera",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="RUN",
        required=True,
        type=read_folder_name,
        help="folder of the scene and all its stages",
    )
    add_option_flags(parser, SceneOptions)
    add_live_flags(parser)
    parser.add_argument(
        "--no-open", action="store_true", help="do not open the page of --view in a browser"
    )
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    import gsut
    from gsut.scene import is_scene_finished

    options = SceneOptions(**collect_given(SceneOptions, arguments))
    was_finished = is_scene_finished(arguments.out)
    with LivePage(arguments) as page:
        try:
            result = gsut.scene(
                arguments.inputs, arguments.out, options, progress=not arguments.quiet,
                watch=page.begin_training,
            )  # fmt: skip
        except KeyboardInterrupt as interrupt:
            scene_kept = f"; {interrupt}" if str(interrupt) else ""
            words = format_command(["gsut", "scene", *arguments.inputs, "-o", arguments.out])
            raise KeyboardInterrupt(
                f"interrupted; finished stages are kept in {arguments.out}{scene_kept}. Run "
                f"the same command again to resume: {words} ..."
            ) from None
        page.finish(result.trained)
        lines = [f"already finished: {result.path}"] if was_finished else []
        lines.append(str(result.verdict))
        if renders := result.figures.get("renders"):
            said = "" if renders == result.verdict.what else f"{renders}; "
            lines.append(f"{said}look around in it: gsut view {result.path}")
        print_result(arguments, result.figures, [*lines, f"report: {result.page}"])
        page.stay()
    return 0
