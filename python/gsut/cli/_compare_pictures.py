"""What a file shows otherwise than the scene that it was made of: both drawn, and compared."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError

_VIEWS = 3  # places that are compared
_MOST_SIDE = 480  # pixels of a picture's longer side
_UNSEEN_LEVELS = 2.0  # of 255: a difference that nobody sees, of one pixel in a hundred


def compare_pictures(source: Path, data: str | None, before: Any, after: Any) -> dict[str, Any]:
    """Draws Gaussians before and after, from some of a run's photographs' places if it has any.

    Args:
        source: the run or the file.
        data: a run's dataset, if it is not where training read it.
        before, after: Gaussians whose means are in the same coordinates.

    Returns:
        "views", and in levels of 255 the "mean" difference and that of one pixel in a hundred.
    """
    import gsut
    from gsut.render import to_uint8

    places = _list_places(source, data, before)
    apart = []
    for camera, pose in places:
        drawn = [
            to_uint8(gsut.render(dataclasses.replace(g, origin=np.zeros(3)), camera, pose).image)
            for g in (before, after)
        ]
        apart.append(np.abs(drawn[0].astype(np.int16) - drawn[1]).ravel())
    levels = np.concatenate(apart)
    return {
        "views": len(places),
        "mean": float(levels.mean()),
        "hundredth": float(np.percentile(levels, 99)),
    }


def describe_comparison(found: dict[str, Any]) -> str:
    """Says what a viewer shows otherwise."""
    views = "1 view" if found["views"] == 1 else f"{found['views']} views"
    if found["hundredth"] <= _UNSEEN_LEVELS:
        return f"read back and drawn from {views}, no difference from the scene can be seen"
    return (
        f"read back and drawn from {views}, colours differ from the scene's by "
        f"{found['mean']:.1f} of 255 levels on average, and by {found['hundredth']:.0f} or more in "
        "one pixel of a hundred; look at both before you delete the original"
    )


def _list_places(source: Path, data: str | None, gaussians: Any) -> list[tuple[Any, Any]]:
    """Lists lenses and poses, of a run's photographs or from in front of a file's Gaussians."""
    from gsut.render import place_about
    from gsut.run import RunFolder
    from gsut.training import read_scene
    from gsut.view import Stage

    if source.is_dir():
        try:
            scene = read_scene(RunFolder.open(source), data)[1]
        except InputError:  # photographs that are elsewhere
            scene = None
        if scene is not None:
            rows = list(scene.train_indices or range(len(scene)))
            some = {rows[k] for k in np.linspace(0, len(rows) - 1, _VIEWS).round().astype(int)}
            return [
                (_shrink(scene.camera(row)),
                 place_about(scene.views[row].camera_from_world, gaussians.origin))
                for row in sorted(some)
            ]  # fmt: skip
    stage = Stage("", "file", dataclasses.replace(gaussians, origin=np.zeros(3)))
    return [(_shrink(stage.cameras[0]), stage.place()["pose"])]


def _shrink(camera: Any) -> Any:
    scale = min(1.0, _MOST_SIDE / max(camera.width, camera.height))
    return camera.resize(*(max(1, round(scale * side)) for side in (camera.width, camera.height)))
