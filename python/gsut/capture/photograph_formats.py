"""Decodes photographs of the formats that need a library of their own, or conversion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsut._core import InputError
from gsut.files import check_regular, find_kind, open_image


def require_readers(paths: Sequence[Path]) -> None:
    """Imports the libraries that some formats need.

    Raises:
        InputError: one is not installed; the message says how to install it.
    """
    suffixes: dict[str, set[str]] = {}
    for path in paths:
        suffixes.setdefault(find_kind(path), set()).add(path.suffix.lower())
    if "heif" in suffixes:
        try:
            import pillow_heif
        except ImportError:
            raise _explain_missing("HEIC", "pillow-heif", suffixes["heif"]) from None
        pillow_heif.register_heif_opener()
    if "raw" in suffixes:
        try:
            import rawpy  # noqa: F401
        except ImportError:
            raise _explain_missing("raw", "rawpy", suffixes["raw"]) from None


def _explain_missing(kind: str, library: str, suffixes: set[str]) -> InputError:
    return InputError(
        f"{kind} photographs ({', '.join(sorted(suffixes))}) need the library {library}: pip "
        f"install {library}; or export the photographs as JPEG"
    )


def decode_stored(path: Path) -> np.ndarray:
    """Decodes the stored pixels to (H, W, 3) uint8 RGB."""
    if find_kind(path) == "raw":
        import rawpy

        with rawpy.imread(str(check_regular(path))) as raw:
            return raw.postprocess(use_camera_wb=True, user_flip=0)
    with open_image(path) as image:
        if image.mode.startswith("I"):
            grey = np.asarray(image).astype(np.float64) / 257
            return np.repeat(grey.round().clip(0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
        return np.asarray(image.convert("RGB"))
