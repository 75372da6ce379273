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
from gsut.data.images.masks import find_common_mask, find_mask, make_lens_mask, read_mask

__all__ = [
    "IMAGE_SUFFIXES",
    "decode_image",
    "decode_mask",
    "decode_scaled",
    "find_common_mask",
    "find_largest_value",
    "find_mask",
    "make_lens_mask",
    "read_header",
    "read_mask",
    "shrink_both",
    "shrink_image",
    "shrink_mask",
]
