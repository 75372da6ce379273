"""Pairs of photographs: features that look alike, and those of them that agree with a pose."""

from gsut.sfm.matches.matching import (
    MAX_DISTANCE,
    MAX_RATIO,
    WINDOW,
    PairMatches,
    RawMatches,
    find_frame_numbers,
    match_images,
)
from gsut.sfm.matches.selection import (
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
    ENOUGH_MATCHES,
    FEWEST_MATCHES,
    LARGEST_OFFSET,
    MIN_ANGLE_DEGREES,
    ROLLING_ERROR,
    explain_failure,
    measure_pictures,
    require_overlap,
    verify_matches,
)
