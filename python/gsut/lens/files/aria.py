"""Project Aria's calibration as JSON: a dictionary of cameras."""

from __future__ import annotations

from gsut._core import CalibrationError
from gsut.lens.camera import Camera
from gsut.lens.files._format import KEYED, LensFile, LensFormat
from gsut.lens.files._values import FROM_ZERO, LensValues, choose_name, skip_to

# gsut's lens, the number of parameters, and how many of them are focal lengths.
_MODELS = {
    "FISHEYE624": ("fisheye624", 15, 1),
    "KANNALA_BRANDT_K3": ("kannala_brandt", 8, 2),
    "LINEAR": ("pinhole", 4, 2),
}


def is_aria(file: LensFile) -> bool:
    """Returns whether the keys are those of an Aria calibration."""
    cameras = file.values.get("cameras")
    return isinstance(cameras, dict) and any(
        isinstance(entry, dict) and "params" in entry and "model" in entry
        for entry in cameras.values()
    )


def read_aria(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the only camera, or the one with this label ("camera-rgb").

    Each has model, params (FISHEYE624: f cx cy k0..k5 p0 p1 s0..s3), size and, if known,
    max_solid_angle: the largest angle from the axis in radians.
    """
    cameras, source = file.values["cameras"], file.source
    label = choose_name(cameras, camera_id, source)
    entry = cameras[label]
    if not isinstance(entry, dict):
        raise CalibrationError(f"{source}, key '{label}': expected a dictionary, found {entry!r}")
    reader = LensValues(entry, source, skip_to(file.text, f'"{label}": {{'))
    name = str(entry[reader.require("model")]).rpartition(".")[2]
    if name not in _MODELS:
        reader.fail("model", f"{name!r} is not supported; supported: {', '.join(_MODELS)}")
    lens, count, num_focal = _MODELS[name]
    numbers = reader.read_numbers(reader.require("params"), count)
    focal, (cx, cy), rest = numbers[:num_focal], numbers[num_focal : num_focal + 2], numbers
    params = [focal[0], focal[-1], cx + FROM_ZERO, cy + FROM_ZERO, *rest[num_focal + 2 :]]
    size = reader.read_size(reader.require("size"))
    limit = reader.read_number("max_solid_angle") if "max_solid_angle" in entry else None
    return reader.make_camera(lens, params, *size, limit, "params")


FORMAT = LensFormat(
    "aria",
    "Project Aria",
    KEYED,
    read_aria,
    is_aria,
    marks="cameras",
    rank=10,
    has_ids=True,
)
