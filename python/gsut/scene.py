"""The whole way from videos or photographs to a scene, one line a stage.

Each line names the folder that does it. Every stage leaves its files in the run's folder, and a
stage whose files are complete is not repeated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsut import _core
from gsut._core import InputError
from gsut.capture import Capture, capture, find_changed_inputs
from gsut.data import CAPTURE_FOLDER, Scene, load_dataset
from gsut.data.scene import choose_inner_views, hold_out_views
from gsut.evaluate import write_scene_page
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
from gsut.run.options import fit_to_views, format_flag
from gsut.run.verdicts import combine_verdicts, judge_pictures
from gsut.sfm import (
    PosesLog,
    PosesOptions,
    add_lens_readout,
    check_lens,
    find_poses,
    is_finished,
    read_finished,
)
from gsut.train import TrainResult, train
from gsut.training.first import describe_resizing
from gsut.training.record import list_changed_data

if TYPE_CHECKING:
    from gsut.view import LiveScene

POSES = "poses"  # folder of the pictures and poses, inside the run's folder
STATE = "scene.json"  # paths and settings; seconds and verdict once the scene is finished
PAGE = "scene.html"
_NO_SETTING = {"threads"}  # options that do not change the result

# Called as `on_progress(row)` with "stage", "share", "seconds_left" and "text".
OnProgress = Callable[[dict[str, Any]], None]


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


def make_scene(
    inputs: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    options: SceneOptions | None = None,
    *,
    progress: bool | OnProgress = True,
    watcher: LiveScene | None = None,
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
        watcher: shows on a page what is found, while it is found; None: nobody looks.

    Returns:
        The folder, the figures and the verdict.

    Raises:
        InputError: unusable inputs, or `out` holds a scene with other settings, or a trained one of
            other videos or photographs.
        SolveError: no poses could be found; says why.
    """
    sources = [inputs] if isinstance(inputs, str | os.PathLike) else list(inputs)
    making = _SceneInProgress(sources, out, options or SceneOptions(), watcher)
    if "verdict" in making.figures:
        return SceneResult(making.folder.path, making.figures)
    with making.claim_poses(), _start_bars(progress, watcher) as bars:
        pictures = making.choose_pictures(bars)  # capture/: frames worth keeping, a first lens
        poses = making.find_poses(pictures, bars)  # sfm/: where each picture was taken, the lens
        metrics = making.train(bars)  # train.py
        making.report(pictures, poses, metrics, bars)  # run/: verdict; evaluate/: page
    return SceneResult(making.folder.path, making.figures, making.trained)


def is_scene_finished(out: str | os.PathLike[str]) -> bool:
    """Returns whether a folder holds a scene whose stages are all finished."""
    figures = RunFolder(out).read_json(STATE)
    return figures is not None and "verdict" in figures


