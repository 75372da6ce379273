"""Decodes photographs of the formats that need a library of their own, or conversion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.capture.exif import RAW_SUFFIXES
from gsut.files import check_regular, open_image

HEIF_SUFFIXES = (".heic", ".heif")


def require_readers(paths: Sequence[Path]) -> None:
    """Imports the libraries that some formats need.

    Raises:
        InputError: one is not installed; the message says how to install it.
    """
    suffixes = {path.suffix.lower() for path in paths}
    if suffixes & set(HEIF_SUFFIXES):
        try:
            import pillow_heif
        except ImportError:
            raise _explain_missing("HEIC", "pillow-heif", suffixes & set(HEIF_SUFFIXES)) from None
        pillow_heif.register_heif_opener()
    if suffixes & set(RAW_SUFFIXES):
        try:
            import rawpy  # noqa: F401
        except ImportError:
            raise _explain_missing("raw", "rawpy", suffixes & set(RAW_SUFFIXES)) from None


def _explain_missing(kind: str, library: str, suffixes: set[str]) -> InputError:
    return InputError(
        f"{kind} photographs ({', '.join(sorted(suffixes))}) need the library {library}: pip "
        f"install {library}; or export the photographs as JPEG"
    )


def decode_stored(path: Path) -> np.ndarray:
    """Decodes the stored pixels to (H, W, 3) uint8 RGB."""
    if path.suffix.lower() in RAW_SUFFIXES:
        import rawpy

        with rawpy.imread(str(check_regular(path))) as raw:
            return raw.postprocess(use_camera_wb=True, user_flip=0)
    with open_image(path) as image:
        if image.mode.startswith("I"):
            grey = np.asarray(image).astype(np.float64) / 257
            return np.repeat(grey.round().clip(0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
        return np.asarray(image.convert("RGB"))
