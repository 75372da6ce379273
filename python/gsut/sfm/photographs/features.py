"""Finds the features of photographs: root-SIFT on the raw, distorted image."""

from __future__ import annotations

import collections
import concurrent.futures
import contextlib
import dataclasses
import math
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError, Shutter
from gsut.data.images import decode_image, decode_mask, shrink_image, shrink_mask
from gsut.lens import Camera
from gsut.sfm.photographs.listing import FEWEST_IMAGES, Photographs
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.photographs.stages import Stages

DESCRIPTOR_LENGTH = 128  # of SIFT: 4 x 4 cells of 8 directions
DESCRIPTOR_SCALE = 512  # length of a descriptor stored in bytes: SIFT's own convention
# Pixels for each wanted feature up to which describing all keypoints is cheaper than building the
# image pyramid a second time.
_PIXELS_EACH = 300
# Of SIFT: a higher one misses features of even surfaces, and images with them.
_CONTRAST = 0.0067
_STAGE = "features-{:06d}"  # name of an image's stage file
_STORED = ("pixels", "sizes", "descriptors", "colors")  # of features, in a stage file


@dataclasses.dataclass(frozen=True)
class Features:
    """The features of one image.

    Args:
        pixels: (N, 2) float64 in the full image; (0.5, 0.5) is the centre of the top-left pixel.
        sizes: (N,) float32 diameters in pixels of the full image, largest first.
        descriptors: (N, 128) uint8, DESCRIPTOR_SCALE times the root of SIFT's shares (root-SIFT:
            Arandjelovic and Zisserman 2012), at most 255; see `normalize_descriptors`.
        colors: (N, 3) uint8 red, green, blue at the pixels.
        is_learned: (N,) bool, found by a network, which is less exact; None: none is.
    """

    pixels: np.ndarray
    sizes: np.ndarray
    descriptors: np.ndarray
    colors: np.ndarray
    is_learned: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.pixels)

    def join(self, others: Features) -> Features:
        """Returns these features, with others of the same image behind them."""
        pair = (self, others)
        arrays = {name: np.concatenate([getattr(each, name) for each in pair]) for name in _STORED}
        if any(each.is_learned is not None for each in pair):
            arrays["is_learned"] = np.concatenate([each.flag_learned() for each in pair])
        return Features(**arrays)

    def flag_learned(self) -> np.ndarray:
        """Returns (N,) bool, which of the features are learned."""
        return np.zeros(len(self), bool) if self.is_learned is None else self.is_learned

    def normalize_descriptors(self, most: int | None = None) -> np.ndarray:
        """Returns (M, 128) float32 descriptors of unit length of the `most` largest features."""
        values = self.descriptors[:most].astype(np.float32)
        return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


@dataclasses.dataclass(frozen=True)
class ImageLines:
    """How the lines of each image are read, where the cameras of a rig differ.

    Args:
        shutters: of each image; None: all lines at once.
        readouts: (N,) from the first line to the last, over the readout that velocities are for;
            the middles of one frame coincide.
    """

    shutters: Sequence[Shutter | None]
    readouts: np.ndarray

    def select(self, chosen: Sequence[int] | np.ndarray) -> ImageLines:
        """Returns those of some of the images."""
        return ImageLines([self.shutters[i] for i in chosen], self.readouts[chosen])

    def to_settings(self) -> dict[str, Any]:
        """Returns the settings that the solver takes."""
        names = [shutter.direction if shutter else "global" for shutter in self.shutters]
        return {"image_shutters": names, "image_readouts": self.readouts.tolist()}


@dataclasses.dataclass(frozen=True)
class Images:
    """The images whose poses are estimated.

    Args:
        names: one an image.
        cameras: the lens of each image; equal lenses are the same object.
        features: of each image.
        shutter: of a rolling shutter; None: all lines of an image are read at once.
        lines: of each image, where they differ.
    """

    names: Sequence[str]
    cameras: Sequence[Camera]
    features: Sequence[Features]
    shutter: Shutter | None = None
    lines: ImageLines | None = None

    def __len__(self) -> int:
        return len(self.names)

    def with_lens(self, camera: Camera) -> Images:
        """Replaces the lens of all images."""
        return dataclasses.replace(self, cameras=[camera] * len(self))

    def select(self, chosen: Sequence[int] | np.ndarray) -> Images:
        """Returns some of the images."""
        return Images(
            [self.names[i] for i in chosen],
            [self.cameras[i] for i in chosen],
            [self.features[i] for i in chosen],
            self.shutter,
            None if self.lines is None else self.lines.select(chosen),
        )


