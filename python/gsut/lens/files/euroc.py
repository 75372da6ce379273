"""EuRoC's sensor.yaml: one camera, with Kalibr's lenses under other names, and its place."""

from __future__ import annotations

from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import LensValues
from gsut.lens.files.kalibr import camera_from_kalibr

_DISTORTIONS = {
    "radial-tangential": "radtan",
    "radtan": "radtan",
    "plumb_bob": "radtan",
    "equidistant": "equi",
    "equi": "equi",
    "none": "none",
    "fov": "fov",
}


def is_euroc(file: LensFile) -> bool:
    """Returns whether the top level of a file has the keys of EuRoC's cameras."""
    return {"intrinsics", "camera_model", "resolution"} <= file.values.keys()


def read_euroc(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the camera of a sensor.yaml, whose lenses are Kalibr's under other names."""
    values, source, text = file.values, file.source, file.text
    reader = LensValues(values, source, text)
    given = str(values.get("distortion_model") or "none")
    if given not in _DISTORTIONS:
        known = ", ".join(_DISTORTIONS)
        reader.fail("distortion_model", f"{given!r} is not supported; supported: {known}")
    coefficients = reader.find("distortion_coefficients", "distortion_coeffs")
    kalibr = LensValues({**values, "distortion_model": _DISTORTIONS[given]}, source, text)
    return camera_from_kalibr(kalibr, coefficients or "distortion_coefficients")


FORMAT = LensFormat(
    "euroc",
    "EuRoC",
    KEYED,
    read_euroc,
    is_euroc,
    marks="camera_model and intrinsics",
    rank=30,
)
