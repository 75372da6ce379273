"""Draws lenses: of real cameras, fisheyes, phones, and the distorted ones between."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from gsut.lens import Camera
from gsut.lens.database import load_profiles

_LEAST_FIELD = 20.0  # degrees, of lenses of the database that are drawn
_MOST_PROFILE_FIELD = 175.0


@dataclasses.dataclass(frozen=True)
class DrawnLens:
    """A lens with its origin.

    Attributes:
        camera: for the pictures.
        kind: "database", "fisheye", "phone" or "distorted".
        name: of the database's camera; empty for others.
        maker: of the database's camera; empty for others.
        focal_35mm: what EXIF of such a camera says; None: a fisheye has none.
    """

    camera: Camera
    kind: str
    name: str = ""
    maker: str = ""
    focal_35mm: float | None = None

    @functools.cached_property
    def field(self) -> float:
        """Horizontal field of view, radians."""
        height, width = self.camera.height, self.camera.width
        edge = np.array([[0.5, height / 2], [width - 0.5, height / 2]])
        rays, valid = self.camera.unproject(edge)
        if not valid.all():
            return 2 * float(self.camera.valid_field_angle or math.pi / 2)
        return math.acos(float(np.clip(rays[0] @ rays[1], -1, 1)))


def _draw_database(rng: np.random.Generator, pixels: float) -> DrawnLens:
    profiles = load_profiles()
    while True:  # one in ten is doubted
        profile = profiles[rng.integers(len(profiles))]
        shape = profile.width / profile.height
        if profile.doubts or not 1 / 3 < shape < 3:
            continue
        if not _LEAST_FIELD < (profile.fov_degrees or 0.0) < _MOST_PROFILE_FIELD:
            continue
        width, height = _fit_size(shape, pixels)
        camera = profile.make_camera(width, height)
        corners = np.array([[0.5, 0.5], [width - 0.5, 0.5], [0.5, height - 0.5],
                            [width - 0.5, height - 0.5]])  # fmt: skip
        if not camera.unproject(corners)[1].all():
            continue
        focal = profile.params[0] / max(profile.width, profile.height) * 36
        return DrawnLens(camera, "database", profile.name, profile.brand, focal)


def _draw_fisheye(rng: np.random.Generator, pixels: float) -> DrawnLens:
    side = _fit_size(1.0, pixels)[0]
    angle = math.radians(rng.uniform(60, 110))
    k = rng.normal(0, [0.03, 0.01, 0.003, 0.001]) * (math.pi / 2 / angle) ** np.array([2, 4, 6, 8])
    radius = angle * (1 + k @ angle ** np.array([2, 4, 6, 8]))
    focal = rng.uniform(0.47, 0.62) * side / radius
    centre = side / 2 + rng.normal(0, 0.01 * side, 2)
    params = [focal, focal * (1 + rng.normal(0, 0.001)), *centre, *k]
    camera = Camera("kannala_brandt", params, side, side, valid_field_angle=angle)
    return DrawnLens(camera, "fisheye")


def _draw_phone(rng: np.random.Generator, pixels: float) -> DrawnLens:
    shape = float(rng.choice([4 / 3, 16 / 9, 3 / 4, 9 / 16]))
    width, height = _fit_size(shape, pixels)
    field = math.radians(rng.uniform(45, 85))  # along the longer side
    focal = max(width, height) / 2 / math.tan(field / 2)
    centre = np.array([width, height]) * (0.5 + rng.normal(0, 0.005, 2))
    k1 = rng.normal(0.03, 0.03)
    params = [focal, focal, *centre, k1, -1.5 * k1 + rng.normal(0, 0.02), *rng.normal(0, 3e-4, 2)]
    camera = Camera("opencv4", params, width, height)
    return DrawnLens(camera, "phone", focal_35mm=focal / max(width, height) * 36)


def _draw_distorted(rng: np.random.Generator, pixels: float) -> DrawnLens:
    width, height = _fit_size(float(rng.choice([4 / 3, 16 / 9])), pixels)
    field = math.radians(rng.uniform(80, 160))
    centre = np.array([width, height]) * (0.5 + rng.normal(0, 0.01, 2))
    alpha, xi = rng.uniform(0.5, 0.7), rng.uniform(-0.3, 0.1)
    camera = Camera("double_sphere", [100.0, 100.0, *centre, xi, alpha], width, height)
    at = camera.project(np.array([[math.sin(field / 2), 0, math.cos(field / 2)]]))[0][0, 0]
    focal = 100.0 * (width / 2) / (at - centre[0])
    params = [focal, focal, *centre, xi, alpha]
    return DrawnLens(Camera("double_sphere", params, width, height), "distorted")


def _fit_size(shape: float, pixels: float) -> tuple[int, int]:
    """Returns even width and height of this shape and about this number of pixels."""
    width = 2 * round(math.sqrt(pixels * shape) / 2)
    return width, 2 * round(width / shape / 2)


def draw_lens(rng: np.random.Generator, pixels: float) -> DrawnLens:
    """Draws a lens for pictures of about this number of pixels."""
    kinds = (_draw_database, _draw_fisheye, _draw_phone, _draw_distorted)
    return kinds[rng.choice(4, p=[0.40, 0.25, 0.25, 0.10])](rng, pixels)


def draw_other_name(rng: np.random.Generator, maker: str) -> str:
    """Draws the name of a camera of another maker."""
    profiles = load_profiles()
    while True:
        profile = profiles[rng.integers(len(profiles))]
        if profile.brand != maker and not profile.doubts:
            return profile.name
