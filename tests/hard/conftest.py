"""Makes the scenes of tests/ importable here and undoes what a test forces."""

import pytest

import gsut


@pytest.fixture(autouse=True)
def defaults():
    """Best instruction set and all processors after each test."""
    yield
    gsut.set_isa("")
    gsut.set_num_threads(0)
