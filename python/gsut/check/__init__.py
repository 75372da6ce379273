"""The usual mistakes, found before time is spent: poses, lens, points against the photographs."""

from gsut.check.before import check_scene, diagnose, stop_at_errors
from gsut.check.photographs import Evidence, check_photographs, gather_evidence

__all__ = [
    "Evidence",
    "check_photographs",
    "check_scene",
    "diagnose",
    "gather_evidence",
    "stop_at_errors",
]
