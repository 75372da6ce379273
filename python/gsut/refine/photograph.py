"""Finds where a photograph was taken, from its file or array, its lens and a trained scene."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError, Shutter
from gsut.bounds import name_wrong_kinds
from gsut.data import Scene
from gsut.data.images import decode_image, decode_mask, shrink_image, shrink_mask
from gsut.gaussians import Gaussians
from gsut.lens import Camera, load_lens
from gsut.refine.localization import Localized, localize_image
from gsut.refine.pose import SMALLEST_SIDE
from gsut.sfm.shutter import list_likely_shutters

_Photograph = str | os.PathLike[str] | np.ndarray


@name_wrong_kinds
def localize(
    image: _Photograph,
    scene: Scene,
    gaussians: Gaussians,
    *,
    camera: Camera | str | os.PathLike[str] | None = None,
    mask: _Photograph | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    shutter: str = "auto",
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Localized:
    """Finds where a photograph of a trained scene was taken, as `gsut localize` does.

    Args:
        image: its file, or (H, W, 3) uint8 RGB.
        scene: the dataset that the Gaussians were trained on.
        gaussians: the trained scene; see `load_run`.
        camera: the photograph's lens, its file, or a name that `find_lenses` knows; None: the
            scene's only camera.
        mask: a file, black where the photograph does not count, or (H, W) bool.
        background: colour behind everything, as in training.
        shutter: "global"; "rolling": each line has its own pose, in the order of the scene's
            photographs, or along the longer side; "auto": as the scene's photographs if its only
            camera took this one too, otherwise as the photograph shows.
        on_progress: called with (stage, done, total).

    Returns:
        The pose, in the coordinates of `scene`, with its uncertainty. Photographs larger than those
        of the scene are shrunk to their width.

    Raises:
        InputError: the photograph has no lens, or its shape differs from the lens' or the mask's.
        SolveError: the photograph shows another place, or was taken through another lens.
    """
    name, pixels, valid = _read_photograph(image)
    if min(valid.shape) < SMALLEST_SIDE:
        raise InputError(
            f"{name} is {valid.shape[1]} x {valid.shape[0]} pixels; a photograph of at least "
            f"{SMALLEST_SIDE} a side is needed"
        )
    if mask is not None:
        drawn = np.asarray(mask, bool) if isinstance(mask, np.ndarray) else decode_mask(Path(mask))
        if drawn.shape != valid.shape:
            what = "the mask" if isinstance(mask, np.ndarray) else str(mask)
            raise InputError(
                f"{what} is {drawn.shape[1]} x {drawn.shape[0]}, {name} is "
                f"{valid.shape[1]} x {valid.shape[0]}: a mask has its image's size"
            )
        valid = valid & drawn
    lens = _choose_lens(name, pixels, scene, camera)
    size = (lens.width, lens.height)
    indices = scene.train_indices or range(len(scene.views))
    return localize_image(
        gaussians,
        [(scene.camera(index), scene.views[index].camera_from_world) for index in indices],
        lens,
        shrink_image(pixels, *size),
        shrink_mask(valid, *size),
        background=background,
        shutter=_choose_shutter(shutter, scene, lens, camera is None),
        on_progress=on_progress,
    )


def _read_photograph(image: _Photograph) -> tuple[str, np.ndarray, np.ndarray]:
    """Returns a photograph's name, (H, W, 3) uint8 and (H, W) bool: all, or where alpha is full."""
    if isinstance(image, np.ndarray):
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise InputError(
                f"the image is {image.dtype} of shape {image.shape}, expected uint8 of (H, W, 3)"
            )
        return "the image", image, np.ones(image.shape[:2], bool)
    pixels, alpha = decode_image(Path(image))
    return str(image), pixels, np.ones(pixels.shape[:2], bool) if alpha is None else alpha


def _choose_lens(
    name: str, pixels: np.ndarray, scene: Scene, given: Camera | str | os.PathLike[str] | None
) -> Camera:
    """Chooses the lens, sized to the photograph or to the training images if they are smaller."""
    height, width = pixels.shape[:2]
    if isinstance(given, Camera):
        camera, source = given, "camera"
    elif given is not None:
        camera, source = load_lens(os.fspath(given), (width, height)), os.fspath(given)
    elif len(scene.cameras) == 1:
        camera, source = scene.cameras[0], str(scene.path)
    else:
        raise InputError(
            f"{scene.path} has {len(scene.cameras)} cameras: say with --camera LENS which lens "
            f"took {name}"
        )
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        raise InputError(
            f"{name} is {width} x {height}, but the lens of {source} is for images of "
            f"{camera.width} x {camera.height}; give the lens of this photograph with --camera"
        )
    trained = max(c.width for c in scene.cameras)
    width = min(width, trained)
    return camera.resize(width, round(camera.height * width / camera.width))


def _choose_shutter(word: str, scene: Scene, lens: Camera, is_own: bool) -> Shutter | None:
    """Chooses the photograph's shutter; None: it is found from the photograph."""
    if word not in ("auto", "global", "rolling"):
        raise InputError(f"shutter must be auto, global or rolling, found {word!r}")
    if word == "global":
        return Shutter("global")
    of_scene = next((view.shutter for view in scene.views if view.shutter is not None), None)
    if word == "rolling":
        return of_scene or list_likely_shutters(lens)[0]
    return of_scene if is_own else None
