"""Rendering and projection, metrics, camera paths, pictures and videos."""

from gsut.render.ewa import PLAYCANVAS_SHRINK, EwaSplats, render_ewa, viewer_rule
from gsut.render.films import FILM_SUFFIXES, is_film, write_video
from gsut.render.light import (
    Falloff,
    Light,
    falloff_basis,
    field_angles,
    interpolated_gains,
)
from gsut.render.metrics import (
    RING_EDGES_DEGREES,
    Ring,
    color_corrected_psnr,
    half_image_psnr,
    psnr,
    ring_psnr,
    ssim,
    weighted_psnr,
)
from gsut.render.motion import place_about
from gsut.render.paths import orbit_path, smooth_path, turn_path
from gsut.render.pictures import picture_stems, to_uint8, write_png
from gsut.render.pixel_filter import PixelFilter, StoredPixelFilter, is_coarser
from gsut.render.projection import METHODS, Projection, project
from gsut.render.renderer import DEFAULT_UNSCENTED, Gradients, Render, render, render_backward
from gsut.render.surface import (
    Surface,
    render_surface,
    render_surface_backward,
    z_of_distance,
)
from gsut.render.surroundings import random_background, solid, with_surroundings
from gsut.render.tour import auto_path

__all__ = [
    "DEFAULT_UNSCENTED",
    "FILM_SUFFIXES",
    "METHODS",
    "PLAYCANVAS_SHRINK",
    "RING_EDGES_DEGREES",
    "EwaSplats",
    "Falloff",
    "Gradients",
    "Light",
    "PixelFilter",
    "Projection",
    "Render",
    "Ring",
    "StoredPixelFilter",
    "Surface",
    "auto_path",
    "color_corrected_psnr",
    "falloff_basis",
    "field_angles",
    "half_image_psnr",
    "interpolated_gains",
    "is_coarser",
    "is_film",
    "orbit_path",
    "picture_stems",
    "place_about",
    "project",
    "psnr",
    "random_background",
    "render",
    "render_backward",
    "render_ewa",
    "render_surface",
    "render_surface_backward",
    "ring_psnr",
    "smooth_path",
    "solid",
    "ssim",
    "to_uint8",
    "turn_path",
    "viewer_rule",
    "weighted_psnr",
    "with_surroundings",
    "write_png",
    "write_video",
    "z_of_distance",
]
