"""OpenSfM's camera_models.json: lengths in units of the image's longer side, from its middle."""

from __future__ import annotations

import json
from typing import Any

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import LensValues, choose_name, refuse_lens, skip_to

# gsut's lens and the names of its coefficients, "" for one that is 0, by projection_type.
_LENSES = {
    "perspective": ("opencv4", ("k1", "k2", "", "")),
    "simple_radial": ("opencv4", ("k1", "", "", "")),
    "radial": ("opencv4", ("k1", "k2", "", "")),
    "brown": ("opencv5", ("k1", "k2", "p1", "p2", "k3")),
    "fisheye": ("kannala_brandt", ("k1", "k2")),
    "fisheye_opencv": ("kannala_brandt", ("k1", "k2", "k3", "k4")),
    "fisheye62": ("fisheye624", (*(f"k{i}" for i in range(1, 7)), "p1", "p2", "", "", "", "")),
    "fisheye624": (
        "fisheye624",
        (*(f"k{i}" for i in range(1, 7)), "p1", "p2", "s0", "s1", "s2", "s3"),
    ),
}
_SPHERES = ("spherical", "equirectangular")
# What is written for each of gsut's lenses.
_WRITTEN = {
    "opencv5": "brown", "kannala_brandt": "fisheye_opencv", "fisheye624": "fisheye624",
    "opencv4": "brown", "pinhole": "brown",
}  # fmt: skip
_TYPE_KEY = "projection_type"


def is_opensfm(file: LensFile) -> bool:
    """Returns whether every value is a camera with a projection type."""
    return bool(file.values) and all(
        isinstance(entry, dict) and _TYPE_KEY in entry for entry in file.values.values()
    )


def read_opensfm(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the only camera, or the one with this name."""
    values = file.values
    name = choose_name(values, camera_id, file.source)
    reader = LensValues(values[name], file.source, skip_to(file.text, json.dumps(name)))
    kind = str(values[name][_TYPE_KEY])
    width, height = reader.read_pixels("width"), reader.read_pixels("height")
    if kind in _SPHERES:
        return reader.make_camera("equirectangular", [], width, height)
    if kind not in _LENSES:
        supported = ", ".join((*_LENSES, *_SPHERES))
        reader.fail(_TYPE_KEY, f"{kind!r} is not supported; supported: {supported}")
    lens, keys = _LENSES[kind]
    unit = max(width, height)
    focal_key = reader.require("focal_x", "focal")
    focal_x = reader.read_number(focal_key)
    focal_y = reader.read_number("focal_y", focal_x)
    center = [
        0.5 * size + unit * reader.read_number(key, 0.0)
        for size, key in ((width, "c_x"), (height, "c_y"))
    ]
    coefficients = [reader.read_number(key, 0.0) if key else 0.0 for key in keys]
    params = [unit * focal_x, unit * focal_y, *center, *coefficients]
    focal_keys = [focal_key, "focal_y" if "focal_y" in values[name] else focal_key]
    return reader.make_camera(lens, params, width, height, keys=[*focal_keys, "c_x", "c_y", *keys])


def format_opensfm(camera: Camera) -> str:
    """Formats a camera_models.json with this camera."""
    width, height = camera.width, camera.height
    entry: dict[str, Any] = {_TYPE_KEY: _SPHERES[0], "width": width, "height": height}
    if camera.model != "equirectangular":
        kind = _WRITTEN.get(camera.model, "")
        keys = _LENSES[kind][1] if kind else ()
        fx, fy, cx, cy = (float(value) for value in camera.params[:4]) if kind else (0.0,) * 4
        coefficients = [float(value) for value in camera.params[4:]]
        if not kind or len(coefficients) > len(keys):
            raise refuse_lens("OpenSfM", camera)
        coefficients += [0.0] * (len(keys) - len(coefficients))
        unit = max(width, height)
        entry[_TYPE_KEY] = kind
        entry |= {"focal_x": fx / unit, "focal_y": fy / unit}
        entry |= {"c_x": (cx - 0.5 * width) / unit, "c_y": (cy - 0.5 * height) / unit}
        entry |= {key: value for key, value in zip(keys, coefficients, strict=True) if key}
    return json.dumps({"camera": entry}, indent=1) + "\n"


FORMAT = LensFormat(
    "opensfm",
    "OpenSfM",
    KEYED,
    read_opensfm,
    is_opensfm,
    marks="projection_type",
    rank=60,
    write=lambda camera, suffix: format_opensfm(camera),
    names=("*camera_models*.json",),
    models="equirectangular fisheye624 kannala_brandt opencv4 opencv5 pinhole",
    has_ids=True,
)
