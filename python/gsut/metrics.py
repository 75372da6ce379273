"""Image metrics under masks: PSNR (plain, by ring, by solid angle, colour-corrected) and SSIM.

Images are (H, W, 3), uint8 (taken as value / 255) or floating point with peak 1. Masks are (H, W)
bool or integers, non-zero where a pixel counts. Images may hold anything where they are masked.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds

__all__ = ["color_corrected_psnr", "ring_psnr", "weighted_psnr"]

# Squares of singular values below this share of the largest: colours that determine nothing.
_UNDETERMINED = 1e-12
RING_EDGES_DEGREES = (0.0, 30.0, 60.0, 80.0, 180.0)


class Ring(TypedDict):
    """PSNR of one ring of field angle."""

    from_degrees: float
    to_degrees: float
    psnr: float | None
    pixels: int


def _check_image(image: ArrayLike, name: str) -> np.ndarray:
    array = _core.read_array(image, name)
    if array.ndim != 3 or array.shape[2] != 3:
        raise InputError(f"{name} must have shape (H, W, 3), found {array.shape}")
    if array.dtype == np.uint8:
        return array / 255.0
    if array.dtype.kind != "f":
        raise InputError(f"{name} must be uint8, or floating point in [0, 1], found {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float64)


def _pair(a: ArrayLike, b: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    return _check_image(a, "a"), _check_image(b, "b")


def _read_mask(mask: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    if mask is None:
        return np.ones(shape, dtype=bool)
    array = _core.read_array(mask, "mask")
    if array.shape != shape:
        raise InputError(f"mask must have shape {shape}, found {array.shape}")
    return array != 0


@name_wrong_kinds
def psnr(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Computes the peak signal-to-noise ratio over unmasked pixels and all channels.

    Args:
        a, b: (H, W, 3) images.
        mask: (H, W), non-zero where a pixel counts; None: all count.

    Returns:
        -10 log10(mean squared difference) in dB; infinite for equal images.

    Raises:
        InputError: shapes or dtypes are wrong, or the mask leaves no pixel.
    """
    return _core.psnr(*_pair(a, b), mask, None)


@name_wrong_kinds
def weighted_psnr(
    a: ArrayLike, b: ArrayLike, weights: ArrayLike, mask: ArrayLike | None = None
) -> float:
    """Computes PSNR with a weight per pixel; with solid angles it is that of the view sphere.

    In a fisheye image the rim fills more pixels than sky, so plain PSNR depends on the lens;
    weighted by solid angle it does not.

    Args:
        a, b: (H, W, 3) images.
        weights: (H, W) finite, >= 0, in any unit.
        mask: (H, W), non-zero where a pixel counts; None: all count.

    Returns:
        PSNR in dB of the weighted mean squared difference.

    Raises:
        InputError: shapes or dtypes are wrong, weights negative or not finite, nothing left.
    """
    return _core.psnr(*_pair(a, b), mask, weights)


@name_wrong_kinds
def ssim(
    a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None, window_rule: str = "valid"
) -> float:
    """Computes mean structural similarity: 11 x 11 Gaussian window of sigma 1.5, all channels.

    Args:
        a, b: (H, W, 3) images.
        mask: (H, W), non-zero where a pixel counts; None: all count.
        window_rule: "valid": averaged over pixels whose whole window lies inside image and mask
            (the published figure); where there is none, as "partial": every unmasked pixel, its
            window cut to unmasked pixels and renormalised.

    Returns:
        SSIM in [-1, 1], 1 for equal images.

    Raises:
        InputError: shapes or dtypes are wrong, the mask leaves no pixel, the rule is unknown.

    Source: Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004, equation 13.
    """
    return _core.ssim(*_pair(a, b), mask, window_rule)


