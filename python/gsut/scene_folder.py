"""The folder of a scene: its settings, which stages are finished, and what has changed since."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.capture import find_changed_inputs
from gsut.data import CAPTURE_FOLDER, Scene
from gsut.run import RunFile, RunFolder, SceneOptions
from gsut.run.options import format_flag
from gsut.training.record import list_changed_data

POSES = "poses"  # folder of the pictures and poses, inside the run's folder
_NO_SETTING = {"threads"}  # options that do not change the result


class SceneFolder:
    """A scene's folder, claimed for these inputs and settings.

    Args:
        inputs: videos, photographs and folders of photographs.
        out: the folder.
        options: of the scene.

    Attributes:
        run: the folder as that of a run.
        inputs, options: as given.
        figures: the content of scene.json so far.
        changes: names the inputs that changed since pictures were chosen; "" if none did.

    Raises:
        InputError: there is no input, or the folder holds another scene or the run of another
            command.
    """

    def __init__(
        self,
        inputs: Sequence[str | os.PathLike[str]],
        out: str | os.PathLike[str],
        options: SceneOptions,
    ) -> None:
        if not inputs:
            raise InputError("a scene needs at least one video, photograph or folder")
        self.run = RunFolder.claim(out, "scene", inputs[0])
        self.inputs, self.options = [os.fspath(name) for name in inputs], options
        self.figures = self._read_figures()
        self.changes = self._find_changes()

    @property
    def path(self) -> Path:
        """Path of the folder."""
        return self.run.path

    @property
    def poses(self) -> Path:
        """Folder of the dataset: pictures, poses and lens."""
        return self.path / POSES

    @property
    def pictures(self) -> Path:
        """Folder of the pictures that were chosen."""
        return self.poses / CAPTURE_FOLDER

    def is_finished(self) -> bool:
        """Returns whether all stages are finished."""
        return "verdict" in self.figures

    def is_trained(self) -> bool:
        """Returns whether the training is finished."""
        return all((self.path / name).is_file() for name in (RunFile.METRICS, RunFile.REPORT))

    def save(self) -> None:
        """Writes the figures to scene.json."""
        self.run.write_json(RunFile.STATE, self.figures)

    def drop_other_training(self, dataset: Scene) -> str:
        """Removes an unfinished training on other pictures or poses; names what has changed.

        Raises:
            InputError: that training is finished.
        """
        changed = " and ".join(list_changed_data(self.run, dataset))
        if changed and self.is_trained():
            raise InputError(
                f"{self.path} holds a scene that was trained on other {changed}; give another "
                "output folder"
            )
        if changed:
            self.run.refuse_finished(self.inputs[0])
        return changed

    def _read_figures(self) -> dict[str, Any]:
        """Returns the figures that the folder holds, or new ones."""
        settings = dataclasses.asdict(self.options)
        key = {
            "inputs": [str(Path(name).resolve()) for name in self.inputs],
            **{name: value for name, value in settings.items() if name not in _NO_SETTING},
        }
        figures = self.run.read_json(RunFile.STATE)
        if figures is None:
            self.run.refuse_run()
            return {"key": key}
        different = [name for name in key if figures["key"].get(name, key[name]) != key[name]]
        if different:
            name = different[0]
            what = name if name == "inputs" else format_flag(name)
            raise InputError(
                f"{self.path} holds a scene with other {what} ({figures['key'].get(name)}, now "
                f"{key[name]}); give another output folder (nothing was overwritten)"
            )
        return figures

    def _find_changes(self) -> str:
        changes = find_changed_inputs(self.inputs, self.pictures)
        if changes and self.is_trained():
            raise InputError(
                f"{self.path} holds a scene of other pictures: {changes}; give another output "
                "folder (nothing was overwritten)"
            )
        return changes
