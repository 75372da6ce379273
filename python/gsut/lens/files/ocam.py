"""OCamCalib's calib_results.txt: rows before columns, and a lens that looks along -z."""

from __future__ import annotations

import math

import numpy as np

from gsut._core import CalibrationError, InputError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile, LensFormat
from gsut.lens.files._values import LensValues

_PIXEL_SHIFT = 0.5  # pixels: OCamCalib's pixel (0, 0) is gsut's (0.5, 0.5)
_BLOCKS = ("polynomial", "inverse polynomial", "center", "affine parameters", "image size")
_LENGTHS = {"center": 2, "affine parameters": 3, "image size": 2}
_FIRST = 5  # index of a0 in gsut's parameters; a2 follows
_MAX_DEGREE = 20  # of the inverse polynomial: beyond it the fit loses digits
_GOOD_PX = 0.005  # pixels: an inverse polynomial this close needs no higher degree
_SAMPLES = 400  # angles that a polynomial is fitted to: many more than coefficients


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
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise CalibrationError(f"{source}, line {number}: {name}: {error}") from error
        length = _LENGTHS.get(name, 1 + int(values[0]) if values[0] > 0 else 2)
        if len(values) != length or not np.isfinite(values).all():
            raise CalibrationError(
                f"{source}, line {number}: {name}: expected {length} finite numbers, found {words}"
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
    params = [center[1] + _PIXEL_SHIFT, center[0] + _PIXEL_SHIFT, 1 / c, e / c, d / c]
    params += [-value * c ** (1 - k) for k, value in enumerate(poly) if k != 1]
    sizes = LensValues({"height": size[0], "width": size[1]}, source, text)
    shape = sizes.read_pixels("width"), sizes.read_pixels("height")
    keys = [*2 * ["center"], *3 * ["affine parameters"], *(len(params) - _FIRST) * ["polynomial"]]
    return sizes.make_camera("ocam", params, *shape, keys=keys)


def format_ocam(camera: Camera) -> str:
    """Formats a calib_results.txt, with an inverse polynomial fitted for its other readers.

    Raises:
        InputError: not an `ocam` lens.
    """
    if camera.model != "ocam":
        raise InputError(
            f"OCamCalib has no camera model for '{camera.model}'; convert it to ocam first"
            " (gsut camera convert)"
        )
    cx, cy, c_x, d_x, e_x, *poly = (float(value) for value in camera.params)
    c, d, e = 1 / c_x, e_x / c_x, d_x / c_x
    powers = [0, *range(2, len(poly) + 1)]
    direct = [-value * c ** (k - 1) for k, value in zip(powers, poly, strict=True)]
    direct.insert(1, 0.0)
    inverse = _fit_inverse(np.array(direct), _find_farthest(camera) / c_x)
    rows = (
        ("polynomial coefficients for the DIRECT mapping function", [len(direct), *direct]),
        ("polynomial coefficients for the inverse mapping function", [len(inverse), *inverse]),
        ('center: "row" and "column", starting from 0', [cy - _PIXEL_SHIFT, cx - _PIXEL_SHIFT]),
        ('affine parameters "c", "d", "e"', [c, d, e]),
        ('image size: "height" and "width"', [camera.height, camera.width]),
    )
    return "".join(f"#{title}\n\n{' '.join(map(repr, values))}\n\n" for title, values in rows)


def _find_farthest(camera: Camera) -> float:
    """Returns the distance of the image's farthest corner from the centre, in the lens' plane."""
    cx, cy, c, d, e = camera.params[:_FIRST]
    corners = np.array([[x, y] for x in (0, camera.width) for y in (0, camera.height)])
    plane = np.linalg.solve([[c, d], [e, 1]], (corners - [cx, cy]).T)
    return float(np.hypot(*plane).max())


def _sample(direct: np.ndarray, farthest: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples distances from the centre, and OCamCalib's angle of each: that of the ray above the
    image's plane. They end where the angle falls."""
    rho = np.linspace(0.0, farthest, _SAMPLES)
    angle = np.arctan2(np.polyval(direct[::-1], rho), rho)
    rising = np.cumprod(np.concatenate([[True], np.diff(angle) > 0])) > 0
    return rho[rising], angle[rising]


def _fit_inverse(direct: np.ndarray, farthest: float) -> list[float]:
    """Fits rho as a polynomial of OCamCalib's angle, that of the ray above the image's plane."""
    rho, angle = _sample(direct, farthest)
    best: tuple[float, list[float]] = (math.inf, [])
    for degree in range(3, min(_MAX_DEGREE, len(rho) - 1)):
        fit = np.polynomial.Polynomial.fit(angle, rho, degree).convert()
        worst = float(np.abs(fit(angle) - rho).max())
        best = min(best, (worst, fit.coef.tolist()))
        if best[0] < _GOOD_PX:
            break
    return best[1]


FORMAT = LensFormat(
    "ocam",
    "OCamCalib",
    (".txt",),
    read_ocam,
    is_ocam,
    marks="a polynomial",
    rank=10,
    write=lambda camera, suffix: format_ocam(camera),
    names=("*calib_results*.txt",),
    models="ocam",
)
