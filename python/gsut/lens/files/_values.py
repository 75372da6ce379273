"""Checked access to the keys of a parsed lens file; errors name file, line and key."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from typing import Any, NoReturn

from gsut._core import CalibrationError, InputError
from gsut.lens.camera import Camera, camera_models
from gsut.lens.plausible import name_params

# Pixels to add where the first pixel's centre is (0, 0): gsut's is (0.5, 0.5).
FROM_ZERO = 0.5


class LensValues:
    """The keys of one lens in a parsed file.

    Args:
        values: what the parser returned.
        source: the file's name, for messages; may be empty.
        text: the file's text, to find the lines of keys in.
    """

    def __init__(self, values: dict[str, Any], source: str, text: str = "") -> None:
        self.values = values
        self.source = source
        self.text = text

    def fail(self, key: str, problem: str) -> NoReturn:
        """Raises CalibrationError for a key."""
        place = [self.source] if self.source else []
        pattern = re.compile(rf"""^[ \t{{,-]*["']?{re.escape(key)}["']?[ \t]*:""", re.MULTILINE)
        match = pattern.search(self.text)
        if match:
            key_start = match.end() - len(match.group().lstrip())
            place.append(f"line {self.text.count(chr(10), 0, key_start) + 1}")
        place.append(f"key '{key}'")
        raise CalibrationError(f"{', '.join(place)}: {problem}")

    def find(self, *keys: str) -> str | None:
        """Returns the first of these keys that is present, in upper or lower case."""
        present = {str(key).lower(): str(key) for key in self.values}
        for key in keys:
            if key in self.values:
                return key
            if key.lower() in present:
                return present[key.lower()]
        return None

    def require(self, *keys: str) -> str:
        """Returns the first of these keys that is present; fails if there is none."""
        key = self.find(*keys)
        if key is None:
            others = f" (nor {', '.join(keys[1:])})" if len(keys) > 1 else ""
            self.fail(keys[0], f"is missing{others}; add it")
        return key

    def _convert(self, key: str, value: Any) -> float:
        # YAML reads 1e-05, which has no dot, as text.
        if isinstance(value, bool) or not isinstance(value, (int, float, str)):
            self.fail(key, f"expected a number, found {_shorten(value)}")
        try:
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            self.fail(key, f"expected a finite number, found {_shorten(value)}")
        return number

    def read_number(self, key: str, default: float | None = None) -> float:
        """Reads the finite number under this key, or returns the default if the key is absent."""
        if key not in self.values and default is not None:
            return default
        return self._convert(self.require(key), self.values[self.require(key)])

    def read_pixels(self, key: str) -> int:
        """Reads the positive whole number under this key: 1080 or 1080.0."""
        return self._require_pixels(key, self.read_number(key))

    def _require_pixels(self, key: str, number: float) -> int:
        if number < 1 or number != int(number):
            self.fail(key, f"expected a positive whole number of pixels, found {number:g}")
        return int(number)

    def read_numbers(self, key: str, count: int | None = None) -> list[float]:
        """Reads the finite numbers of the list under this key, flattened, `count` of them."""
        flat = _flatten(self.values[self.require(key)])
        if flat is None:
            self.fail(key, f"expected a list of numbers, found {_shorten(self.values[key])}")
        if count is not None and len(flat) != count:
            self.fail(key, f"expected {count} numbers, found {len(flat)}")
        return [self._convert(key, value) for value in flat]

    def read_size(self, key: str) -> tuple[int, int]:
        """Reads the two positive whole numbers of the list under this key."""
        first, second = (self._require_pixels(key, v) for v in self.read_numbers(key, 2))
        return first, second

    def make_camera(
        self,
        model: str,
        params: Sequence[float],
        width: int,
        height: int,
        valid_field_angle: float | None = None,
        keys: str | Sequence[str] = "",
    ) -> Camera:
        """Makes a camera; an impossible lens is an error of the file, which names the key.

        Args:
            model, params, width, height, valid_field_angle: see `Camera`.
            keys: of each parameter in the file, or one for all; "": it has none.
        """
        prefix = f"{self.source}: " if self.source else ""
        if valid_field_angle is not None and valid_field_angle > math.pi:
            raise CalibrationError(
                f"{prefix}the valid field angle is {valid_field_angle:g} radians, and pi is the "
                f"most (degrees? write {math.radians(valid_field_angle):.6g})"
            )
        try:
            return Camera(model, params, width, height, valid_field_angle=valid_field_angle)
        except InputError as error:
            names = name_params(model, len(params)) if keys and model in camera_models() else []
            for index, name in enumerate(names):
                if re.search(rf"\b{name} is ", str(error)):  # so all of them say which
                    self.fail(keys if isinstance(keys, str) else keys[index], str(error))
            raise CalibrationError(f"{prefix}{error}") from error


def refuse_lens(program: str, camera: Camera) -> InputError:
    """Makes the error of a format that has no camera model for this lens."""
    return InputError(
        f"{program} has no camera model for '{camera.model}' with {len(camera.params)} parameters;"
        " a *.lens.json file holds every lens (a dataset: --to nerfstudio), or convert the lens to"
        " a model that it has (gsut camera convert)"
    )


def skip_to(text: str, start: str) -> str:
    """Returns the text from where `start` occurs, below as many lines as were above it."""
    place = max(text.find(start), 0)
    return "\n" * text.count("\n", 0, place) + text[place:]


def choose_name(names: Collection[str], camera_id: int | str | None, source: str) -> str:
    """Returns the name of the only camera, or `camera_id`.

    Raises:
        InputError: there are several cameras and no camera_id, or none with this one.
    """
    known = ", ".join(names)
    if camera_id is None and len(names) > 1:
        raise InputError(f"{source}: holds {len(names)} cameras; give camera_id, one of {known}")
    name = next(iter(names)) if camera_id is None else str(camera_id)
    if name not in names:
        raise InputError(f"{source}: has no camera {camera_id}; it holds {known}")
    return name


def _flatten(value: Any) -> list[Any] | None:
    """Lists the items of a nested list, or of a matrix written as a dictionary with "data"."""
    if isinstance(value, dict):
        value = value.get("data")
    if value is None or not isinstance(value, (list, tuple)):
        return None
    flat: list[Any] = []
    for item in value:
        if isinstance(item, (list, tuple)):
            flat.extend(_flatten(item) or [])
        else:
            flat.append(item)
    return flat


def _shorten(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
