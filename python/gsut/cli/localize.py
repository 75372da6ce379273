"""`gsut localize`: where a photograph was taken, in the scene of a finished run."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from typing import Any

from gsut.cli._flags import (
    add_json,
    print_result,
    show_findings,
)
from gsut.terminal import say

_FOCAL_OFF = 0.025  # relative; reported above this
HELP = "where a photograph of a trained scene was taken"
DESCRIPTION = (
    "Finds the pose of a photograph: matches its features with views rendered from the training "
    "poses that look most like it, and refines the pose by the colours. The exit status is 2 where "
    "the photograph shows another place."
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("image", metavar="IMAGE", help="the photograph")
    parser.add_argument("--run", metavar="RUN", required=True, dest="folder", help="a finished run")
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file of IMAGE, or name (`gsut camera find`) [default: the run's only camera]",
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.refine import localize
    from gsut.render import choose_solid
    from gsut.run import Progress, RunFolder
    from gsut.training import read_trained

    run = RunFolder.open(arguments.folder)
    options, scene, gaussians = read_trained(run, None)
    show_findings(scene, run)
    with Progress() as bars:
        found = localize(
            arguments.image,
            scene,
            gaussians,
            camera=arguments.camera,
            background=choose_solid(options.background),
            on_progress=bars.show,
        )
    indices = scene.train_indices or range(len(scene.views))
    start = found.start if isinstance(found.start, str) else scene.views[indices[found.start]].name
    figures = _list_figures(found, scene, start)
    return print_result(arguments, figures, _summarize(figures))


def _list_figures(localized: Any, scene: Any, start: str) -> dict[str, Any]:
    """Returns what is printed, in the dataset's coordinates."""
    found = localized.pose
    return {
        "camera_from_world": scene.to_dataset(found.camera_from_world).tolist(),
        "center": (found.center + scene.world_offset).tolist(),
        "center_std": found.center_std.tolist(),
        "rotation_std_degrees": found.rotation_std.tolist(),
        "covariance": found.covariance.tolist(),
        "gain": found.gain,
        "bias": found.bias,
        "rms": found.rms,
        "converged": found.converged,
        "start": start,
        "matches": localized.matches,
        "starts_tried": localized.starts,
        "agreement": localized.agreement,
        "focal_scale": localized.focal_scale,
        "shutter": found.shutter.direction if found.shutter else "global",
        "shutter_source": localized.shutter_source,
        "motion": None if found.motion is None else found.motion.tolist(),
        "motion_std": None
        if found.motion_covariance is None
        else [float(value) ** 0.5 for value in found.motion_covariance.diagonal()],
    }


def _summarize(figures: dict[str, Any]) -> Iterator[str]:
    """Summarizes a pose in lines; warnings and notes go to standard error."""
    if figures["matches"]:
        yield f"start: from {figures['matches']} matches with rendered training views"
    else:
        yield f"start: the pose of {figures['start']}"
    yield "camera_from_world (dataset coordinates):"
    for row in figures["camera_from_world"]:
        yield "  " + " ".join(f"{value:12.6f}" for value in row)
    pairs = zip(figures["center"], figures["center_std"], strict=True)
    yield "centre: " + ", ".join(f"{value:.5f} +- {std:.5f}" for value, std in pairs)
    turns = ", ".join(f"{std:.4f}" for std in figures["rotation_std_degrees"])
    yield f"rotation: +- {turns} degrees about the camera's axes"
    yield (
        f"colours: rms difference {figures['rms']:.4f} with gain {figures['gain']:.3f} and bias "
        f"{figures['bias']:+.3f}"
    )
    yield f"{figures['agreement']:.0%} of the photograph's parts lie where the scene shows them"
    if abs(figures["focal_scale"] - 1) > _FOCAL_OFF:
        say(
            "warning: the photograph fits better a focal length times "
            f"{figures['focal_scale']:.3f}: check --camera; the uncertainty says how far that "
            "moves the pose"
        )
    yield from _summarize_shutter(figures)
    if not figures["converged"]:
        say("note: the refinement stopped before it converged")


def _summarize_shutter(figures: dict[str, Any]) -> Iterator[str]:
    if figures["motion"] is not None:
        pairs = list(zip(figures["motion"], figures["motion_std"], strict=True))
        moved = ", ".join(f"{value:.5f} +- {std:.5f}" for value, std in pairs[:3])
        turned = ", ".join(
            f"{math.degrees(value):.4f} +- {math.degrees(std):.4f}" for value, std in pairs[3:]
        )
        yield f"rolling shutter ({figures['shutter']}): the pose is that of the middle line"
        yield f"from first to last line the centre moves by {moved}"
        yield f"and the camera turns by {turned} degrees about its axes"
    elif figures["shutter_source"] == "undetermined":
        say(
            "warning: the photograph does not determine whether its lines were read one "
            "after the other; it is posed as read at once, and the uncertainty says how far motion "
            "would move the pose"
        )
