"""COLMAP models: their files, binary and text, read; binary ones written."""

from gsut.data.colmap.binary import read_images_bin, read_points_bin
from gsut.data.colmap.model import ColmapModel, pack_model
from gsut.data.colmap.records import ColmapImage, RigPlace
from gsut.data.colmap.rigid import hold_rigs
from gsut.data.colmap.rigs import read_frames, read_rigs
from gsut.data.colmap.text import read_images_txt, read_points_txt
