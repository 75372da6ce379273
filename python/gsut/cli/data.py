"""`gsut data`: writes a dataset in another layout, or its poses as a trajectory."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gsut.cli._flags import add_json, is_run, print_result, read_folder_name
from gsut.data import list_writable_layouts
from gsut.terminal import say

HELP = "convert a dataset, a run's poses or a ROS bag into another layout"
DESCRIPTION = "Works on datasets: photographs with lenses and poses, in any layout."


def add_flags(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    convert = actions.add_parser(
        "convert",
        help="write a dataset in another layout",
        description="Writes the dataset IN, of any layout that gsut reads, to the new folder OUT. "
        "A run serves as IN, too: its dataset with the poses and lenses that it refined. OUT that "
        "ends as .txt is a trajectory alone, as TUM writes it. The flags below say what a layout "
        "leaves open; a file dataset.yaml says that, and more, to every command.",
    )
    convert.add_argument(
        "source", metavar="IN", help="dataset, run, ROS bag, or a folder of pictures with --lens "
        "and --poses",
    )  # fmt: skip
    convert.add_argument(
        "out", metavar="OUT", type=_read_target, help="new folder, or a trajectory's .txt"
    )
    convert.add_argument(
        "--to", choices=sorted(list_writable_layouts()), default="nerfstudio",
        help="layout [default: %(default)s]",
    )  # fmt: skip
    _add_parts(convert)
    add_json(convert)
    convert.set_defaults(action=_convert)


def _read_target(text: str) -> str:
    return text if text.lower().endswith(".txt") else read_folder_name(text)


def _add_parts(parser: argparse.ArgumentParser) -> None:
    parts = parser.add_argument_group("what the layout leaves open")
    parts.add_argument("--lens", metavar="FILE", help="lens file, camchain.yaml or rig.json")
    parts.add_argument(
        "--poses", metavar="FILE", help="trajectory: TUM, EuRoC, KITTI or poses.json"
    )
    parts.add_argument("--poses-topic", metavar="TOPIC", help="of a ROS bag's poses")
    parts.add_argument("--cameras", metavar="NAMES", help="those to use, such as cam0,cam1")


def run(arguments: argparse.Namespace) -> int:
    return arguments.action(arguments)


def _convert(arguments: argparse.Namespace) -> int:
    from gsut.data import convert_dataset

    parts = _collect_parts(arguments)
    source, scene = Path(arguments.source), None
    if is_run(source):
        from gsut.run import RunFolder
        from gsut.training import read_scene

        scene = read_scene(RunFolder.open(source), None)[1]
        source = scene.path
    notes = convert_dataset(
        source,
        arguments.out,
        arguments.to,
        parts=parts,
        scene=scene,
        poses_topic=arguments.poses_topic,
        progress=True,
    )
    for note in notes if not arguments.json else ():
        say(f"note: {note}")
    figures = {"out": arguments.out, "layout": arguments.to, "notes": notes}
    return print_result(arguments, figures, [arguments.out])


def _collect_parts(arguments: argparse.Namespace) -> dict[str, Any]:
    given = {key: getattr(arguments, key) for key in ("lens", "poses", "cameras")}
    if given["cameras"] is not None:
        given["cameras"] = [name.strip() for name in given["cameras"].split(",")]
    return {key: value for key, value in given.items() if value is not None}
