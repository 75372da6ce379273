"""Surfaces: depth maps to meshes and clouds; what depths and meshes are worth."""

from gsut.surface.against_truth import judge_geometry
from gsut.surface.cloud import Cloud, points_from_depth
from gsut.surface.depth_map import DepthMap
from gsut.surface.extract import MeshOptions, extract_mesh, fuse_depth, render_depth_maps
from gsut.surface.mesh import Mesh
from gsut.surface.mesh_files import check_mesh_name, load_mesh, save_mesh
