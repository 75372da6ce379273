"""`python -m gsut.torch SCRIPT ARGUMENT...`: runs a program that imports gsplat, on the CPU."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

from gsut.torch.patch import patch_gsplat

_USAGE = "usage: python -m gsut.torch SCRIPT [ARGUMENT...]"


def main() -> None:
    """Runs the script with `patch_gsplat()` called first, as Python itself runs it."""
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        raise SystemExit(_USAGE)
    script = Path(sys.argv[1])
    if not script.is_file():
        raise SystemExit(f"{_USAGE}\n{script} is not a file")
    patch_gsplat()
    sys.argv = sys.argv[1:]
    sys.path.insert(0, str(script.resolve().parent))
    runpy.run_path(str(script), run_name="__main__")


if __name__ == "__main__":
    main()
