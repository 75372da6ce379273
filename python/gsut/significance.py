"""How rare a value is whose standard deviation was estimated from few samples."""

from __future__ import annotations

import numpy as np


def convert_to_normal(ratio: np.ndarray | float, freedom: int) -> np.ndarray:
    """Converts Student's t to standard deviations of a normal law that are as rare.

    Few samples underestimate a spread by chance, so that a large ratio is less rare (Wallace,
    "Bounds on normal approximations to Student's and the chi-square distributions", 1959).

    Args:
        ratio: values over estimated standard deviations.
        freedom: degrees of freedom of the estimate.
    """
    bend = (8 * freedom + 1) / (8 * freedom + 3)
    return bend * np.sqrt(freedom * np.log1p(np.square(ratio) / freedom))
