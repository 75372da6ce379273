"""OCamCalib's calib_results.txt: rows before columns, and a lens that looks along -z."""

from __future__ import annotations

import math
import warnings

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
# Pixels (root mean square) beyond which a file's two polynomials are two lenses: OCamCalib fits
# its inverse until it is within a hundredth.
_TWO_LENSES_PX = 0.5
_INVERSE = "inverse"  # the camera_id of the lens that the inverse polynomial makes
_MAX_DIRECT_DEGREE = 10  # of a polynomial fitted to an inverse one; OCamCalib's own have 4


def is_ocam(file: LensFile) -> bool:
    """Returns whether the first line that is no comment holds a length, then numbers."""
    for line in file.text.splitlines():
        words = line.split("#", 1)[0].split()
        if words:
            return len(words) > 1 and words[1].lstrip("+-")[:1].isdigit()
    return False


def read_ocam(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the camera of a calib_results.txt.

    Args:
        file: the file. A warning says where its two polynomials are two lenses.
        camera_id: "inverse": the lens that its inverse polynomial makes, from points to pixels;
            None: that of its polynomial, from pixels to rays.

    Raises:
        CalibrationError: names the line that is no list of numbers, or what is missing.
        InputError: another camera_id.
    """
    if camera_id not in (None, _INVERSE):
        raise InputError(
            f"{file.source}: has no camera {camera_id}; it holds one lens, and '{_INVERSE}', the "
            "lens that its inverse polynomial makes"
        )
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
    (_, *poly), (_, *inverse), center, affine, size = (values for _, values in blocks)
    if len(poly) > 1 and poly[1] != 0.0:
        raise CalibrationError(
            f"{source}, line {line_of_polynomial}: the coefficient of rho is {poly[1]:g}; a smooth"
            " lens has 0 there (OCamCalib always writes 0)"
        )
    # (row, column) = [[c, d], [e, 1]] (x down, y right): gsut has (column, row) and the 1 first.
    c, d, e = affine
    away = math.hypot(*(max(at, side - at) for at, side in zip(center, size, strict=True)))
    direct = np.array(poly)
    if camera_id == _INVERSE:
        poly = _invert(file.source, np.array(inverse), away)
    params = [center[1] + _PIXEL_SHIFT, center[0] + _PIXEL_SHIFT, 1 / c, e / c, d / c]
    params += [-value * c ** (1 - k) for k, value in enumerate(poly) if k != 1]
    sizes = LensValues({"height": size[0], "width": size[1]}, source, text)
    shape = sizes.read_pixels("width"), sizes.read_pixels("height")
    keys = [*2 * ["center"], *3 * ["affine parameters"], *(len(params) - _FIRST) * ["polynomial"]]
    camera = sizes.make_camera("ocam", params, *shape, keys=keys)
    if camera_id is None:
        _compare(file.source, direct, np.array(inverse), away)
    return camera


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


def _compare(source: str, direct: np.ndarray, inverse: np.ndarray, farthest: float) -> None:
    """Warns if the two polynomials of a file are far from each other's inverse."""
    rho, angle = _sample(direct, farthest)
    off = np.abs(np.polyval(inverse[::-1], angle) - rho)
    rms = float(np.sqrt(np.average(off**2, weights=rho))) if len(rho) > 1 else 0.0
    if rms > _TWO_LENSES_PX:
        begin = rho[np.argmax(off > _TWO_LENSES_PX)]
        warnings.warn(
            f"{source}: its polynomial and its inverse polynomial are two lenses, {rms:.2g} px "
            f"apart (root mean square over the image, from {begin:.0f} px off the centre on); gsut "
            "takes the polynomial. Only photographs say which is right; for the other one: gsut "
            f"camera convert {source} ocam --camera-id {_INVERSE} -o inverse.lens.json",
            stacklevel=2,
        )


def _invert(source: str, inverse: np.ndarray, farthest: float) -> list[float]:
    """Fits the polynomial, without a coefficient of rho, of which this is the inverse."""
    angle = np.linspace(-math.pi / 2, math.pi / 2, 2 * _SAMPLES + 1)[1:-1]
    rho = np.polyval(inverse[::-1], angle)
    # The image's part that rises: from the axis to the farthest corner.
    first = int(np.argmax(rho > 0))
    rising = np.cumprod(np.concatenate([[True], np.diff(rho[first:]) > 0])) > 0
    rho, angle = rho[first:][rising], angle[first:][rising]
    rho, angle = rho[rho < farthest], angle[rho < farthest]
    z = rho * np.tan(angle)
    # Pixels by which a ray moves as its z does: dz times this.
    weight = rho / (rho**2 + z**2) * np.gradient(rho, angle)
    best: tuple[float, list[float]] = (math.inf, [])
    for degree in range(4, _MAX_DIRECT_DEGREE + 1):
        powers = np.array([0, *range(2, degree + 1)])
        terms = (rho[:, None] / farthest) ** powers * weight[:, None]
        fit = np.linalg.lstsq(terms, z * weight, rcond=None)[0]
        worst = float(np.abs(terms @ fit - z * weight).max())
        if worst < best[0]:
            values = (fit / farthest**powers).tolist()
            best = (worst, [values[0], 0.0, *values[1:]])
        if worst < _GOOD_PX:
            break
    if not best[0] < _TWO_LENSES_PX:
        raise CalibrationError(
            f"{source}: no lens has its inverse polynomial: the nearest is {best[0]:.2g} px off; "
            "take its polynomial (no camera id), or calibrate again"
        )
    return best[1]


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
    has_ids=True,
)
