"""MATLAB's fisheyeIntrinsics and cameraIntrinsics, as jsonencode(toStruct(intrinsics)) writes them.

A .mat file holds these objects in a form that only MATLAB reads.
"""

from __future__ import annotations

import json
from typing import Any

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import LensValues, refuse_lens

_PIXEL_SHIFT = -0.5  # pixels: MATLAB's pixel (1, 1) is gsut's (0.5, 0.5)


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


def format_matlab(camera: Camera) -> str:
    """Formats JSON with the arguments of fisheyeIntrinsics or cameraIntrinsics."""
    p = [float(value) for value in camera.params]
    values: dict[str, Any] = {"ImageSize": [camera.height, camera.width]}
    if camera.model == "ocam" and len(p) <= 9:
        values["MappingCoefficients"] = p[5:] + [0.0] * (9 - len(p))
        values["DistortionCenter"] = [p[0] - _PIXEL_SHIFT, p[1] - _PIXEL_SHIFT]
        values["StretchMatrix"] = [[p[2], p[3]], [p[4], 1.0]]
        return json.dumps(values, indent=1) + "\n"
    coefficients = {
        "pinhole": ([0.0, 0.0, 0.0], [0.0, 0.0], 0.0),
        "opencv4": ([*p[4:6], 0.0], p[6:8], 0.0),
        "opencv5": ([*p[4:6], *p[8:9]], p[6:8], 0.0),
        "brown_conrady": (p[5:8], p[9:11], p[4] if len(p) > 4 else 0.0),
    }
    known = camera.model in coefficients and not (camera.model == "brown_conrady" and p[8] != 0.0)
    if not known:
        raise refuse_lens("MATLAB", camera)
    radial, tangential, skew = coefficients[camera.model]
    values["FocalLength"] = p[:2]
    values["PrincipalPoint"] = [value - _PIXEL_SHIFT for value in p[2:4]]
    values.update(RadialDistortion=radial, TangentialDistortion=tangential, Skew=skew)
    return json.dumps(values, indent=1) + "\n"


FORMAT = LensFormat(
    "matlab",
    "MATLAB",
    KEYED,
    read_matlab,
    is_matlab,
    marks="MappingCoefficients or FocalLength",
    rank=50,
    write=lambda camera, suffix: format_matlab(camera),
    names=("*matlab*.json",),
    models="brown_conrady ocam opencv4 opencv5 pinhole",
)
