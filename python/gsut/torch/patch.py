"""Puts gsut's functions in gsplat's place, so that programs that import gsplat run on a CPU."""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

from gsut import InputError
from gsut.torch.arguments import read_api
from gsut.torch.functions import compute_relocation, make_covariances, project_cameras
from gsut.torch.harmonics import evaluate_harmonics, evaluate_view_harmonics
from gsut.torch.rasterization import rasterization

# Modules that hold gsplat's functions under their names; versions lack some.
_MODULES = ("gsplat", "gsplat.rendering", "gsplat.relocation", "gsplat.strategy.ops")
# Through which gsplat 1.4 and 1.5 reach each function of their CUDA library.
_SEAMS = ("_make_lazy_cuda_func", "_make_lazy_cuda_obj")


def patch_gsplat(*, api: str | None = None) -> GsplatPatch:
    """Replaces gsplat's CUDA functions by gsut's, in every module of gsplat.

    Replaced are `rasterization`, `fully_fused_projection_with_ut`, `spherical_harmonics`,
    `compute_relocation` and `quat_scale_to_covar_preci`; both of its strategies then run. Other
    functions of its CUDA library raise `InputError` with their name. Call it before the program
    that imports names from gsplat; `python -m gsut.torch SCRIPT` does that.

    Args:
        api: "1.4", "1.5" or "1.6", whose signatures and shapes are wanted; None: the installed
            gsplat's.

    Returns:
        The patch, which `undo()` or the end of a `with` takes back.

    Raises:
        InputError: gsplat is not installed or is another thing, or `api` is unknown.
    """
    try:
        gsplat = importlib.import_module("gsplat")
    except ImportError as error:
        raise InputError(
            f"patch_gsplat needs gsplat ({error}): pip install gsplat, or call gsut.torch directly"
        ) from error
    if not hasattr(gsplat, "rasterization"):
        place = getattr(gsplat, "__file__", None) or list(gsplat.__path__)
        raise InputError(
            f"gsplat at {place} has no rasterization: a folder of that name stands before the "
            "installed package in sys.path; rename it, or run the program from another folder"
        )
    version = read_api(api or _read_version(gsplat))
    patch = GsplatPatch()
    for name in _MODULES:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(name)
    modules = [m for name, m in sys.modules.items() if name.split(".")[0] == "gsplat"]
    for name, function in _make_functions(version).items():
        for module in modules:
            patch.replace(module, name, function)
    for module in modules:
        for seam in _SEAMS:
            patch.replace(module, seam, _refuse_cuda)
    return patch


class GsplatPatch(contextlib.ExitStack):
    """gsplat's modules with functions of gsut, until `undo` or the end of a `with`."""

    def replace(self, module: ModuleType, name: str, value: Any) -> None:
        """Replaces a name of a module, where it has it."""
        if name in vars(module):
            self.callback(setattr, module, name, vars(module)[name])
            setattr(module, name, value)

    def undo(self) -> None:
        """Puts gsplat's own functions back."""
        self.close()


def _make_functions(version: str) -> dict[str, Callable[..., Any]]:
    return {
        "rasterization": functools.wraps(rasterization)(
            functools.partial(rasterization, api=version)
        ),
        "fully_fused_projection_with_ut": project_cameras,
        "spherical_harmonics": (
            evaluate_view_harmonics if version == "1.6" else evaluate_harmonics
        ),
        "compute_relocation": compute_relocation,
        "quat_scale_to_covar_preci": make_covariances,
    }


def _read_version(gsplat: ModuleType) -> str | None:
    """Reads the version that the imported gsplat states; None if it states none."""
    words = str(getattr(gsplat, "__version__", "")).split(".")
    return ".".join(words[:2]) if len(words) > 1 else None


def _refuse_cuda(name: str) -> Callable[..., Any]:
    """Makes a function that raises with this name of gsplat's when it is called."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise InputError(
            f"gsplat's {name} needs CUDA and gsut has none of it; patch_gsplat replaces "
            "rasterization, fully_fused_projection_with_ut, spherical_harmonics, "
            "compute_relocation and quat_scale_to_covar_preci"
        )

    return refuse
