"""Surfaces: depth maps to meshes, clouds and grids; what depths and meshes are worth."""

from gsut.surface.against_truth import KINDS, cast_depth, geometry_figures
from gsut.surface.cloud import Cloud, depth_points
from gsut.surface.extract import DepthMap, MeshOptions, depth_maps, extract_mesh, fuse_depth
from gsut.surface.grid import Grid, check_grid_name, extract_grid, grid_of_depth, save_grid
from gsut.surface.mesh import Mesh
from gsut.surface.mesh_files import check_mesh_name, load_mesh, save_mesh
from gsut.surface.report import SurfaceView, geometry_tables, shown_views, surface_page
from gsut.surface.shading import shaded_picture
from gsut.surface.worth import depth_figures, mesh_figures, tree_of

__all__ = [
    "KINDS",
    "Cloud",
    "DepthMap",
    "Grid",
    "Mesh",
    "MeshOptions",
    "SurfaceView",
    "cast_depth",
    "check_grid_name",
    "check_mesh_name",
    "depth_figures",
    "depth_maps",
    "depth_points",
    "extract_grid",
    "extract_mesh",
    "fuse_depth",
    "geometry_figures",
    "geometry_tables",
    "grid_of_depth",
    "load_mesh",
    "mesh_figures",
    "save_grid",
    "save_mesh",
    "shaded_picture",
    "shown_views",
    "surface_page",
    "tree_of",
]