# Called with (stage, done, total, text) as the work goes on.
OnProgress = Callable[[str, int, int, str], None]


def collect_features(
    photographs: Photographs,
    options: PosesOptions,
    on_progress: OnProgress,
    note: Callable[[str], None],
    stages: Stages | None = None,
) -> list[Features]:
    """Finds the features of all images; those that cannot be read have none.

    Args:
        on_progress: called for the stage "features".
        note: called with a sentence on each image that is left out.
        stages: where features are kept; None: nowhere.

    Raises:
        InputError: fewer than two images can be used.
    """
    total = len(photographs)
    found = [_load_features(stages, i) if stages else None for i in range(total)]
    absent = [i for i, features in enumerate(found) if features is None]
    on_progress("features", total - len(absent), total, "")
    broken: list[str] = []
    # Closed where the loop ends early, so that images that wait are not read.
    with contextlib.closing(_read_all_features(photographs, absent, options)) as results:
        for done, (index, result) in enumerate(results, total - len(absent) + 1):
            if isinstance(result, InputError):
                broken.append(str(result))
                note(f"left out: {result}")
                result = make_no_features()
            elif stages is not None:
                stages.save(_STAGE.format(index), {name: getattr(result, name) for name in _STORED})
            found[index] = result
            on_progress("features", done, total, f"{len(result):,} in {photographs.names[index]}")
    if total - len(broken) < FEWEST_IMAGES:
        raise InputError(
            f"{total - len(broken)} of {total} images can be used, and poses need at least "
            f"{FEWEST_IMAGES} that overlap; {broken[0] if broken else ''}"
        )
    return [features for features in found if features is not None]


def _load_features(stages: Stages, index: int) -> Features | None:
    arrays = stages.load(_STAGE.format(index))
    return None if arrays is None or set(arrays) != set(_STORED) else Features(**arrays)


def make_no_features() -> Features:
    """Returns the features of an image that cannot be read or shows nothing."""
    return Features(
        np.zeros((0, 2)), np.zeros(0, np.float32),
        np.zeros((0, DESCRIPTOR_LENGTH), np.uint8), np.zeros((0, 3), np.uint8),
    )  # fmt: skip


def read_features(
    path: Path,
    camera: Camera | None,
    options: PosesOptions,
    mask_path: Path | None = None,
    detect: Callable[[np.ndarray, np.ndarray | None], Features] | None = None,
) -> Features:
    """Reads an image and detects its features.

    Args:
        path: the image.
        camera: its lens, which leaves out features where it has no ray; None: unknown.
        options: see PosesOptions.
        mask_path: image that is white where pixels are valid, or None.
        detect: finds features in pixels (H, W, 3), where (H, W) is True; None: SIFT.

    Raises:
        DatasetError: the image cannot be read.
        InputError: its size is not the lens'.
    """
    pixels, alpha = decode_image(path)
    height, width = pixels.shape[:2]
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise InputError(
            f"{path} is {width} x {height}, the lens is for {camera.width} x {camera.height}; "
            "give the lens file of these images"
        )
    valid = _find_valid_pixels(camera, alpha, mask_path, width, height)
    return detect(pixels, valid) if detect else detect_features(pixels, valid, options)


