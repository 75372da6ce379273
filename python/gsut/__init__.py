"""gsut: 3D Gaussian splatting for any real lens, without a GPU."""

from gsut._core import (
    CalibrationError,
    InputError,
    SolveError,
    __version__,
    active_isa,
    available_isas,
    num_threads,
    set_isa,
    set_num_threads,
)
from gsut.gaussians import Gaussians

__all__ = [
    "CalibrationError",
    "Gaussians",
    "InputError",
    "SolveError",
    "__version__",
    "active_isa",
    "available_isas",
    "num_threads",
    "set_isa",
    "set_num_threads",
]
