"""Features of photographs: root-SIFT on the raw, distorted image, where the lens has rays."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.data.images import decode_image, decode_mask, shrink_image, shrink_mask
from gsut.lens import Camera
from gsut.sfm.core.options import PosesOptions

DESCRIPTOR_LENGTH = 128
_BYTES = 512  # of a descriptor of unit length: as SIFT's own
# Keypoints so near a pixel without a ray, in units of their size, describe the lens' edge.
_EDGE_SIZES = 1.0
# Pixels for each feature wanted, up to which describing all takes less than a second pyramid.
_PIXELS_EACH = 300


@dataclasses.dataclass(frozen=True)
class Features:
    """The features of one image.

    Args:
        pixels: (N, 2) float64 in the full image; (0.5, 0.5) is the centre of the top-left pixel.
        sizes: (N,) float32 diameters in pixels of the full image, largest first.
        descriptors: (N, 128) uint8, 512 times the root of SIFT's shares (root-SIFT: Arandjelovic
            and Zisserman 2012), at most 255; see `unit_descriptors`.
        colors: (N, 3) uint8 red, green, blue at the pixels.
    """

    pixels: np.ndarray
    sizes: np.ndarray
    descriptors: np.ndarray
    colors: np.ndarray

    def __len__(self) -> int:
        return len(self.pixels)

    def unit_descriptors(self, most: int | None = None) -> np.ndarray:
        """(M, 128) float32 of unit length, of the `most` largest features."""
        values = self.descriptors[:most].astype(np.float32)
        return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


def no_features() -> Features:
    """Of an image that cannot be read, or shows nothing."""
    return Features(
        np.zeros((0, 2)), np.zeros(0, np.float32),
        np.zeros((0, DESCRIPTOR_LENGTH), np.uint8), np.zeros((0, 3), np.uint8),
    )  # fmt: skip


def find_features(
    path: Path, camera: Camera | None, options: PosesOptions, mask_path: Path | None = None
) -> Features:
    """Finds the features of one image.

    Args:
        path: the image.
        camera: its lens; features where it has no ray are left out. None: unknown.
        options: see PosesOptions.
        mask_path: image that is white where pixels are valid, or None.

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
    return features_in(pixels, _valid_pixels(camera, alpha, mask_path, width, height), options)


def features_in(pixels: np.ndarray, valid: np.ndarray | None, options: PosesOptions) -> Features:
    """Finds the features of an image in memory.

    Args:
        pixels: (H, W, 3) uint8.
        valid: (H, W) bool, where features may lie; None: everywhere.
        options: see PosesOptions.
    """
    import cv2

    height, width = pixels.shape[:2]
    scale = options.feature_scale
    if scale == 0:
        scale = min(1.0, math.sqrt(options.max_megapixels * 1e6 / (width * height)))
    small = shrink_image(pixels, max(1, round(scale * width)), max(1, round(scale * height)))
    factor = np.array([width / small.shape[1], height / small.shape[0]])
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    small_mask = None
    if valid is not None:
        small_mask = shrink_mask(valid, small.shape[1], small.shape[0]).astype(np.uint8)
    # All at once builds SIFT's pyramid once, and describes features that are not chosen.
    at_once = small_mask is None or grey.size < _PIXELS_EACH * options.max_features
    sift = cv2.SIFT.create(
        options.max_features if small_mask is None else 0,
        contrastThreshold=options.contrast, enable_precise_upscale=True,
    )  # fmt: skip
    if at_once:
        keypoints, descriptors = sift.detectAndCompute(grey, small_mask)
    else:
        keypoints = sift.detect(grey, small_mask)
    if small_mask is not None and keypoints:
        kept = _strongest(keypoints, options.max_features, small_mask)
        keypoints = [keypoints[row] for row in kept]
        if at_once:
            descriptors = descriptors[kept]
        elif keypoints:
            keypoints, descriptors = sift.compute(grey, keypoints)
    if not keypoints:
        return no_features()
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
        np.minimum(np.rint(_BYTES * root[order]), 255).astype(np.uint8),
        pixels[corner[:, 1], corner[:, 0]],
    )


def find_all_features(
    paths: Sequence[Path],
    cameras: Sequence[Camera | None],
    masks: Sequence[Path | None],
    options: PosesOptions,
    on_image: Callable[[int, Features | None, Exception | None], None],
) -> None:
    """Finds the features of many images in parallel.

    Args:
        paths, cameras, masks: one an image.
        options: see PosesOptions.
        on_image: called in the order of the images with the index and the features, or the error
            of an image that cannot be read.
    """
    import cv2

    workers = options.threads or len(os.sched_getaffinity(0))
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)  # one image a thread
    try:
        with concurrent.futures.ThreadPoolExecutor(workers) as pool:
            jobs = [
                pool.submit(find_features, path, camera, options, mask)
                for path, camera, mask in zip(paths, cameras, masks, strict=True)
            ]
            try:
                for index, job in enumerate(jobs):
                    try:
                        on_image(index, job.result(), None)
                    except InputError as error:
                        on_image(index, None, error)
                    jobs[index] = None  # type: ignore[call-overload]  # frees the features
            except BaseException:
                for job in jobs:
                    if job is not None:
                        job.cancel()
                raise
    finally:
        cv2.setNumThreads(before)


def _valid_pixels(
    camera: Camera | None, alpha: np.ndarray | None, mask_path: Path | None, width: int, height: int
) -> np.ndarray | None:
    """(H, W) bool, or None where all are valid."""
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


def _strongest(keypoints, most: int, mask: np.ndarray) -> list[int]:
    """Numbers of keypoints well inside the mask, one a place and direction, by contrast."""
    import cv2

    distance = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
    inside = [
        number
        for number, k in enumerate(keypoints)
        if distance[int(k.pt[1] + 0.5), int(k.pt[0] + 0.5)] > _EDGE_SIZES * k.size
    ]
    if len(inside) > most:
        inside = sorted(inside, key=lambda number: -keypoints[number].response)[:most]
    return inside
