"""Fixtures of the laboratory's tests: those of all tests."""

from tests.conftest import *  # noqa: F403
