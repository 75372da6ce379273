"""Files of Gaussian scenes, one module a format."""

from gsut.formats.ply import load_ply, save_ply

__all__ = [
    "load_ply",
    "save_ply",
]
