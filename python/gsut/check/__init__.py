"""The usual mistakes, found before time is spent: poses, lens, points against the photographs."""

from gsut.check.before import check_scene, doctor, look_closer, stop_at_errors
from gsut.check.evidence import Evidence, gather_evidence
from gsut.check.matches import neighbouring_matches
from gsut.check.memory import check_memory, refuse_too_large
from gsut.check.photographs import check_photographs

__all__ = [
    "Evidence",
    "check_memory",
    "check_photographs",
    "check_scene",
    "doctor",
    "gather_evidence",
    "look_closer",
    "neighbouring_matches",
    "refuse_too_large",
    "stop_at_errors",
]
