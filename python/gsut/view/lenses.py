"""The lenses of a session: the dataset's, those of files, and those made with sliders."""

from __future__ import annotations

import base64
import collections
import math
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import CalibrationError, InputError
from gsut.lens import (
    Camera,
    has_focal_length,
    is_lens_name,
    load_camera,
    load_lens,
    measure_field_of_view,
    with_field_of_view,
)
from gsut.lens.files import values_from_camera

_MOST_PIXELS = 12_000_000  # of cameras at a size, which keep their rays: 24 bytes each
_MOST_SLIDERS = 24  # parameters with a slider
_MODELS_OF_TABLES = ("control_points",)  # parameters without sliders: a table of them


class Lenses:
    """Lenses by number, and each at the sizes it is drawn at.

    Args:
        cameras: the dataset's; they are numbers 0, 1 ...
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._lenses = list(cameras)
        self._numbers = {lens: number for number, lens in enumerate(self._lenses)}
        self._resized: collections.OrderedDict[tuple[int, int, int], Camera] = (
            collections.OrderedDict()
        )
        self._lock = threading.RLock()  # each request has a thread of its own

    def add(self, camera: Camera) -> int:
        """The number of a lens, new or known."""
        with self._lock:
            if camera not in self._numbers:
                self._lenses.append(camera)
                self._numbers[camera] = len(self._lenses) - 1
            return self._numbers[camera]

    def replace(self, cameras: Sequence[Camera]) -> None:
        """The dataset's lenses have moved."""
        with self._lock:
            for number, camera in enumerate(cameras):
                if self._lenses[number] != camera:
                    self._lenses[number] = camera
                    for key in [key for key in self._resized if key[0] == number]:
                        del self._resized[key]

    def at(self, number: int, width: int, height: int) -> Camera:
        """A lens scaled to an image of this size.

        Raises:
            InputError: there is no such lens.
        """
        if not 0 <= number < len(self._lenses):
            raise InputError(f"there is no lens {number}; reload the page")
        lens = self._lenses[number]
        if (lens.width, lens.height) == (width, height):
            return lens
        key = (number, width, height)
        with self._lock:
            if key not in self._resized:
                self._resized[key] = lens.resize(width, height)
                while len(self._resized) > 1 and self._pixels() > _MOST_PIXELS:
                    self._resized.popitem(last=False)
            self._resized.move_to_end(key)
            return self._resized[key]

    def _pixels(self) -> int:
        return sum(width * height for _, width, height in self._resized)

    def describe(self, number: int) -> dict[str, Any]:
        """What the page knows of a lens: its values, its sliders and its field."""
        lens = self.at(number, self._lenses[number].width, self._lenses[number].height)
        values = values_from_camera(lens)
        across = measure_field_of_view(lens)
        return {
            "id": number, **values, "params": values["params"][:_MOST_SLIDERS],
            "sliders": _sliders(lens), "field_of_view": across,
            "max_angle": math.degrees(lens.max_angle), "can_zoom": has_focal_length(lens),
            "radians_per_pixel": _radians_per_pixel(lens),
        }  # fmt: skip

    def make(self, wanted: dict[str, Any]) -> int:
        """The number of a lens that the page asks for.

        Args:
            wanted: one of "path" of a lens file, or the name of a lens that is known; "name" and
                "base64" of a lens file; "model", for an example of it; "id" of a lens. Then, if
                given, "params" replace its first parameters, "fit" [width, height] gives it that
                shape of image, and "field_of_view" in degrees, across the image, scales its focal
                lengths.

        Raises:
            InputError, CalibrationError: no such lens; the sentence says why.
        """
        if wanted.get("path"):
            path = str(Path(str(wanted["path"])).expanduser())
            if not is_lens_name(path) and not Path(path).is_file():
                raise InputError(f"{path}: no such lens file")
            lens = load_lens(path)
        elif wanted.get("name"):
            lens = _uploaded(str(wanted["name"]), str(wanted.get("base64", "")))
        elif wanted.get("model"):
            lens = _example(str(wanted["model"]))
        else:
            lens = self._lenses[int(wanted.get("id", 0))]
        if wanted.get("params") is not None:
            given = [float(value) for value in wanted["params"]]
            lens = lens.with_params([*given, *lens.params[len(given) :]])
        if wanted.get("fit"):
            lens = _reshaped(lens, *(int(side) for side in wanted["fit"]))
        if wanted.get("field_of_view"):
            lens = with_field_of_view(lens, float(wanted["field_of_view"]))
        return self.add(lens)


def _uploaded(name: str, content: str) -> Camera:
    """The lens of a file's content in base64; its name chooses the format."""
    with tempfile.TemporaryDirectory(prefix="gsut-lens-") as folder:
        path = Path(folder) / Path(name).name
        path.write_bytes(base64.b64decode(content))
        try:
            return load_camera(path)
        except (InputError, CalibrationError) as error:  # the folder is of no use to anybody
            raise InputError(str(error).replace(f"{folder}/", "")) from None


def _example(model: str) -> Camera:
    if model not in _core.camera_models():
        known = ", ".join(_core.camera_models())
        raise InputError(f"there is no lens model {model!r}; known: {known}")
    _, params, width, height = _core.camera_examples(model)[0]
    return Camera(model, params, width, height)


def _reshaped(lens: Camera, width: int, height: int) -> Camera:
    """The lens on a sensor of another shape: as high as before, its centre in the middle."""
    names = lens.param_names.split()
    if "cx" not in names or _core.camera_traits(lens.model).has_table:
        return lens
    wide = max(1, round(lens.height * width / height))
    params = np.array(lens.params)
    params[names.index("cx")] += (wide - lens.width) / 2
    return Camera(lens.model, params, wide, lens.height, valid_field_angle=lens.valid_field_angle)


def _radians_per_pixel(lens: Camera) -> float:
    """Between neighbouring pixels in the middle of the image; 1 / width where they have no rays."""
    middle = np.array([lens.width, lens.height]) / 2
    half = np.array([0.5, 0.0])
    rays, valid = lens.unproject(np.stack([middle - half, middle + half]))
    if not valid.all():
        return 1.0 / lens.width
    return float(np.linalg.norm(np.cross(*rays))) or 1.0 / lens.width


def _sliders(lens: Camera) -> list[dict[str, Any]]:
    """Name and range of each parameter that is a number on its own."""
    names = lens.param_names.split() if len(lens.params) else []
    rows = []
    for index, value in enumerate(lens.params[:_MOST_SLIDERS]):
        name = names[index] if index < len(names) else "..."
        if name in _MODELS_OF_TABLES:
            break
        if name == "...":
            name = f"coefficient {index + 1}"
        low, high = _range_of(name, float(value), lens)
        rows.append({"name": name, "value": float(value), "low": low, "high": high})
    return rows


def _range_of(name: str, value: float, lens: Camera) -> tuple[float, float]:
    if name in ("fx", "fy"):
        return value / 4, value * 4
    if name in ("cx", "cy"):
        side = lens.width if name == "cx" else lens.height
        return 0.0, float(side)
    most = max(3 * abs(value), 0.05)
    return -most, most