class _SceneInProgress:
    """A scene while it is being made: its folder, its settings, and what is known about it.

    Attributes:
        folder: of the run.
        figures: the content of scene.json so far.
        trained: the result of the training, if this process made it.
    """

    def __init__(
        self,
        inputs: Sequence[str | os.PathLike[str]],
        out: str | os.PathLike[str],
        options: SceneOptions,
        watcher: LiveScene | None,
    ) -> None:
        if not inputs:
            raise InputError("a scene needs at least one video, photograph or folder")
        self.folder = RunFolder.claim(out, "scene", inputs[0])
        self.trained: TrainResult | None = None
        self._inputs, self._options = [os.fspath(name) for name in inputs], options
        self._watcher = watcher
        self._poses_seconds = 0.0  # taken by the stages of `find_poses` in this process
        self.figures = self._read_figures()
        self._changes = self._find_changes()

    def _read_figures(self) -> dict[str, Any]:
        """Returns the figures that the folder holds, or new ones.

        Raises:
            InputError: it holds a scene of other inputs or settings, or a run of another command.
        """
        settings = dataclasses.asdict(self._options)
        key = {
            "inputs": [str(Path(name).resolve()) for name in self._inputs],
            **{name: value for name, value in settings.items() if name not in _NO_SETTING},
        }
        figures = self.folder.read_json(STATE)
        if figures is None:
            self.folder.refuse_run()
            return {"key": key}
        different = [name for name in key if figures["key"].get(name, key[name]) != key[name]]
        if different:
            name = different[0]
            what = name if name == "inputs" else format_flag(name)
            raise InputError(
                f"{self.folder.path} holds a scene with other {what} "
                f"({figures['key'].get(name)}, now {key[name]}); give another output folder "
                "(nothing was overwritten)"
            )
        return figures

    def _find_changes(self) -> str:
        """Names the inputs that changed since pictures were chosen; "" if none did.

        Raises:
            InputError: they did, and a scene has been trained.
        """
        changes = find_changed_inputs(self._inputs, self.folder.path / POSES / CAPTURE_FOLDER)
        if changes and self._is_trained():
            raise InputError(
                f"{self.folder.path} holds a scene of other pictures: {changes}; give another "
                "output folder (nothing was overwritten)"
            )
        return changes

    def _is_trained(self) -> bool:
        return all(
            (self.folder.path / name).is_file() for name in (RunFile.METRICS, RunFile.REPORT)
        )

    def claim_poses(self) -> contextlib.AbstractContextManager:
        """Takes the folder of the poses for the duration of the block; checks the lens first."""
        check_lens(self._options.camera)
        return claim_folder(self.folder.path / POSES, "poses", self._inputs[0])

    def choose_pictures(self, bars: StagedProgress) -> Capture:
        """Writes the pictures worth keeping below poses/."""
        o = self._options
        if self._changes:
            bars.note(f"pictures are chosen again ({self._changes})")
        with bars.stage("capture"):
            shares = {"looking": 0.7, "frames": 0.3, "photographs": 1.0}
            pictures = capture(
                self._inputs, self.folder.path / POSES / CAPTURE_FOLDER, count=o.frames,
                caps=(o.nadir_cap, o.zenith_cap), on_progress=_spread_over(bars, shares),
            )  # fmt: skip
            for note in pictures.notes:
                bars.note(note)
        if self._watcher is not None:
            self._watcher.show_capture(pictures.path, pictures.figures["frames"])
        self.folder.write_json(STATE, self.figures)
        return pictures

    def find_poses(self, pictures: Capture, bars: StagedProgress) -> dict[str, Any]:
        """Finds poses and lens, and returns the content of poses.json."""
        o, out = self._options, self.folder.path / POSES
        options = PosesOptions(fov=o.fov, shutter=o.shutter, seed=o.seed, threads=o.threads)
        options = add_lens_readout(options, o.camera, pictures.figures)
        done = read_finished(pictures.path, out, o.camera, options)
        if done is not None:
            return done
        if is_finished(out):
            bars.note("poses are found again: those in the folder are of other pictures")
        bars.note(self._announce(pictures))
        with contextlib.closing(StageFollower(bars)) as stages:
            show_poses = None if self._watcher is None else self._watcher.show_poses
            log = PosesLog(stages.show, bars.note, stages.expect, show_poses)
            figures = find_poses(
                pictures.path, out, camera=o.camera, options=options, log=log
            ).figures
        self._poses_seconds = stages.seconds
        return figures

    def _announce(self, pictures: Capture) -> str:
        """Says how much there is to do."""
        options, threads = self._make_training_options(), self._options.threads
        threads = threads or _core.num_threads()
        return (
            f"poses of {len(pictures.figures['frames'])} pictures, then {options.steps:,} steps of "
            f"training with up to {options.most_gaussians:,} Gaussians on {threads} "
            f"processor{'s' if threads > 1 else ''}"
        )

    def _make_training_options(self) -> TrainOptions:
        o = self._options
        make = functools.partial(TrainOptions, preset=o.preset, seed=o.seed, threads=o.threads)
        return make() if o.steps is None else make(steps=o.steps)

    def train(self, bars: StagedProgress) -> dict[str, Any]:
        """Trains on the dataset in poses/, and returns the content of metrics.json."""
        folder, options = self.folder, self._make_training_options()
        dataset = load_dataset(folder.path / POSES, test_every=0)
        if (folder.path / RunFile.OPTIONS).is_file():
            self._drop_other_training(dataset, bars)
        if (folder.path / RunFile.OPTIONS).is_file():
            if self._is_trained():
                bars.skip("training")
                return folder.read_json(RunFile.METRICS)
            options = folder.read_options()
            dataset = hold_out_views(dataset, options.test_names or ())
        else:
            names = [view.name for view in dataset.views]
            held_out = choose_inner_views(names, options.test_every)
            dataset = hold_out_views(dataset, held_out)
            options = dataclasses.replace(options, test_names=tuple(held_out))
            options = fit_to_views(options, len(dataset.train_indices))
        for note in filter(None, (*dataset.notes, describe_resizing(dataset, options))):
            bars.note(note)

        def show(row: dict[str, Any]) -> None:
            done = row["step"] / options.steps
            bars.show(done, f"step {row['step']} of {options.steps}", row["seconds_left"])

        with bars.stage("training"):
            watcher = self._watcher
            watch = None if watcher is None else watcher.begin_training(dataset, options)
            self.trained = train(
                dataset, options, out=folder.path, resume=True, progress=show, watch=watch
            )
        return self.trained.metrics

    def _drop_other_training(self, dataset: Scene, bars: StagedProgress) -> None:
        """Removes an unfinished training on other pictures or poses.

        Raises:
            InputError: that training is finished.
        """
        changed = " and ".join(list_changed_data(self.folder, dataset))
        if changed and self._is_trained():
            raise InputError(
                f"{self.folder.path} holds a scene that was trained on other {changed}; give "
                "another output folder"
            )
        if changed:
            bars.note(f"training starts again: the {changed} have changed")
            self.folder.refuse_finished(self._inputs[0])

    def report(
        self,
        pictures: Capture,
        poses: dict[str, Any],
        metrics: dict[str, Any],
        bars: StagedProgress,
    ) -> None:
        """Judges the scene as a whole; writes scene.html and scene.json."""
        with bars.stage("report"):
            bars.show(0.5)
            seconds = {
                "capture": bars.seconds["capture"],
                # A stage that an earlier call finished took what its figures say.
                POSES: self._poses_seconds or poses["seconds"]["total"],
                "training": bars.seconds["training"] or metrics["train_seconds"],
            }
            found = filter(None, (row.get("verdict") for row in (metrics, poses)))
            verdicts = [Verdict.from_dict(values) for values in found]
            verdict = combine_verdicts(*verdicts, judge_pictures(pictures.figures))
            self.figures |= {
                "seconds": seconds,
                "pictures": len(pictures.figures["frames"]),
                "registered": poses["registered"],
                **{key: metrics.get(key) for key in ("psnr", "ssim", "num_gaussians", "steps")},
                "renders": (metrics.get("verdict") or {}).get("what"),
                "verdict": verdict.as_dict(),
            }
            strip = self.folder.path / POSES / CAPTURE_FOLDER
            write_scene_page(self.folder, PAGE, self.figures, metrics, strip, POSES, pictures.notes)
        seconds["report"] = bars.seconds["report"]
        self.folder.write_json(STATE, self.figures)


def _start_bars(progress: bool | OnProgress, watcher: LiveScene | None) -> StagedProgress:
    """Returns the bar of the whole command, or what passes its states to functions."""
    listeners = [progress] if callable(progress) else []
    if watcher is not None:
        listeners.append(watcher.show_progress)

    def show(row: dict[str, Any]) -> None:
        for listener in listeners:
            listener(row)

    stages = ("capture", "training", "report")  # those of `find_poses` are added
    return StagedProgress("scene", stages, progress is True, on_progress=show)


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
