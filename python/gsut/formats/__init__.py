"""Files of Gaussian scenes, one module a format."""

from gsut.formats.origin import for_file
from gsut.formats.ply import load_ply, save_ply

__all__ = [
    "for_file",
    "load_ply",
    "save_ply",
]