@name_wrong_kinds
def ring_psnr(
    a: ArrayLike,
    b: ArrayLike,
    angles: ArrayLike,
    edges_degrees: Sequence[float] = RING_EDGES_DEGREES,
    mask: ArrayLike | None = None,
) -> list[Ring]:
    """Computes PSNR by ring of field angle: is the rim of a wide lens as good as its centre?

    Args:
        a, b: (H, W, 3) images.
        angles: (H, W) angle between each pixel's ray and the optical axis, radians; NaN where the
            pixel has no ray (such pixels are in no ring).
        edges_degrees: increasing edges; ring i holds edges[i] <= angle < edges[i + 1], the last
            ring also its upper edge.
        mask: (H, W), non-zero where a pixel counts; None: all count.

    Returns:
        One dict a ring: from_degrees, to_degrees, psnr in dB (None in an empty ring), pixels.

    Raises:
        InputError: shapes or dtypes are wrong, edges do not increase.
    """
    x, y = _pair(a, b)
    degrees = np.degrees(np.asarray(angles, dtype=np.float64))
    if degrees.shape != x.shape[:2]:
        raise InputError(f"angles must have shape {x.shape[:2]}, found {degrees.shape}")
    edges = [float(edge) for edge in edges_degrees]
    if len(edges) < 2 or any(not low < high for low, high in itertools.pairwise(edges)):
        raise InputError(f"edges_degrees must be at least two increasing angles, found {edges}")
    counts = _read_mask(mask, x.shape[:2])
    rings: list[Ring] = []
    for low, high in itertools.pairwise(edges):
        below = degrees <= high if high == edges[-1] else degrees < high
        inside = counts & (degrees >= low) & below
        pixels = int(np.count_nonzero(inside))
        value = _core.psnr(x, y, inside, None) if pixels else None
        rings.append({"from_degrees": low, "to_degrees": high, "psnr": value, "pixels": pixels})
    return rings


def _select_channels(
    image: ArrayLike, truth: ArrayLike, mask: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the channels (3, N) of the pixels that count, of both images.

    By channel, as BLAS takes pixels of three values badly: fifty times as long as the sums.
    """
    x, y = _check_image(image, "image"), _check_image(truth, "truth")
    if x.shape != y.shape:
        raise InputError(f"truth must have shape {x.shape}, found {y.shape}")
    counts = _read_mask(mask, x.shape[:2])
    colors, wanted = (
        np.ascontiguousarray((each.reshape(-1, 3) if mask is None else each[counts]).T)
        for each in (x, y)
    )
    if colors.size == 0:
        raise InputError("the mask leaves no pixel (all zero); non-zero marks pixels that count")
    if not (np.isfinite(colors).all() and np.isfinite(wanted).all()):
        raise InputError("image or truth holds values that are not finite at unmasked pixels")
    return colors, wanted


def _fit_transform(colors: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Fits the affine colour transform that brings the colours (3, N) closest to the wanted ones.

    Returns:
        (3, 4) matrix M: wanted is about M[:, :3] @ colors + M[:, 3], in least squares; the
        smallest change of that kind where the colours do not determine it.
    """
    # Solved for the change, so that colours which determine nothing (one flat colour) stay.
    design = np.concatenate([colors, np.ones((1, colors.shape[1]))])
    normal, side = (np.einsum("in,jn->ij", design, each) for each in (design, wanted - colors))
    return np.eye(3, 4) + np.linalg.lstsq(normal, side, rcond=_UNDETERMINED)[0].T


@name_wrong_kinds
def color_corrected_psnr(
    image: ArrayLike, truth: ArrayLike, mask: ArrayLike | None = None
) -> float:
    """Computes PSNR after the best affine colour transform of the image, clamped to [0, 1].

    For photographs with drifting exposure or white balance: separates errors of structure
    from errors of tone. Always state it beside the plain PSNR.

    Args:
        image: (H, W, 3) the image that is corrected.
        truth: (H, W, 3).
        mask: (H, W), non-zero where a pixel counts; None: all count.

    Returns:
        PSNR in dB.

    Raises:
        InputError: shapes or dtypes are wrong, the mask leaves no pixel, values not finite.
    """
    colors, wanted = _select_channels(image, truth, mask)
    red, green, blue = colors
    rows = [
        row[0] * red + row[1] * green + row[2] * blue + row[3]
        for row in _fit_transform(colors, wanted)
    ]
    return psnr(np.clip(rows, 0.0, 1.0).T[None], wanted.T[None])
