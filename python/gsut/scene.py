"""The whole way from videos or photographs to a scene, one line a stage.

Each line names the folder that does it. Every stage leaves its files in the run's folder, and a
stage whose files are complete is not repeated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gsut import _core
from gsut.bounds import name_wrong_kinds
from gsut.capture import Capture, capture
from gsut.data import Scene, load_dataset
from gsut.data.scene import choose_inner_views, hold_out_views
from gsut.evaluate import write_scene_page
from gsut.judge.checks import combine_verdicts, judge_pictures
from gsut.output_folder import claim_folder
from gsut.run import (
    RunFile,
    RunFolder,
    SceneOptions,
    StagedProgress,
    StageFollower,
    TrainOptions,
    Verdict,
)
from gsut.run.options import fit_to_views
from gsut.scene_folder import POSES, SceneFolder
from gsut.sfm import (
    PosesLog,
    PosesOptions,
    check_lens,
    find_poses,
    is_finished,
    read_finished,
)
from gsut.train import TrainResult, train
from gsut.training.first import describe_resizing

PAGE = "scene.html"

# Called as `on_progress(row)` with "stage", "share", "seconds_left" and "text".
OnProgress = Callable[[dict[str, Any]], None]
BeginWatch = Callable[[Scene, TrainOptions], Callable[..., bool] | None]


@dataclasses.dataclass
class SceneResult:
    """The result of `gsut.scene`; `gsut.load_run(result.path)` loads its Gaussians and dataset.

    Attributes:
        path: folder of the scene: scene.ply, scene.html, report.html, and the dataset in poses/.
        figures: the content of scene.json: pictures, registered, psnr, ssim, seconds, verdict ...
        trained: the result of the training; None if it was finished by an earlier call.
    """

    path: Path
    figures: dict[str, Any]
    trained: TrainResult | None = None

    @property
    def verdict(self) -> Verdict:
        """How good the scene is, why, and what to try next."""
        return Verdict.from_dict(self.figures["verdict"])

    @property
    def page(self) -> Path:
        """The page that shows all stages."""
        return self.path / PAGE


@name_wrong_kinds
def make_scene(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    options: SceneOptions | None = None,
    *,
    progress: bool | OnProgress = True,
    watch: BeginWatch | None = None,
) -> SceneResult:
    """Makes a scene from videos or photographs of one camera: pictures, poses, training, verdict.

    If interrupted, the same call resumes where it stopped: a stage is repeated only if what it was
    made from has changed, which a note reports. When everything is finished, it returns the result
    at once.

    Args:
        inputs: videos, photographs and folders of photographs, all of one camera; one or several.
        out: folder of the scene and all its stages.
        options: every setting; None: the defaults.
        progress: True shows a bar; a function receives dicts with "stage", "share" (of everything,
            0 to 1), "seconds_left" and "text".
        watch: called with the dataset and the options of the training before it begins; returns
            the `watch` of `gsut.train`.

    Returns:
        The folder, the figures and the verdict.

    Raises:
        InputError: unusable inputs, or `out` holds a scene with other settings, or a trained one of
            other videos or photographs.
        SolveError: no poses could be found; says why.
    """
    sources = [inputs] if isinstance(inputs, str | os.PathLike) else list(inputs)
    folder = SceneFolder(sources, out, options or SceneOptions())
    if folder.is_finished():
        return SceneResult(folder.path, folder.figures)
    check_lens(folder.options.camera)
    with (
        claim_folder(folder.poses, "poses", folder.inputs[0]),
        _start_bars(progress) as bars,
    ):
        pictures = _choose_pictures(folder, bars)  # capture/: frames, a first lens
        poses, seconds = _find_poses(folder, pictures, bars)  # sfm/: poses, the lens
        metrics, trained = _train(folder, poses, bars, watch)  # train.py
        # A stage that an earlier call finished took what its figures say.
        taken = {POSES: seconds or poses["seconds"]["total"]}
        _report(folder, pictures, poses, metrics, bars, taken)  # run/: verdict; evaluate/: page
    return SceneResult(folder.path, folder.figures, trained)


def is_scene_finished(out: str | os.PathLike[str]) -> bool:
    """Returns whether a folder holds a scene whose stages are all finished."""
    figures = RunFolder(out).read_json(RunFile.STATE)
    return figures is not None and "verdict" in figures


def _choose_pictures(folder: SceneFolder, bars: StagedProgress) -> Capture:
    """Writes the pictures worth keeping below poses/."""
    o = folder.options
    if folder.changes:
        bars.note(f"pictures are chosen again ({folder.changes})")
    with bars.stage("capture"):
        shares = {"looking": 0.7, "frames": 0.3, "photographs": 1.0}
        pictures = capture(
            folder.inputs, folder.pictures, count=o.frames, nadir_cap=o.nadir_cap,
            on_progress=_spread_over(bars, shares),
        )  # fmt: skip
        for note in pictures.notes:
            bars.note(note)
    _scale_training(bars, _make_training_options(o), pictures.figures["size"])
    folder.save()
    return pictures


def _find_poses(
    folder: SceneFolder, pictures: Capture, bars: StagedProgress
) -> tuple[dict[str, Any], float]:
    """Finds poses and lens; returns the content of poses.json and the seconds taken here."""
    o, out = folder.options, folder.poses
    options = PosesOptions(fov=o.fov, keep_all_pixels=o.keep_all_pixels)
    done = read_finished(pictures.path, out, o.camera, options)
    if done is not None:
        return done, 0.0
    if is_finished(out):
        bars.note("poses are found again: those in the folder are of other pictures")
    bars.note(_announce(o, pictures))
    with contextlib.closing(StageFollower(bars, len(pictures.figures["frames"]))) as stages:
        log = PosesLog(stages.show, bars.note, stages.expect)
        figures = find_poses(pictures.path, out, camera=o.camera, options=options, log=log).figures
    return figures, stages.seconds


def _announce(options: SceneOptions, pictures: Capture) -> str:
    """Says how much there is to do."""
    training, threads = _make_training_options(options), _core.num_threads()
    return (
        f"poses of {len(pictures.figures['frames'])} pictures, then {training.steps:,} steps of "
        f"training with up to {training.most_gaussians:,} Gaussians on {threads} "
        f"processor{'s' if threads > 1 else ''}"
    )


def _scale_training(bars: StagedProgress, options: TrainOptions, size: Sequence[int]) -> None:
    """Expects the training to take its time by the number of steps and the size of the pictures."""
    # A step takes about twice as long of pictures twice as wide: not all of it is their pixels.
    bars.scale(["training"], options.steps * min(options.max_side, max(size)))


def _make_training_options(options: SceneOptions) -> TrainOptions:
    given: dict[str, Any] = {} if options.steps is None else {"steps": options.steps}
    return TrainOptions(preset=options.preset, keep_all_pixels=options.keep_all_pixels, **given)


def _train(
    folder: SceneFolder, poses: dict[str, Any], bars: StagedProgress, watch: BeginWatch | None
) -> tuple[dict[str, Any], TrainResult | None]:
    """Trains on the dataset in poses/; returns the content of metrics.json and the result, if this
    process made it."""
    run, options = folder.run, _make_training_options(folder.options)
    dataset = load_dataset(folder.poses, test_every=0)
    begun = run.path / RunFile.OPTIONS
    if begun.is_file() and (changed := folder.drop_other_training(dataset)):
        bars.note(f"training starts again: the {changed} have changed")
    if begun.is_file():
        if folder.is_trained():
            bars.skip("training")
            return run.read_json(RunFile.METRICS), None
        options = run.read_options()
        dataset = hold_out_views(dataset, options.test_names or ())
    else:
        names = [view.name for view in dataset.views]
        rows = [row for row in poses["views"] if row["registered"]]
        spare = [row["points_held_without"] for row in rows if "points_held_without" in row]
        is_known = len(spare) == len(names)
        held_out = choose_inner_views(names, options.test_every, spare if is_known else None)
        dataset = hold_out_views(dataset, held_out)
        options = dataclasses.replace(options, test_names=tuple(held_out))
        options = fit_to_views(options, len(dataset.train_indices))
    for note in filter(None, (*dataset.notes, describe_resizing(dataset, options))):
        bars.note(note)

    def show(row: dict[str, Any]) -> None:
        done = row["step"] / options.steps
        bars.show(done, f"step {row['step']} of {options.steps}", row["seconds_left"])

    lens = dataset.cameras[0]
    _scale_training(bars, options, (lens.width, lens.height))
    with bars.stage("training"):
        watched = None if watch is None else watch(dataset, options)
        trained = train(dataset, options, out=run.path, resume=True, progress=show, watch=watched)
    return trained.metrics, trained


def _report(
    folder: SceneFolder, pictures: Capture, poses: dict[str, Any], metrics: dict[str, Any],
    bars: StagedProgress, taken: dict[str, float],
) -> None:  # fmt: skip
    """Judges the scene as a whole; writes scene.html and scene.json.

    taken: seconds of the stages that are not the bar's own.
    """
    with bars.stage("report"):
        bars.show(0.5)
        seconds = {
            "capture": bars.seconds["capture"],
            **taken,
            "training": bars.seconds["training"] or metrics["train_seconds"],
        }
        found = filter(None, (row.get("verdict") for row in (metrics, poses)))
        verdicts = [Verdict.from_dict(values) for values in found]
        verdict = combine_verdicts(*verdicts, judge_pictures(pictures.figures))
        folder.figures |= {
            "seconds": seconds,
            "pictures": len(pictures.figures["frames"]),
            "registered": poses["registered"],
            **{key: metrics.get(key) for key in ("psnr", "ssim", "num_gaussians", "steps")},
            "renders": (metrics.get("verdict") or {}).get("what"),
            "verdict": verdict.as_dict(),
        }
        strip, notes = folder.pictures, pictures.notes
        write_scene_page(folder.run, PAGE, folder.figures, metrics, strip, POSES, notes)
    seconds["report"] = bars.seconds["report"]
    folder.save()


def _start_bars(progress: bool | OnProgress) -> StagedProgress:
    """Returns the bar of the whole command, or what passes its states to a function."""
    stages = ("capture", "training", "report")  # those of `find_poses` are added
    on_progress = progress if callable(progress) else lambda row: None
    return StagedProgress("scene", stages, progress is True, on_progress=on_progress)


def _spread_over(
    bars: StagedProgress, shares: dict[str, float]
) -> Callable[[str, int, int, str], None]:
    """Returns a function that shows sub-stages in order, each as its share of the stage."""
    names, whole = list(shares), sum(shares.values())

    def show(name: str, done: int, total: int, text: str) -> None:
        if name in shares:  # the fit of a panorama's lens is not: it takes no time
            before = sum(shares[other] for other in names[: names.index(name)])
            bars.show((before + shares[name] * done / max(1, total)) / whole, f"{name} {text}")

    return show
