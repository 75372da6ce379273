"""What a camera wrote about its photographs and films: one record for each."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from gsut.lens import FocalPrior


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a picture was taken.

    Attributes:
        latitude, longitude: degrees, WGS 84.
        altitude: metres; 0 if the camera does not say.
        accuracy: metres, standard deviation on the ground that the camera states; None: it does
            not.
    """

    latitude: float
    longitude: float
    altitude: float
    accuracy: float | None = None

    def to_values(self) -> tuple[float, float, float]:
        """Returns latitude, longitude and altitude."""
        return self.latitude, self.longitude, self.altitude


@dataclasses.dataclass(frozen=True)
class PhotographFacts:
    """What is known of a photograph before it is decoded.

    Values that no camera can mean are absent, with a note.

    Attributes:
        path: the file.
        width, height: of the stored pixels.
        mode: Pillow's name of the pixel format: "RGB", "L", "I;16", "CMYK" ...
        make, model: of the camera; empty if missing.
        focal: focal length in stored pixels; None if missing.
        original: width and height when it was taken, if the camera wrote it.
        orientation: EXIF's, 1 to 8: how the stored pixels are turned.
        time: seconds, of the camera's own clock; None if missing.
        place: None if missing.
        heading: degrees clockwise from north that the lens points to; None if missing.
        up: (3,) unit vector in the camera's axes of the stored pixels, by a gimbal; None if
            missing.
        notes: what was left out and why.
    """

    path: Path
    width: int
    height: int
    mode: str
    make: str = ""
    model: str = ""
    focal: FocalPrior | None = None
    original: tuple[int, int] | None = None
    orientation: int = 1
    time: float | None = None
    place: Place | None = None
    heading: float | None = None
    up: tuple[float, float, float] | None = None
    notes: tuple[str, ...] = ()

    @property
    def camera(self) -> str:
        """The make and model, without repeating the make."""
        make = self.make.split(" ")[0]
        return self.model if self.model.startswith(make) else f"{make} {self.model}".strip()


@dataclasses.dataclass(frozen=True)
class TurnRecord:
    """How a camera, or the picture that it stabilised, turned during a film.

    Attributes:
        source: "gyroscope" or "orientations".
        rates: (N, 4) seconds since the beginning, and rad/s in the axes of the frames shown, as far
            as the file names them; each row holds until the next one; NaN: not recorded until then.
    """

    source: str
    rates: np.ndarray


@dataclasses.dataclass(frozen=True)
class FilmFacts:
    """What is known of a film beside its frames.

    Attributes:
        camera: name for `find_lenses`; empty if missing.
        rotation: degrees clockwise, 0, 90, 180 or 270, by which stored frames are turned to be
            shown.
        track: (N, 4) seconds since the beginning, latitude and longitude in degrees, altitude in
            metres.
        forces: (M, 4) seconds, and what the accelerometer felt in m/s^2 in the camera's axes of
            the frames shown: gravity's reaction, which points up, and its own acceleration.
        is_askew: whether these are in the gyroscope's axes, which the file does not name.
        turns: records of how it turned.
        notes: what could not be read.
    """

    camera: str = ""
    rotation: int = 0
    track: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    forces: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 4)))
    is_askew: bool = False
    turns: tuple[TurnRecord, ...] = ()
    notes: tuple[str, ...] = ()
