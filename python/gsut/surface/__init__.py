"""Surfaces: depth maps to a mesh, mesh files, what depths and meshes are worth against a truth."""

from gsut.surface.extract import DepthMap, MeshOptions, extract_mesh, fuse_depth
from gsut.surface.mesh import Mesh
from gsut.surface.mesh_files import check_mesh_name, load_mesh, save_mesh

__all__ = [
    "DepthMap",
    "Mesh",
    "MeshOptions",
    "check_mesh_name",
    "extract_mesh",
    "fuse_depth",
    "load_mesh",
    "save_mesh",
]
