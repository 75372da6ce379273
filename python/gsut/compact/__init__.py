"""Compaction: fewer Gaussians that render the same, and the refit of their colours."""

from gsut.compact.compaction import (
    Compaction,
    check_keep,
    check_method,
    compact,
    needs_views,
    score_gaussians,
)
from gsut.compact.confidence import measure_confidence
from gsut.compact.floaters import Support, find_support
from gsut.compact.scores import (
    SeenView,
    blend_by_view,
    blend_weights,
    find_strongest,
    list_seen_views,
)
