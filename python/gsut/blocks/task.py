"""Defines all that the training of one block in one round depends on, and how it travels."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import Shutter
from gsut.data import Scene, View
from gsut.gaussians import Gaussians, merge_gaussians
from gsut.lens.files import camera_from_values, values_from_camera
from gsut.render import Falloff, Light
from gsut.run import TrainOptions

_ARRAYS = ("means", "quats", "log_scales", "opacity_logits", "sh")


@dataclasses.dataclass(frozen=True)
class Trained:
    """Gaussians as training leaves them.

    Attributes:
        gaussians: N Gaussians.
        moments: Adam's first and second of each; none if they were not trained.
    """

    gaussians: Gaussians
    moments: tuple[Gaussians, ...] = ()

    def __len__(self) -> int:
        return len(self.gaussians)

    def __getitem__(self, rows: np.ndarray) -> Trained:
        return Trained(self.gaussians[rows], tuple(each[rows] for each in self.moments))

    def as_dict(self) -> dict[str, Any]:
        """Returns a dict for `write_checkpoint`."""
        moments = [list_arrays(each) for each in self.moments]
        return {"own": list_arrays(self.gaussians), "moments": moments}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Trained:
        """Restores what `as_dict` returned."""
        moments = (Gaussians(**each) for each in values["moments"])
        return cls(Gaussians(**values["own"]), tuple(moments))

    @classmethod
    def join(cls, parts: Sequence[Trained]) -> Trained:
        """Joins parts in their order; moments of untrained parts beside trained ones are 0."""
        known = next((part.moments for part in parts if part.moments), ())
        moments = (
            merge_gaussians(
                [(p.moments or (p.gaussians.make_zeros(),) * len(known))[i] for p in parts]
            )
            for i in range(len(known))
        )
        return cls(merge_gaussians([part.gaussians for part in parts]), tuple(moments))


@dataclasses.dataclass(frozen=True)
class BlockTask:
    """One block in one round: the argument of a pure function.

    Attributes:
        scene: views that show the block, at the size to train at; all are training views.
        options: of the block; `steps` are those in all rounds.
        share: of all the scene's Gaussians that the block has at most.
        extent: of the whole scene in world units.
        light: of the views, fixed; None: none was found.
        tiles: for each view which of its tiles of 16 x 16 pixels show the block, bool.
        rates: for each view the share of the epochs in which it is used.
        keep_bytes: of decoded photographs; the bits do not depend on it.
        own: first Gaussians; if they have moments, training continues after `begin` steps.
        context: Gaussians of other blocks, which are drawn and not changed.
        begin, end: steps of this round.
        segments: parts of the round; after each there is a state.
    """

    scene: Scene
    options: TrainOptions
    share: float
    extent: float
    light: Light | None
    tiles: list[np.ndarray]
    rates: np.ndarray
    keep_bytes: int
    own: Trained
    context: Gaussians
    begin: int
    end: int
    segments: int

    def find_last_step(self, segment: int) -> int:
        """Returns the last step of a segment (from 0)."""
        return self.begin + (self.end - self.begin) * (segment + 1) // self.segments

    def as_dict(self) -> dict[str, Any]:
        """Returns a dict for `write_checkpoint`, which names the photographs and does not hold
        them."""
        scene = self.scene
        return {
            "path": str(scene.path),
            "cameras": [values_from_camera(camera) for camera in scene.cameras],
            "file_cameras": [values_from_camera(camera) for camera in scene.file_cameras],
            "views": [_pack_view(view) for view in scene.views],
            "world_offset": np.array(scene.world_offset),
            "decodes_small": scene.decodes_small,
            "fixed": list(scene.fixed),
            "options": self.options.to_json(),
            "share": self.share,
            "extent": self.extent,
            "light": None if self.light is None else pack_light(self.light),
            "tiles": [np.array(tiles) for tiles in self.tiles],
            "rates": self.rates,
            "keep_bytes": self.keep_bytes,
            **self.own.as_dict(),
            "context": list_arrays(self.context),
            "begin": self.begin,
            "end": self.end,
            "segments": self.segments,
        }

    @classmethod
    def from_dict(
        cls, values: dict[str, Any], place: Callable[[str], str] = lambda path: path
    ) -> BlockTask:
        """Restores what `as_dict` returned.

        Args:
            values: its result.
            place: maps the path of a photograph or mask to that on this machine.
        """
        scene = Scene(
            Path(values["path"]),
            tuple(camera_from_values(each) for each in values["cameras"]),
            tuple(_unpack_view(each, place) for each in values["views"]),
            np.zeros((0, 3)), np.zeros((0, 3)), tuple(range(len(values["views"]))), (),
            values["world_offset"],
            file_cameras=tuple(camera_from_values(each) for each in values["file_cameras"]),
            decodes_small=values["decodes_small"], fixed=tuple(values["fixed"]),
        )  # fmt: skip
        names = ("share", "extent", "tiles", "rates", "keep_bytes", "begin", "end", "segments")
        rest: Any = {name: values[name] for name in names}
        return cls(
            scene=scene, options=TrainOptions.from_json(values["options"]),
            light=None if values["light"] is None else unpack_light(values["light"]),
            own=Trained.from_dict(values), context=Gaussians(**values["context"]), **rest,
        )  # fmt: skip


def list_photographs(values: dict[str, Any]) -> list[str]:
    """Returns the paths of the files that a task (`BlockTask.as_dict`) reads."""
    paths = [v[name] for v in values["views"] for name in ("image_path", "mask_path")]
    in_memory = {v["image_path"] for v in values["views"] if v["pixels"] is not None}
    return sorted({path for path in paths if path is not None} - in_memory)


def list_arrays(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Returns the arrays of Gaussians, without their origin, for `write_checkpoint`."""
    return {name: getattr(gaussians, name) for name in _ARRAYS}


def _pack_view(view: View) -> dict[str, Any]:
    values = {field.name: getattr(view, field.name) for field in dataclasses.fields(view)}
    values["image_path"] = str(view.image_path)
    values["mask_path"] = None if view.mask_path is None else str(view.mask_path)
    del values["depth_path"], values["depth_form"]
    values["shutter"] = None
    if view.shutter is not None:
        values["shutter"] = [view.shutter.direction, view.shutter.parity]
    return values


def _unpack_view(values: dict[str, Any], place: Callable[[str], str]) -> View:
    mask, shutter = values["mask_path"], values["shutter"]
    given = values | {
        "image_path": Path(place(values["image_path"])),
        "mask_path": None if mask is None else Path(place(mask)),
        "shutter": None if shutter is None else Shutter(*shutter),
    }
    return View(**given)


def pack_light(light: Light) -> dict[str, Any]:
    return {
        "gains": light.gains,
        "falloffs": [None if each is None else each.as_dict() for each in light.falloffs],
    }


def unpack_light(values: dict[str, Any]) -> Light:
    return Light(values["gains"], tuple(Falloff.from_dict(each) for each in values["falloffs"]))
