"""COLMAP's camera models, and its cameras.txt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from gsut._core import CalibrationError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFormat
from gsut.lens.files._values import LensValues, choose_name, refuse_lens

_Values = Sequence[float]


class _Model(NamedTuple):
    """One COLMAP model: its number, number of parameters, and gsut's lens and parameters for it."""

    number: int
    num_params: int
    lens: str
    params: Callable[[_Values], list[float]]


def _repeat_focal(p: _Values) -> list[float]:
    return [p[0], *p]


# Number, length and order of the parameters: COLMAP, sensor/models in src/colmap.
_MODELS = {
    "SIMPLE_PINHOLE": _Model(0, 3, "pinhole", _repeat_focal),
    "PINHOLE": _Model(1, 4, "pinhole", list),
    "SIMPLE_RADIAL": _Model(2, 4, "opencv4", lambda p: [p[0], *p, 0.0, 0.0, 0.0]),
    "RADIAL": _Model(3, 5, "opencv4", lambda p: [p[0], *p, 0.0, 0.0]),
    "OPENCV": _Model(4, 8, "opencv4", list),
    "OPENCV_FISHEYE": _Model(5, 8, "kannala_brandt", list),
    "FULL_OPENCV": _Model(6, 12, "opencv8", list),
    "FOV": _Model(7, 5, "fov", list),
    "SIMPLE_RADIAL_FISHEYE": _Model(8, 4, "kannala_brandt", _repeat_focal),
    "RADIAL_FISHEYE": _Model(9, 5, "kannala_brandt", _repeat_focal),
    "THIN_PRISM_FISHEYE": _Model(10, 12, "thin_prism_fisheye", list),
    "RAD_TAN_THIN_PRISM_FISHEYE": _Model(11, 16, "fisheye624", list),
    "SIMPLE_DIVISION": _Model(12, 4, "division", _repeat_focal),
    "DIVISION": _Model(13, 5, "division", list),
    "SIMPLE_FISHEYE": _Model(14, 3, "kannala_brandt", _repeat_focal),
    "FISHEYE": _Model(15, 4, "kannala_brandt", list),
    "EUCM": _Model(16, 6, "extended_unified", list),
    "EQUIRECTANGULAR": _Model(17, 2, "equirectangular", lambda p: []),
}
# Lenses that COLMAP has with the same parameters, beside those that format_colmap converts.
_WRITTEN = {
    "division": "DIVISION",
    "extended_unified": "EUCM",
    "fisheye624": "RAD_TAN_THIN_PRISM_FISHEYE",
    "fov": "FOV",
    "thin_prism_fisheye": "THIN_PRISM_FISHEYE",
}
MODEL_NAMES = {model.number: name for name, model in _MODELS.items()}
SUPPORTED = ", ".join(_MODELS)
# Number of parameters by model number. Binary files do not hold it.
PARAMETER_COUNTS = {model.number: model.num_params for model in _MODELS.values()}


def camera_from_colmap(
    model: str | int, params: Sequence[float], width: int, height: int, source: str = ""
) -> Camera:
    """Makes the camera of a COLMAP camera record.

    Args:
        model: COLMAP's name ("OPENCV_FISHEYE") or number (5).
        params: in COLMAP's order for that model. Its pixel convention is gsut's.
        width, height: of the image, in pixels.
        source: file and line, for messages.

    Returns:
        The camera: SIMPLE_PINHOLE and PINHOLE are `pinhole`; SIMPLE_RADIAL, RADIAL and OPENCV
        `opencv4`; FULL_OPENCV `opencv8`; SIMPLE_FISHEYE, FISHEYE, SIMPLE_RADIAL_FISHEYE,
        RADIAL_FISHEYE and OPENCV_FISHEYE `kannala_brandt` with 0, 0, 1, 2 and 4 coefficients;
        RAD_TAN_THIN_PRISM_FISHEYE `fisheye624`; SIMPLE_DIVISION and DIVISION `division`; EUCM
        `extended_unified`; FOV, THIN_PRISM_FISHEYE and EQUIRECTANGULAR the lenses of these names.

    Raises:
        CalibrationError: unknown or unsupported model, wrong number of parameters, no lens.
    """
    prefix = f"{source}: " if source else ""
    name = MODEL_NAMES.get(model, str(model)) if isinstance(model, int) else str(model)
    name = name.upper()
    entry = _MODELS.get(name)
    if entry is None:
        raise CalibrationError(
            f"{prefix}camera model {name} is not supported; supported: {SUPPORTED}"
        )
    if len(params) != entry.num_params:
        raise CalibrationError(
            f"{prefix}camera model {name} has {entry.num_params} parameters, found {len(params)}"
        )
    if name == "EQUIRECTANGULAR" and list(params) != [width, height]:
        raise CalibrationError(
            f"{prefix}EQUIRECTANGULAR's parameters {list(params)} are not the image's size"
            f" {width} x {height}; a part of a panorama is not supported"
        )
    lens_params = entry.params([float(value) for value in params])
    return LensValues({}, source).make_camera(entry.lens, lens_params, width, height)


