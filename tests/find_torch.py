"""torch of the environment, else Debian's python3-torch."""

import contextlib
import io
import sys
import sysconfig
import warnings
from pathlib import Path
from types import ModuleType

_DEBIAN = Path("/usr/lib/python3/dist-packages")


def find_torch() -> ModuleType:
    """Imports torch.

    Raises:
        ImportError: there is none.
    """
    # Debian's torch says at length that it was built with another NumPy.
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        added = not sysconfig.get_path("purelib").startswith("/usr/lib")
        try:
            if added:
                sys.path.append(str(_DEBIAN))  # last: only what is nowhere else
            import torch

            torch.zeros(1)
        finally:
            if added:
                sys.path.remove(str(_DEBIAN))
    return torch
