"""Fixtures of all Python tests: the folder of shared data, where present, and seeded numbers."""

import os
import sys
from pathlib import Path

# Processes that tests start read modules compiled, also where nothing may be written beside the
# sources; see `pytest_configure`.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.setdefault("PYTHONPYCACHEPREFIX", str(Path(__file__).parents[1] / ".pytest_cache/code"))
# Small systems of equations wait a hundred times longer for busy cores than they take on one.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

import gsut

ROOT = Path(__file__).resolve().parent.parent
# Development data that is not part of the project; tests that need it say so when it is absent.
SHARED = Path(os.environ.get("GSUT_SHARED", ROOT.parent / "shared"))


def pytest_configure() -> None:
    """Keeps test files compiled, with their assertions rewritten, for the next worker and run."""
    sys.dont_write_bytecode = False
    sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of shared data; the test is skipped with a reason where it does not exist."""
    if not (SHARED / "data").is_dir():
        pytest.skip(f"{SHARED} is absent: this test needs the shared data set")
    return SHARED


@pytest.fixture
def rng() -> np.random.Generator:
    """The only source of random data in tests."""
    return np.random.default_rng(20260821)


@pytest.fixture(autouse=True)
def defaults():
    """Whatever instruction set and number of threads a test forces is undone."""
    yield
    gsut.machine.set_isa(os.environ.get("GSUT_ISA", ""))
    gsut.set_num_threads(0)


@pytest.fixture(scope="session", autouse=True)
def no_wait_for_the_disk():
    """Files go to the system, not to the disk, for which a run of the tests would wait thousands of
    times: what they kill is processes, not the power."""
    patch = pytest.MonkeyPatch()
    patch.setattr(os, "fsync", lambda descriptor: None)
    yield
    patch.undo()