class ColmapCamera(NamedTuple):
    """A camera as a file of COLMAP lists it: model by name (text) or number (binary)."""

    camera_id: int
    model: str | int
    width: int
    height: int
    params: list[float]
    where: str


def list_text_cameras(text: str, source: str) -> list[ColmapCamera]:
    """Lists the cameras of a cameras.txt.

    Raises:
        CalibrationError: names the malformed line.
    """
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        where = f"{source}, line {number}"
        if len(words) < 5:
            raise CalibrationError(
                f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[], found {line.strip()!r}"
            )
        try:
            key, width, height = int(words[0]), int(words[2]), int(words[3])
            params = [float(word) for word in words[4:]]
        except ValueError as error:
            raise CalibrationError(f"{where}: {error}") from error
        found.append(ColmapCamera(key, words[1], width, height, params, where))
    return require_one_each(found)


def require_one_each(found: list[ColmapCamera]) -> list[ColmapCamera]:
    """Returns cameras of which no two have one number.

    Raises:
        CalibrationError: two do: names the later one.
    """
    numbers = set[int]()
    for each in found:
        if each.camera_id in numbers:
            what = f"camera {each.camera_id} is there twice; give one of them another number"
            raise CalibrationError(f"{each.where}: {what}")
        numbers.add(each.camera_id)
    return found


def choose_camera(found: list[ColmapCamera], source: str, camera_id: int | str | None) -> Camera:
    """Makes the only camera, or the one with this number."""
    if not found:
        raise CalibrationError(f"{source}: holds no camera")
    by_number = {str(each.camera_id): each for each in found}
    chosen = by_number[choose_name(by_number, camera_id, source)]
    where = f"{chosen.where} (camera {chosen.camera_id})"
    return camera_from_colmap(chosen.model, chosen.params, chosen.width, chosen.height, where)


def to_colmap(camera: Camera) -> tuple[str, int, list[float]]:
    """Returns COLMAP's name and number of a lens' model, and its parameters in COLMAP's order.

    Raises:
        InputError: COLMAP has no such lens.
    """
    params = [float(value) for value in camera.params]
    if camera.model == "pinhole":
        name = "PINHOLE"
    elif camera.model == "opencv4":
        name = "OPENCV"
    elif camera.model in ("opencv5", "opencv8"):
        name = "FULL_OPENCV"
    elif camera.model == "kannala_brandt" and len(params) <= _MODELS["OPENCV_FISHEYE"].num_params:
        name = "OPENCV_FISHEYE"
    elif camera.model == "equirectangular":
        name, params = "EQUIRECTANGULAR", [float(camera.width), float(camera.height)]
    elif camera.model == "unified":
        name, params = "EUCM", [*params, 1.0]
    elif camera.model in _WRITTEN:
        name = _WRITTEN[camera.model]
    else:
        raise refuse_lens("COLMAP", camera)
    params += [0.0] * (_MODELS[name].num_params - len(params))
    return name, _MODELS[name].number, params


def format_colmap(camera: Camera) -> str:
    """Formats a cameras.txt with this camera as number 1."""
    name, _, params = to_colmap(camera)
    values = " ".join(repr(value) for value in params)
    return (
        "# Camera list with one line of data per camera:\n"
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"1 {name} {camera.width} {camera.height} {values}\n"
    )


FORMAT = LensFormat(
    "colmap",
    "COLMAP",
    (".txt",),
    lambda file, camera_id: choose_camera(
        list_text_cameras(file.text, file.source), file.source, camera_id
    ),
    rank=20,
    write=lambda camera, suffix: format_colmap(camera),
    names=("*.txt",),
    has_ids=True,
)
