"""EuRoC's sensor.yaml: one camera, with Kalibr's lenses under other names, and its place."""

from __future__ import annotations

from typing import Any

from gsut._core import InputError
from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import LensValues
from gsut.lens.files.kalibr import camera_from_kalibr, to_kalibr

_DISTORTIONS = {
    "radial-tangential": "radtan",
    "radtan": "radtan",
    "plumb_bob": "radtan",
    "equidistant": "equi",
    "equi": "equi",
    "none": "none",
    "fov": "fov",
}
_WRITTEN = {"radtan": "radial-tangential", "equi": "equidistant"}


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


def format_euroc(camera: Camera, body_from_camera: Any) -> str:
    """Formats a sensor.yaml.

    Args:
        camera: the lens.
        body_from_camera: (4, 4), as T_BS.

    Raises:
        InputError: Kalibr, whose lenses EuRoC's are, has no such lens.
    """
    keys = to_kalibr(camera)
    if keys["camera_model"] != "pinhole":
        raise InputError(
            f"EuRoC's sensor.yaml has no camera model for '{camera.model}': convert the lens with "
            "`gsut camera convert`, or choose another layout"
        )
    numbers = ", ".join(repr(float(v)) for row in body_from_camera for v in row)
    return (
        "# Camera\n"
        "sensor_type: camera\n"
        "comment: written by gsut\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{numbers}]\n"
        f"resolution: {keys['resolution']}\n"
        f"camera_model: {keys['camera_model']}\n"
        f"intrinsics: {keys['intrinsics']}\n"
        f"distortion_model: {_WRITTEN.get(keys['distortion_model'], keys['distortion_model'])}\n"
        f"distortion_coefficients: {keys['distortion_coeffs']}\n"
    )


FORMAT = LensFormat(
    "euroc",
    "EuRoC",
    KEYED,
    read_euroc,
    is_euroc,
    marks="camera_model and intrinsics",
    rank=30,
)
