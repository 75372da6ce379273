"""Pairs of photographs: features that look alike, and those of them that agree with a pose."""

from gsut.sfm.matches.matching import (
    ALL_UP_TO,
    MAX_DISTANCE,
    MAX_RATIO,
    PREVIEW_FEATURES,
    WINDOW,
    PairMatches,
    RawMatches,
    find_frame_numbers,
    match_images,
)
from gsut.sfm.matches.selection import (
    ENOUGH_MATCHES,
    FEW_IMAGES,
    are_connected,
    choose_connected_pairs,
    group_images,
    keep_most_distinct,
    select_pairs,
    select_verified_pairs,
)
from gsut.sfm.matches.verification import (
    ALL_SAME,
    FEWEST_MATCHES,
    LARGEST_OFFSET,
    MIN_ANGLE_DEGREES,
    ROLLING_ERROR,
    explain_failure,
    measure_pictures,
    require_overlap,
    verify_matches,
)
