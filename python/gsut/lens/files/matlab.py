"""MATLAB's fisheyeIntrinsics and cameraIntrinsics, as jsonencode(toStruct(intrinsics)) writes them.

A .mat file holds these objects in a form that only MATLAB reads.
"""

from __future__ import annotations

from typing import Any

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import FROM_ZERO, LensValues

_PIXEL_SHIFT = FROM_ZERO - 1  # pixels: MATLAB's pixel (1, 1) is gsut's (0.5, 0.5)


def is_matlab(file: LensFile) -> bool:
    """Returns whether the keys are those of intrinsics, or of parameters that hold them."""
    return bool({"MappingCoefficients", "FocalLength"} & set(_find_intrinsics(file.values)))


def _find_intrinsics(values: dict[str, Any]) -> dict[str, Any]:
    inner = values.get("Intrinsics", values)
    return inner if isinstance(inner, dict) else values


def read_matlab(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads a fisheye as `ocam`, another lens as `opencv5`, or `brown_conrady` if it has skew."""
    reader = LensValues(_find_intrinsics(file.values), file.source, file.text)
    height, width = reader.read_size(reader.require("ImageSize"))
    if "MappingCoefficients" in reader.values:
        cx, cy = reader.read_numbers(reader.require("DistortionCenter"), 2)
        stretch = [1.0, 0.0, 0.0, 1.0]
        if reader.find("StretchMatrix"):
            stretch = reader.read_numbers("StretchMatrix", 4)
        c, d, e, one = stretch
        if one != 1.0:
            reader.fail("StretchMatrix", f"expected [c d; e 1], found {stretch}")
        poly = reader.read_numbers("MappingCoefficients", 4)
        params = [cx + _PIXEL_SHIFT, cy + _PIXEL_SHIFT, c, d, e, *poly]
        keys = [*2 * ["DistortionCenter"], *3 * ["StretchMatrix"], *4 * ["MappingCoefficients"]]
        return reader.make_camera("ocam", params, width, height, keys=keys)
    focal = reader.read_numbers(reader.require("FocalLength"), 2)
    center = [
        value + _PIXEL_SHIFT for value in reader.read_numbers(reader.require("PrincipalPoint"), 2)
    ]
    radial = reader.read_numbers("RadialDistortion") if reader.find("RadialDistortion") else []
    if len(radial) not in (0, 2, 3):
        reader.fail("RadialDistortion", f"expected 2 or 3 coefficients, found {len(radial)}")
    k1, k2, k3 = (*radial, 0.0, 0.0, 0.0)[:3]
    tangential = [0.0, 0.0]
    if reader.find("TangentialDistortion"):
        tangential = reader.read_numbers("TangentialDistortion", 2)
    skew = reader.read_number("Skew", 0.0)
    keys = [*2 * ["FocalLength"], *2 * ["PrincipalPoint"]]
    if skew != 0.0:
        brown = [*focal, *center, skew, k1, k2, k3, 0.0, *tangential]
        keys += ["Skew", *4 * ["RadialDistortion"], *2 * ["TangentialDistortion"]]
        return reader.make_camera("brown_conrady", brown, width, height, keys=keys)
    keys += [*2 * ["RadialDistortion"], *2 * ["TangentialDistortion"], "RadialDistortion"]
    params = [*focal, *center, k1, k2, *tangential, k3]
    return reader.make_camera("opencv5", params, width, height, keys=keys)


FORMAT = LensFormat(
    "matlab",
    "MATLAB",
    KEYED,
    read_matlab,
    is_matlab,
    marks="MappingCoefficients or FocalLength",
    rank=50,
)