def detect_features(
    pixels: np.ndarray,
    valid: np.ndarray | None,
    options: PosesOptions,
) -> Features:
    """Detects the features of an image in memory.

    Args:
        pixels: (H, W, 3) uint8.
        valid: (H, W) bool, where features may lie; None: everywhere.
        options: see PosesOptions.
    """
    import cv2

    height, width = pixels.shape[:2]
    scale = min(1.0, math.sqrt(options.max_megapixels * 1e6 / (width * height)))
    small = shrink_image(pixels, max(1, round(scale * width)), max(1, round(scale * height)))
    factor = np.array([width / small.shape[1], height / small.shape[0]])
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    small_mask = None
    if valid is not None:
        small_mask = shrink_mask(valid, small.shape[1], small.shape[0]).astype(np.uint8)
    # Detecting and describing at once builds SIFT's pyramid once, but describes keypoints that
    # are not chosen.
    at_once = small_mask is None or grey.size < _PIXELS_EACH * options.max_features
    sift = cv2.SIFT.create(
        options.max_features if small_mask is None else 0,
        contrastThreshold=_CONTRAST, enable_precise_upscale=True,
    )  # fmt: skip
    if at_once:
        keypoints, descriptors = sift.detectAndCompute(grey, small_mask)
    else:
        keypoints = sift.detect(grey, small_mask)
    if small_mask is not None and keypoints:
        kept = _choose_strongest(keypoints, options.max_features, small_mask)
        keypoints = [keypoints[row] for row in kept]
        if at_once:
            descriptors = descriptors[kept]
        elif keypoints:
            keypoints, descriptors = sift.compute(grey, keypoints)
    if not keypoints:
        return make_no_features()
    at = np.array([k.pt for k in keypoints], np.float64).reshape(-1, 2)
    sizes = np.array([k.size for k in keypoints], np.float32) * float(factor.mean())
    order = np.argsort(-sizes, kind="stable")
    # cv2 puts the centre of the top-left pixel at (0, 0).
    full = ((at + 0.5) * factor)[order]
    corner = np.clip(full.astype(int), 0, [width - 1, height - 1])
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12))
    return Features(
        full,
        sizes[order],
        np.minimum(np.rint(DESCRIPTOR_SCALE * root[order]), 255).astype(np.uint8),
        pixels[corner[:, 1], corner[:, 0]],
    )


def _read_all_features(
    photographs: Photographs, chosen: Sequence[int], options: PosesOptions
) -> Generator[tuple[int, Features | InputError]]:
    """Reads the features of the chosen images in parallel.

    Yields:
        In the order of `chosen`, each with its features, or the error of an image that cannot be
        read.
    """
    import cv2

    workers = options.threads or _core.num_threads()
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)  # one image a thread
    try:
        with concurrent.futures.ThreadPoolExecutor(workers) as pool:
            jobs = collections.deque(
                pool.submit(
                    read_features, photographs.paths[i], photographs.cameras[i], options,
                    photographs.masks[i],
                )
                for i in chosen
            )  # fmt: skip
            try:
                for index in chosen:
                    try:
                        yield index, jobs.popleft().result()  # frees the features
                    except InputError as error:
                        yield index, error
            finally:
                for job in jobs:
                    job.cancel()
    finally:
        cv2.setNumThreads(before)


def _find_valid_pixels(
    camera: Camera | None, alpha: np.ndarray | None, mask_path: Path | None, width: int, height: int
) -> np.ndarray | None:
    """Combines rays, alpha and mask into (H, W) bool; None if all pixels are valid."""
    valid = np.ones((height, width), bool)
    if camera is not None:
        valid &= camera.rays()[1]
    if alpha is not None:
        valid &= alpha
    if mask_path is not None:
        mask = decode_mask(mask_path)
        if mask.shape != valid.shape:
            raise InputError(
                f"the mask {mask_path} is {mask.shape[1]} x {mask.shape[0]}, its image is "
                f"{width} x {height}; make the mask at the image's size"
            )
        valid &= mask
    return None if valid.all() else valid


def _choose_strongest(keypoints, most: int, mask: np.ndarray) -> list[int]:
    """Returns the numbers of the keypoints of most contrast well inside the mask."""
    import cv2

    distance = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    inside = [
        number
        for number, k in enumerate(keypoints)
        if distance[int(k.pt[1] + 0.5), int(k.pt[0] + 0.5)] > k.size
    ]
    if len(inside) > most:
        inside = sorted(inside, key=lambda number: -keypoints[number].response)[:most]
    return inside
