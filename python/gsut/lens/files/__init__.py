"""Lens files in and out: a module a format, found by its `FORMAT`; those with a "_" are none."""

from gsut.lens.files._format import LensFile, LensFormat, list_formats
from gsut.lens.files._load import lens_suffixes, load_camera, save_camera

__all__ = [
    "LensFile",
    "LensFormat",
    "lens_suffixes",
    "list_formats",
    "load_camera",
    "save_camera",
]
