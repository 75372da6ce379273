"""Rendering and projection, camera paths, pictures and videos."""

from gsut.render.confidence import Confidence
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
