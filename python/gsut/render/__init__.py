"""Rendering and projection, camera paths, pictures and videos."""

from gsut.render.confidence import Confidence, find_depth_sigma
from gsut.render.films import is_film, write_video
from gsut.render.light import (
    Falloff,
    Light,
    compute_field_angles,
)
from gsut.render.motion import place_about
from gsut.render.paths import make_orbit_path, smooth_path, turn_path
from gsut.render.pictures import name_pictures, to_uint8, write_png
from gsut.render.pixel_filter import PixelFilter
from gsut.render.projection import METHODS, Projection, project
from gsut.render.renderer import DEFAULT_UNSCENTED, Gradients, Render, render, render_backward
from gsut.render.surface import (
    Surface,
    measure_depth,
    render_surface,
    render_surface_backward,
    z_from_distance,
)
from gsut.render.surroundings import choose_solid, with_surroundings
from gsut.render.tour import make_tour_path

__all__ = [
    "DEFAULT_UNSCENTED",
    "METHODS",
    "Confidence",
    "Falloff",
    "Gradients",
    "Light",
    "PixelFilter",
    "Projection",
    "Render",
    "Surface",
    "choose_solid",
    "compute_field_angles",
    "find_depth_sigma",
    "is_film",
    "make_orbit_path",
    "make_tour_path",
    "measure_depth",
    "name_pictures",
    "place_about",
    "project",
    "render",
    "render_backward",
    "render_surface",
    "render_surface_backward",
    "smooth_path",
    "to_uint8",
    "turn_path",
    "with_surroundings",
    "write_png",
    "write_video",
    "z_from_distance",
]
