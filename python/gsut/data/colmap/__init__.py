"""COLMAP models: their files, binary and text, read and written."""

from gsut.data.colmap.model import ColmapModel, format_model_binaries, format_model_texts
from gsut.data.colmap.read import read_images, read_points
from gsut.data.colmap.records import ColmapImage, RigPlace
from gsut.data.colmap.rigid import hold_rigs
from gsut.data.colmap.rigs import read_frames, read_rigs
