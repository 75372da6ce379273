"""Metashape's calibration XML: one <calibration>, or the sensors of exported cameras."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from gsut._core import CalibrationError, InputError
from gsut.lens.camera import Camera
from gsut.lens.files._format import LensFile, LensFormat, is_opencv_xml
from gsut.lens.files._values import LensValues

# Lens of each projection; both pixel conventions put the first pixel's centre at (0.5, 0.5), and
# cx, cy count from the middle of the image. b1 adds to the focal length across, b2 is the skew.
_LENSES = {"frame": "brown_conrady", "fisheye": "brown_fisheye"}
_SPHERE = "spherical"
# Metashape's names of k1 k2 k3 k4 p1 p2: its P1 stands where OpenCV has p2.
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "p2", "p1")


def read_metashape(file: LensFile, camera_id: int | str | None) -> Camera:
    """Reads the only calibration, or that of the sensor with this number or label.

    Of several calibrations of a sensor it takes the adjusted one.
    """
    text, source = file.text, file.source
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise CalibrationError(f"{source}, line {error.position[0]}: not XML ({error})") from error
    found = _list_sensors(root)
    if not found:
        if root.tag != "calibration":
            raise CalibrationError(f"{source}: holds no <calibration>; is it Metashape's?")
        found = [("0", "", root)]
    known = ", ".join(f"{number} ({label})" if label else number for number, label, _ in found)
    if camera_id is None and len(found) > 1:
        raise InputError(f"{source}: holds {len(found)} sensors; give camera_id, one of {known}")
    chosen = [each for *names, each in found if camera_id is None or str(camera_id) in names]
    if len(chosen) > 1:
        raise InputError(
            f"{source}: {len(chosen)} sensors are called {camera_id}; give a number or a label of "
            f"one of {known}, or export the chunk of one camera alone"
        )
    if not chosen:
        raise InputError(f"{source}: has no sensor {camera_id}; it holds {known}")
    return _read_calibration(chosen[0], source, text)


def _list_sensors(root: ElementTree.Element) -> list[tuple[str, str, ElementTree.Element]]:
    """Lists number, label and calibration of the sensors in chunks that are not disabled.

    A spherical sensor has no calibration: its size is all of it.
    """
    chunks = list(root.iter("chunk"))
    enabled = [chunk for chunk in chunks if chunk.get("enabled", "true") not in ("false", "0")]
    found = []
    for chunk in enabled or chunks or [root]:
        for index, sensor in enumerate(chunk.iter("sensor")):
            given = sensor.findall("calibration")
            adjusted = [each for each in given if each.get("class") == "adjusted"]
            if not given and sensor.get("type") == _SPHERE:
                given = [sensor]
            if given:
                names = sensor.get("id", str(index)), sensor.get("label", "")
                found.append((*names, (adjusted or given)[-1]))
    return found


def _read_calibration(calibration: ElementTree.Element, source: str, text: str) -> Camera:
    values: dict[str, object] = {child.tag: child.text for child in calibration}
    resolution = calibration.find("resolution")
    if resolution is not None:
        values.update(resolution.attrib)
    reader = LensValues(values, source, text)
    size = reader.read_pixels(reader.require("width")), reader.read_pixels(reader.require("height"))
    projection = str(values.get("projection", calibration.get("type", "frame"))).strip()
    if projection == _SPHERE:
        return reader.make_camera("equirectangular", [], *size)
    if projection not in _LENSES:
        known = ", ".join((*_LENSES, _SPHERE))
        raise CalibrationError(
            f"{source}: projection '{projection}' is not supported; supported: {known}"
        )
    for key in ("p3", "p4"):
        if reader.read_number(key, 0.0) != 0.0:
            reader.fail(key, "is of a lens that newer Metashape no longer has; estimate without it")
    focal = reader.read_number(reader.require("f"))
    center = [0.5 * size[k] + reader.read_number(key, 0.0) for k, key in enumerate(("cx", "cy"))]
    coefficients = [reader.read_number(key, 0.0) for key in _COEFFICIENTS]
    params = [focal + reader.read_number("b1", 0.0), focal, *center, reader.read_number("b2", 0.0)]
    keys = ["b1" if "b1" in values else "f", "f", "cx", "cy", "b2", *_COEFFICIENTS]
    return reader.make_camera(_LENSES[projection], params + coefficients, *size, keys=keys)


FORMAT = LensFormat(
    "metashape",
    "Metashape",
    (".xml",),
    read_metashape,
    lambda file: not is_opencv_xml(file),
    marks="<calibration>",
    has_ids=True,
)
