"""Finds the usual mistakes in a dataset before time is spent on it."""

from gsut.check.dataset import check_scene, diagnose, doctor
from gsut.check.depths import check_depths
from gsut.check.findings import Finding, format_findings, stop_at_errors
from gsut.check.memory import refuse_too_large
