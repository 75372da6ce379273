"""One run from photographs to poses: what it knows so far, and its log."""

from gsut.sfm.mapping.log import PosesLog
from gsut.sfm.mapping.state import Findings, Mapping, RigFit
