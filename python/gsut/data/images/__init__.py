"""Decodes images and masks, finds masks, and shrinks both."""

from gsut.data.images.decode import (
    IMAGE_SUFFIXES,
    decode_image,
    decode_mask,
    decode_scaled,
    find_largest_value,
    read_header,
    shrink_both,
    shrink_image,
    shrink_mask,
)
from gsut.data.images.fixed_pixels import (
    COMPARED_SIDE,
    FEWEST_COMPARED,
    describe_fixed_pixels,
    find_fixed_pixels,
    is_shown,
)
from gsut.data.images.lookup import PictureLookup, describe_pictures, list_picture_names
from gsut.data.images.masks import (
    MaskLookup,
    find_common_mask,
    find_mask_folder,
    make_lens_mask,
    read_mask,
)
from gsut.data.images.names import find_named, normalize_name
