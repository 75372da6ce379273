"""OpenSfM's camera_models.json: lengths in units of the image's longer side, from its middle."""

from __future__ import annotations

import json

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import LensValues, choose_name, skip_to

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


FORMAT = LensFormat(
    "opensfm",
    "OpenSfM",
    KEYED,
    read_opensfm,
    is_opensfm,
    marks="projection_type",
    rank=60,
    has_ids=True,
)
