"""Photographs with what is known of their lenses, their features, and the options of a run."""

from gsut.sfm.photographs.features import (
    DESCRIPTOR_LENGTH,
    DESCRIPTOR_SCALE,
    Features,
    ImageLines,
    Images,
    OnProgress,
    collect_features,
    detect_features,
    make_no_features,
    read_features,
)
from gsut.sfm.photographs.fixed_pixels import mask_fixed_pixels
from gsut.sfm.photographs.listing import (
    FEWEST_IMAGES,
    FEWEST_OF_MODEL,
    HELD_BY,
    MOST_TRIED,
    SAME_FOCAL,
    TANGENT,
    LensGroup,
    Photographs,
    check_lens,
    find_photographs,
    list_photographs,
    require_central,
)
from gsut.sfm.photographs.moments import order_by_folder
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.photographs.stages import Stages, digest_key
