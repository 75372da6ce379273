"""Surfaces: depth maps to meshes, clouds and grids; what depths and meshes are worth."""

from gsut.surface.against_truth import judge_geometry
from gsut.surface.cloud import Cloud, points_from_depth
from gsut.surface.depth_map import DepthMap
from gsut.surface.extract import MeshOptions, extract_mesh, fuse_depth, render_depth_maps
from gsut.surface.grid import Grid, check_grid_name, extract_grid, grid_from_depth, save_grid
from gsut.surface.mesh import Mesh
from gsut.surface.mesh_files import check_mesh_name, load_mesh, save_mesh
from gsut.surface.report import SurfaceView, build_geometry_tables, build_surface_page, choose_views
from gsut.surface.soup import make_soup

__all__ = [
    "Cloud",
    "DepthMap",
    "Grid",
    "Mesh",
    "MeshOptions",
    "SurfaceView",
    "build_geometry_tables",
    "build_surface_page",
    "check_grid_name",
    "check_mesh_name",
    "choose_views",
    "extract_grid",
    "extract_mesh",
    "fuse_depth",
    "grid_from_depth",
    "judge_geometry",
    "load_mesh",
    "make_soup",
    "points_from_depth",
    "render_depth_maps",
    "save_grid",
    "save_mesh",
]
