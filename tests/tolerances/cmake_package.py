"""Tolerances of tests/python/test_cmake_package.py."""

PRINTED_PIXEL = 1e-6  # the example prints six digits; worst observed 4e-7
GREY_LEVEL = (
    0.5 / 255 + 1e-5
)  # rounding to 8 bits, and the renderer's error; worst observed 0.5 / 255
