"""Other starts of the structure: what halves of the points say of the poses, and better poses."""

from gsut.sfm.starts.halves import compare_halves
from gsut.sfm.starts.second_start import try_other_starts

__all__ = ["compare_halves", "try_other_starts"]
