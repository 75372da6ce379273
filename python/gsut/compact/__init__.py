"""Compaction: fewer Gaussians that render the same, and the refit of their colours."""

from gsut.compact.compaction import (
    Compaction,
    check_keep,
    check_method,
    compact,
    looks_at_views,
    scores_of,
    settings_of,
)
from gsut.compact.floaters import Support, find_support
from gsut.compact.harmonics import drop_harmonics
from gsut.compact.method import METHODS
from gsut.compact.scores import (
    SeenView,
    blend_weights,
    find_strongest,
    seen_views,
    weights_by_view,
)

__all__ = [
    "METHODS",
    "Compaction",
    "SeenView",
    "Support",
    "blend_weights",
    "check_keep",
    "check_method",
    "compact",
    "drop_harmonics",
    "find_strongest",
    "find_support",
    "looks_at_views",
    "scores_of",
    "seen_views",
    "settings_of",
    "weights_by_view",
]
