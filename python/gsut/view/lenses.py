"""Keeps the lenses of a session: the dataset's, those of files, and those made with sliders."""

from __future__ import annotations

import base64
import collections
import math
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.files import Number, write_file
from gsut.lens import (
    Camera,
    has_focal_length,
    is_lens_name,
    load_camera,
    load_lens,
    measure_field_of_view,
    with_field_of_view,
)
from gsut.lens.files import OWN_SUFFIX, values_from_camera

# Most pixels of one frame: eight times those of a 4k screen half its width.
MOST_DRAWN = 33_000_000
# Most pixels of a frame whose buffers the next one uses again, and of resized cameras together,
# each of which keeps a ray of 24 bytes a pixel: those of a 4k screen, and half more.
MOST_KEPT = 12_000_000
# Longest side of an image in pixels, of what any sensor or screen has.
_MOST_SIDE = 65_536
# Most parameters with a slider: more do not fit the panel.
_MOST_SLIDERS = 24
# Shape of a request for a lens, see `Lenses.make`.
LENS = {
    **dict.fromkeys(("path?", "name?", "base64?", "model?"), str), "id?": Number(whole=True),
    "params?": Number(shape=(None,)), "fit?": Number(whole=True, shape=(2,)),
    "field_of_view?": Number(),
}  # fmt: skip
# Seconds for a lens file to be read: a table that a lens is fitted to takes a few.
_READ_SECONDS = 30
# Program that reads a lens file and writes its lens in gsut's format, which holds every lens.
_READER = """import sys
from gsut.lens import load_camera, save_camera
try:
    save_camera(load_camera(sys.argv[1]), sys.argv[2])
except (ValueError, OSError) as error:
    sys.exit(str(error))"""
# Parameters without sliders: a table of them.
_TABLES = ("control_points",)


class Lenses:
    """Keeps lenses by number, and each at the sizes that it is drawn at.

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
        """Adds a lens if it is new; returns its number."""
        with self._lock:
            if camera not in self._numbers:
                self._lenses.append(camera)
                self._numbers[camera] = len(self._lenses) - 1
            return self._numbers[camera]

    def replace(self, cameras: Sequence[Camera]) -> None:
        """Replaces the dataset's lenses by refined ones."""
        with self._lock:
            for number, camera in enumerate(cameras):
                if self._lenses[number] != camera:
                    self._lenses[number] = camera
                    for key in [key for key in self._resized if key[0] == number]:
                        del self._resized[key]

    def resize(self, number: int, width: int, height: int) -> Camera:
        """Returns a lens scaled to an image of this size.

        Raises:
            InputError: there is no such lens, or the image is too large.
        """
        lens = self._get_lens(number)
        if (lens.width, lens.height) == (width, height):
            return lens
        check_size(width, height)
        key = (number, width, height)
        with self._lock:
            if key not in self._resized:
                resized = lens.resize(width, height)
                if width * height > MOST_KEPT:
                    return resized  # kept, it would hold a gigabyte for one frame
                self._resized[key] = resized
                while self._count_pixels() > MOST_KEPT:
                    self._resized.popitem(last=False)
            self._resized.move_to_end(key)
            return self._resized[key]

    def _get_lens(self, number: int) -> Camera:
        if not 0 <= number < len(self._lenses):
            raise InputError(f"there is no lens {number}; reload the page")
        return self._lenses[number]

    def _count_pixels(self) -> int:
        return sum(width * height for _, width, height in self._resized)

    def describe(self, number: int) -> dict[str, Any]:
        """Describes a lens for the page: its values, its sliders and its field."""
        lens = self.resize(number, self._lenses[number].width, self._lenses[number].height)
        values = values_from_camera(lens)
        across = measure_field_of_view(lens)
        return {
            "id": number, **values, "params": values["params"][:_MOST_SLIDERS],
            "sliders": _describe_sliders(lens), "field_of_view": across,
            "max_angle": math.degrees(lens.max_angle), "can_zoom": has_focal_length(lens),
            "radians_per_pixel": _measure_radians_per_pixel(lens),
        }  # fmt: skip

    def make(self, wanted: dict[str, Any]) -> int:
        """Makes the lens that the page requests; returns its number.

        Args:
            wanted: one of "path" of a lens file, or the name of a known lens; "name" and "base64"
                of a lens file; "model", for an example of it; "id" of a lens. Then, if given,
                "params" replace its first parameters, "fit" [width, height] gives it that shape of
                image, and "field_of_view" in degrees, across the image, scales its focal lengths.

        Raises:
            InputError, CalibrationError: there is no such lens; the message says why.
        """
        if wanted.get("path"):
            path = str(Path(wanted["path"]).expanduser())
            if not is_lens_name(path) and not Path(path).is_file():
                raise InputError(f"{path}: no such lens file")
            lens = load_lens(path) if is_lens_name(path) else _read_lens_file(Path(path))
        elif wanted.get("name"):
            lens = _read_upload(wanted["name"], wanted.get("base64", ""))
        elif wanted.get("model"):
            lens = _make_example(wanted["model"])
        else:
            lens = self._get_lens(int(wanted.get("id", 0)))
        if "params" in wanted:
            given = wanted["params"]
            if len(given) > len(lens.params):
                raise InputError(
                    f"this {lens.model} lens has {len(lens.params)} parameters, found {len(given)}"
                )
            lens = lens.with_params([*given, *lens.params[len(given) :]])
        if "fit" in wanted:
            width, height = (int(side) for side in wanted["fit"])
            check_size(width, height)
            lens = _reshape(lens, width, height)
        if "field_of_view" in wanted:
            degrees = wanted["field_of_view"]
            if not 0 < degrees <= 360:
                raise InputError(f"a field of view is above 0 and at most 360, found {degrees:g}")
            lens = with_field_of_view(lens, degrees)
        return self.add(lens)


