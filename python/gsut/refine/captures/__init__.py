"""Two captures of one place: the second in the frame of the first, and what has changed."""

from gsut.refine.captures.alignment import CaptureAlignment, align_captures
from gsut.refine.captures.changes import find_changes
from gsut.refine.captures.cloud import align_to_cloud
