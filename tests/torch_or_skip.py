"""torch for tests: where there is none, the test skips."""

from types import ModuleType

import pytest

from find_torch import find_torch


def import_torch() -> ModuleType:
    """Imports torch, or skips the module that calls it."""
    try:
        return find_torch()
    except ImportError as error:
        message = f"gsut.torch needs torch, which ./run test --torch installs ({error})"
        pytest.skip(message, allow_module_level=True)