def check_size(width: int, height: int) -> None:
    """Raises InputError if an image of this size cannot be drawn."""
    if min(width, height) < 1 or max(width, height) > _MOST_SIDE or width * height > MOST_DRAWN:
        raise InputError(f"a frame of {width} x {height} cannot be drawn; at most 33 million")


def _read_upload(name: str, content: str) -> Camera:
    """Reads the lens of a file's content in base64; its name decides the format."""
    with tempfile.TemporaryDirectory(prefix="gsut-lens-") as folder:
        path = Path(folder) / Path(name).name
        write_file(path, base64.b64decode(content))
        try:
            return _read_lens_file(path)
        except InputError as error:  # the folder's name helps nobody
            raise InputError(str(error).replace(f"{folder}/", "")) from None


def _read_lens_file(path: Path) -> Camera:
    """Reads a lens file in another process: a long text must not slow what others draw here.

    Raises:
        InputError: it holds no lens, or takes too long.
    """
    with tempfile.TemporaryDirectory(prefix="gsut-lens-") as folder:
        found = Path(folder) / f"found{OWN_SUFFIX}"
        command = [sys.executable, "-c", _READER, str(path), str(found)]
        try:
            done = subprocess.run(
                command,
                capture_output=True,
                encoding="utf-8",
                errors="replace",
                timeout=_READ_SECONDS,
            )
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: reading it takes more than {_READ_SECONDS} s") from None
        if done.returncode:
            raise InputError(done.stderr.strip() or f"{path}: cannot be read")
        return load_camera(found)


def _make_example(model: str) -> Camera:
    if model not in _core.camera_models():
        known = ", ".join(_core.camera_models())
        raise InputError(f"there is no lens model {model!r}; known: {known}")
    _, params, width, height = _core.camera_examples(model)[0]
    return Camera(model, params, width, height)


def _reshape(lens: Camera, width: int, height: int) -> Camera:
    """Returns the lens on a sensor of another shape: of equal height, its centre in the middle."""
    names = lens.param_names.split()
    if "cx" not in names or _core.camera_traits(lens.model).has_table:
        return lens
    wide = max(1, round(lens.height * width / height))
    params = np.array(lens.params)
    params[names.index("cx")] += (wide - lens.width) / 2
    return Camera(lens.model, params, wide, lens.height, valid_field_angle=lens.valid_field_angle)


def _measure_radians_per_pixel(lens: Camera) -> float:
    """Returns the angle between adjacent pixels in the middle; 1 / width if they have no rays."""
    middle = np.array([lens.width, lens.height]) / 2
    half = np.array([0.5, 0.0])
    rays, valid = lens.unproject(np.stack([middle - half, middle + half]))
    if not valid.all():
        return 1.0 / lens.width
    return float(np.linalg.norm(np.cross(*rays))) or 1.0 / lens.width


def _describe_sliders(lens: Camera) -> list[dict[str, Any]]:
    """Returns name and range of each parameter that is a number on its own."""
    names = lens.param_names.split() if len(lens.params) else []
    rows = []
    for index, value in enumerate(lens.params[:_MOST_SLIDERS]):
        name = names[index] if index < len(names) else "..."
        if name in _TABLES:
            break
        if name == "...":
            name = f"coefficient {index + 1}"
        low, high = _choose_range(name, float(value), lens)
        rows.append({"name": name, "value": float(value), "low": low, "high": high})
    return rows


def _choose_range(name: str, value: float, lens: Camera) -> tuple[float, float]:
    if name in ("fx", "fy"):
        return value / 4, value * 4
    if name in ("cx", "cy"):
        side = lens.width if name == "cx" else lens.height
        return 0.0, float(side)
    most = max(3 * abs(value), 0.05)
    return -most, most
