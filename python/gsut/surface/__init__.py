"""Surfaces: depth maps to a mesh, mesh files, what depths and meshes are worth against a truth."""

from gsut.surface.against_truth import KINDS, cast_depth, geometry_figures
from gsut.surface.extract import DepthMap, MeshOptions, extract_mesh, fuse_depth
from gsut.surface.mesh import Mesh
from gsut.surface.mesh_files import check_mesh_name, load_mesh, save_mesh
from gsut.surface.worth import depth_figures, mesh_figures, tree_of

__all__ = [
    "KINDS",
    "DepthMap",
    "Mesh",
    "MeshOptions",
    "cast_depth",
    "check_mesh_name",
    "depth_figures",
    "extract_mesh",
    "fuse_depth",
    "geometry_figures",
    "load_mesh",
    "mesh_figures",
    "save_mesh",
    "tree_of",
]
