"""OCamCalib's calib_results.txt: rows before columns, and a lens that looks along -z."""

from __future__ import annotations

import numpy as np

from gsut._core import CalibrationError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile, LensFormat
from gsut.lens.files._values import FROM_ZERO, LensValues

_BLOCKS = ("polynomial", "inverse polynomial", "center", "affine parameters", "image size")
_LENGTHS = {"center": 2, "affine parameters": 3, "image size": 2}
_FIRST = 5  # index of a0 in gsut's parameters; a2 follows


def is_ocam(file: LensFile) -> bool:
    """Returns whether the first line that is no comment holds a length, then numbers."""
    for line in file.text.splitlines():
        words = line.split("#", 1)[0].split()
        if words:
            return len(words) > 1 and words[1].lstrip("+-")[:1].isdigit()
    return False


def read_ocam(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the camera of a calib_results.txt, by its polynomial from pixels to rays.

    Raises:
        CalibrationError: names the line that is no list of numbers, or what is missing.
    """
    text, source = file.text, file.source
    blocks: list[tuple[int, list[float]]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words or len(blocks) == len(_BLOCKS):
            continue
        name = _BLOCKS[len(blocks)]
        doubt = "" if blocks else "; is it a calib_results.txt of OCamCalib?"
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise CalibrationError(f"{source}, line {number}: {name}: {error}{doubt}") from error
        length = _LENGTHS.get(name, 1 + int(values[0]) if values[0] > 0 else 2)
        if len(values) != length or not np.isfinite(values).all():
            raise CalibrationError(
                f"{source}, line {number}: {name}: expected {length} finite numbers, found {words}"
                f"{doubt}"
            )
        blocks.append((number, values))
    if len(blocks) < len(_BLOCKS):
        raise CalibrationError(
            f"{source}: there is no {_BLOCKS[len(blocks)]}; is the file cut off?"
        )
    line_of_polynomial = blocks[0][0]
    (_, *poly), _, center, affine, size = (values for _, values in blocks)
    if len(poly) > 1 and poly[1] != 0.0:
        raise CalibrationError(
            f"{source}, line {line_of_polynomial}: the coefficient of rho is {poly[1]:g}; a smooth"
            " lens has 0 there (OCamCalib always writes 0)"
        )
    # (row, column) = [[c, d], [e, 1]] (x down, y right): gsut has (column, row) and the 1 first.
    c, d, e = affine
    params = [center[1] + FROM_ZERO, center[0] + FROM_ZERO, 1 / c, e / c, d / c]
    params += [-value * c ** (1 - k) for k, value in enumerate(poly) if k != 1]
    sizes = LensValues({"height": size[0], "width": size[1]}, source, text)
    shape = sizes.read_pixels("width"), sizes.read_pixels("height")
    keys = [*2 * ["center"], *3 * ["affine parameters"], *(len(params) - _FIRST) * ["polynomial"]]
    return sizes.make_camera("ocam", params, *shape, keys=keys)


FORMAT = LensFormat(
    "ocam",
    "OCamCalib",
    (".txt",),
    read_ocam,
    is_ocam,
    marks="a polynomial",
    rank=10,
)
