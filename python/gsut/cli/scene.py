"""`gsut scene`: videos or photographs in, a scene out: capture, poses, training and report.

Each stage is an existing function and leaves its files in RUN; the same command goes on where it
was stopped, and has nothing to do when all is done.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import html
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import (
    add_capture,
    add_json,
    add_quiet,
    degrees,
    folder_name,
    print_json,
    whole,
)
from gsut.cli.poses import PosesStages, with_readout
from gsut.cli.view import LivePage, add_live_flags
from gsut.data import CAPTURE_FOLDER, STRIP
from gsut.output_folder import claim_folder
from gsut.run import (
    METRICS,
    OPTIONS,
    PRESETS,
    RENDERS,
    REPORT,
    RunFolder,
    StagedProgress,
    TrainOptions,
    Verdict,
    flag_name,
    for_views,
    worst,
)
from gsut.sfm import PosesOptions, check_lens

HELP = "a scene from a video or photographs, in one command"
DESCRIPTION = (
    "Makes a scene of what a camera took: chooses frames of a video, finds the lens and where each "
    "picture was taken, trains, and writes a report. The same command goes on where it was stopped."
)
POSES = "poses"  # folder of the pictures and poses, in the run's folder
STATE = "scene.json"  # inputs and settings; seconds and verdict once all is done
PAGE = "scene.html"
_CAPTURE_SECONDS, _TRAIN_SECONDS = 8.0, 3.0  # expected, the latter of training before its steps
# What another scene would come of; the threads are none of it.
_SETTINGS = (
    "preset", "steps", "camera", "fov", "frames", "nadir_cap", "zenith_cap", "shutter", "seed",
)  # fmt: skip
_FEW_PICTURES = 20  # make a poor scene


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
        type=folder_name,
        help="folder of the scene and all its stages",
    )
    parser.add_argument(
        "--preset",
        choices=tuple(PRESETS),
        default="balanced",
        help="how long to train: see `gsut train --help` [default: %(default)s]",
    )
    parser.add_argument(
        "--steps",
        type=whole,
        metavar="N",
        help="training steps, one picture each [default: preset]",
    )
    parser.add_argument(
        "--camera",
        metavar="LENS",
        help="lens file, or the camera's name, such as 'GoPro HERO9 Black, Max Wide' (`gsut camera "
        "find`) [default: what the pictures say of their camera, else the lens is estimated]",
    )
    parser.add_argument(
        "--fov", type=degrees, metavar="DEGREES", help="rough horizontal field of view"
    )
    add_capture(parser)
    parser.add_argument(
        "--shutter",
        choices=("auto", "global", "rolling"),
        default="auto",
        help="see `gsut poses --help` [default: %(default)s]",
    )
    parser.add_argument("--seed", type=whole, default=0, help="seed of every random number")
    parser.add_argument("--threads", type=whole, default=0, help="threads; 0 = all processors")
    add_live_flags(parser)
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    with LivePage(arguments) as page:
        return _run(arguments, page)


def _run(arguments: argparse.Namespace, page: LivePage) -> int:
    folder = RunFolder.claim(arguments.out, "scene", arguments.inputs[0])
    state = _begin(folder, arguments)
    if "verdict" not in state:
        try:
            state = _make(folder, arguments, state, page)
        except KeyboardInterrupt:
            words = shlex.join(["gsut", "scene", *arguments.inputs, "-o", arguments.out])
            raise KeyboardInterrupt(
                f"stopped; what was finished is kept in {folder.path}, and the same command goes "
                f"on from there: {words} ..."
            ) from None
    elif not arguments.quiet and not arguments.json:
        print(f"done already: {folder.path}")
    if arguments.json:
        print_json(state)
    elif not arguments.quiet:
        print(Verdict.of(state["verdict"]))
        renders = state.get("renders")
        if renders:
            said = renders == state["verdict"]["what"]
            print(f"{'' if said else renders + '; '}look around in it: gsut view {folder.path}")
        print(f"report: {folder.path / PAGE}")
    page.stay()
    return 0


def _begin(folder: RunFolder, arguments: argparse.Namespace) -> dict[str, Any]:
    """The state that the folder holds, or a new one.

    Raises:
        InputError: it holds a scene of other inputs or settings, or a run of another command.
    """
    key = {
        "inputs": [str(Path(name).resolve()) for name in arguments.inputs],
        **{name: getattr(arguments, name) for name in _SETTINGS},
    }
    state = folder.read_json(STATE)
    if state is None:
        folder.refuse_run()
        return {"key": key}
    different = [name for name in key if state["key"].get(name, key[name]) != key[name]]
    if different:
        name = different[0]
        what = name if name == "inputs" else flag_name(name)
        raise InputError(
            f"{folder.path} holds a scene with other {what} ({state['key'].get(name)}, now "
            f"{key[name]}); give another folder by -o (nothing was overwritten)"
        )
    return state


def _make(
    folder: RunFolder, arguments: argparse.Namespace, state: dict[str, Any], page: LivePage
) -> dict[str, Any]:
    """All stages that are not done; returns the final state."""
    from gsut.capture import capture

    check_lens(arguments.camera)
    expected = {"capture": _CAPTURE_SECONDS, POSES: 100.0, "training": 60.0, "report": 0.1}
    claimed = claim_folder(folder.path / POSES, "poses", arguments.inputs[0])
    with claimed, StagedProgress(expected, not arguments.quiet) as bars:
        with bars.stage("capture"):
            taken = capture(
                arguments.inputs, folder.path / POSES / CAPTURE_FOLDER, count=arguments.frames,
                caps=(arguments.nadir_cap, arguments.zenith_cap),
                on_progress=_evenly(bars, {"looking": 0.7, "frames": 0.3, "photographs": 1.0}),
            )  # fmt: skip
            for note in taken.notes:
                bars.note(note)
        folder.write_json(STATE, state)
        options = TrainOptions(
            preset=arguments.preset, steps=arguments.steps, seed=arguments.seed,
            threads=arguments.threads,
        )  # fmt: skip
        bars.expect("training", _TRAIN_SECONDS + _steps_seconds(taken.figures, options))
        poses, poses_seconds = _find_poses(folder, arguments, taken, bars)
        metrics = _train(folder, options, bars, page)
        with bars.stage("report"):
            bars.show(0.5)
            seconds = {
                "capture": bars.seconds["capture"],
                # Of a stage that was done by an earlier call.
                POSES: poses_seconds or poses["seconds"]["total"],
                "training": bars.seconds["training"] or metrics["train_seconds"],
            }
            verdict = _together([*_said([metrics, poses]), _capture_verdict(taken.figures)])
            state = {
                **state,
                "seconds": seconds,
                "pictures": len(taken.figures["frames"]),
                "registered": poses["registered"],
                **{key: metrics.get(key) for key in ("psnr", "ssim", "num_gaussians", "steps")},
                "renders": (metrics.get("verdict") or {}).get("what"),
                "verdict": verdict.as_dict(),
            }
            _write_page(folder, state, taken.notes, metrics)
        seconds["report"] = bars.seconds["report"]
        folder.write_json(STATE, state)
    return state


def _find_poses(
    folder: RunFolder, arguments: argparse.Namespace, taken: Any, bars: StagedProgress
) -> tuple[dict[str, Any], float]:
    """The content of poses.json, and the seconds that it took now."""
    from gsut.sfm import PosesLog, find_poses, is_finished, read_figures

    out = folder.path / POSES
    bars.skip(POSES)  # its own stages come instead
    if is_finished(out):
        return read_figures(out), 0.0
    options = PosesOptions(
        shutter=arguments.shutter, seed=arguments.seed, threads=arguments.threads
    )
    with contextlib.closing(PosesStages(bars)) as stages:
        figures = find_poses(
            taken.path, out, camera=arguments.camera, fov_degrees=arguments.fov,
            options=with_readout(options, arguments.camera, taken),
            log=PosesLog(stages.show, bars.note, stages.expect),
        ).figures  # fmt: skip
    return figures, stages.seconds


def _train(
    folder: RunFolder, options: TrainOptions, bars: StagedProgress, page: LivePage
) -> dict[str, Any]:
    """The content of metrics.json."""
    import gsut
    from gsut.training import size_note

    if folder.read_json(METRICS) is not None and (folder.path / REPORT).is_file():
        bars.skip("training")
        return folder.read_json(METRICS)
    scene = gsut.load_dataset(folder.path / POSES, test_every=options.test_every)
    options = for_views(options, len(scene.train_indices))
    if (folder.path / OPTIONS).is_file():
        options = folder.read_options()
    for note in filter(None, (*scene.notes, size_note(scene, options))):
        bars.note(note)

    def show(row: dict[str, Any]) -> None:
        done = row["step"] / options.steps
        bars.show(done, f"step {row['step']} of {options.steps}", row["seconds_left"])

    with bars.stage("training"):
        watch = page.begin(scene, options)
        result = gsut.train(scene, options, out=folder.path, resume=True, progress=show, **watch)
    page.finish(result)
    return result.metrics


def _evenly(bars: StagedProgress, shares: dict[str, float]) -> Callable[[str, int, int, str], None]:
    """Shows sub-stages one after the other, each with its share of the stage, in any unit."""
    names, whole = list(shares), sum(shares.values())

    def show(name: str, done: int, total: int, text: str) -> None:
        if name in shares:  # the lens of a panorama is known, which was not expected
            before = sum(shares[other] for other in names[: names.index(name)])
            bars.show((before + shares[name] * done / max(1, total)) / whole, f"{name} {text}")

    return show


def _steps_seconds(figures: dict[str, Any], options: TrainOptions) -> float:
    """What the steps of the training will take, now that the size of the pictures is known."""
    from gsut import _core
    from gsut.training import track_training

    most = dataclasses.replace(options.resolved(), max_gaussians=options.most_gaussians)
    width, height = figures["size"]
    shrunk = min(1.0, options.max_side / max(width, height)) if options.max_side else 1.0
    return track_training(
        most, most.most_gaussians // 4, shrunk**2 * width * height / 1e6, 0,
        threads=options.threads or _core.num_threads(),
    ).predict_left(0)  # fmt: skip


def _capture_verdict(figures: dict[str, Any]) -> Verdict:
    """Of the pictures themselves."""
    rows = figures["frames"]
    unsharp = sum(bool(row.get("blurred")) for row in rows)
    what = f"{len(rows)} pictures of {figures['size'][0]} x {figures['size'][1]}"
    if len(rows) < _FEW_PICTURES:
        return Verdict(
            "usable", what, (f"only {len(rows)} pictures",),
            "take 60 or more, walking around what you want to see",
        )  # fmt: skip
    if unsharp > len(rows) / 4:
        return Verdict(
            "usable", what, (f"{unsharp} of them blurred",),
            "film more slowly, or with more light",
        )  # fmt: skip
    return Verdict("good", what)


def _said(figures: list[dict[str, Any]]) -> list[Verdict]:
    """The verdicts of stages that gave one."""
    return [Verdict.of(row["verdict"]) for row in figures if row.get("verdict")]


def _together(verdicts: list[Verdict]) -> Verdict:
    """The worst of them, the first of equals, with what the others say against the scene."""
    first = worst(verdicts)
    reasons = (r for v in (first, *verdicts) if v.level != "good" for r in v.reasons)
    return dataclasses.replace(first, reasons=tuple(dict.fromkeys(reasons)))


def _write_page(
    folder: RunFolder, state: dict[str, Any], notes: list[str], metrics: dict[str, Any]
) -> None:
    """scene.html: the verdict, a view that was held out, the pictures chosen, seconds, links."""
    from gsut.page import bytes_address, duration_text, html_table, sections_page

    strip = bytes_address((folder.path / POSES / CAPTURE_FOLDER / STRIP).read_bytes(), "image/jpeg")
    rows = [(name, duration_text(seconds)) for name, seconds in state["seconds"].items()]
    parts = [
        f"<p><b>{Verdict.of(state['verdict'])}</b></p>",
        f'<p><a href="{REPORT}">Report of the training</a>: held-out views beside photographs. '
        f'<a href="{POSES}/report.html">Report of the poses</a>: where the camera went, and its '
        "lens.</p>",
        *_result(folder, state, metrics),
        "<h2>Pictures</h2>",
        f'<img src="{strip}" alt="the pictures chosen" style="width: 100%">',
        "<h2>Time taken</h2>",
        html_table(rows),
    ]
    folder.write_text(PAGE, sections_page(folder.path.name, notes, parts))


def _result(folder: RunFolder, state: dict[str, Any], metrics: dict[str, Any]) -> list[str]:
    """Parts of a page: the held-out view of median quality beside its photograph, in words."""
    views = [row for row in metrics.get("views", []) if row.get("render") and row.get("truth")]
    views = [row for row in views if row.get("psnr") is not None]
    words = state["renders"]
    if not views or not words:
        return []
    said = "" if words == state["verdict"]["what"] else f"{words[:1].upper()}{words[1:]}. "
    middle = sorted(views, key=lambda row: row["psnr"])[len(views) // 2]
    pictures = "".join(
        f'<figure style="flex: 1; margin: 0"><img src="{RENDERS}/{middle[key]}" alt="{name}" '
        f'style="width: 100%"><figcaption>{name}</figcaption></figure>'
        for key, name in (("truth", "photograph"), ("render", "the scene, seen from there"))
    )
    return [
        "<h2>Scene</h2>",
        f'<div style="display: flex; gap: 1em">{pictures}</div>',
        f"<p>A photograph that the training has not seen, of median quality. {said}Look around: "
        f"<code>gsut view {html.escape(str(folder.path))}</code></p>",
    ]
