"""Datasets: scene and views, readers and writers of every layout, masks, splits and points.

Rooms of their own, whose doors anyone may use: `images`, `scene`, `points`, `poses`, `rigs` and
`colmap`.
"""

from gsut.data.assemble import assemble
from gsut.data.capture_file import CAPTURE, CAPTURE_FOLDER, STRIP, capture_state, read_capture
from gsut.data.convert import convert_dataset, list_writable_layouts, save_dataset
from gsut.data.errors import DatasetError, list_some
from gsut.data.layouts import KEYS as PARTS
from gsut.data.layouts import find_lens_file, find_lens_files
from gsut.data.listing import Frame
from gsut.data.load import load_dataset, read_dataset
from gsut.data.memory import scene_from_arrays
from gsut.data.scene.digests import digest_scene
from gsut.data.scene.scene import Scene, View, keep_at_most
from gsut.data.scene.split import TEST_EVERY
from gsut.data.scene.training_views import Level, TrainingViews
from gsut.data.write_nerfstudio import write_transforms

__all__ = [
    "CAPTURE",
    "CAPTURE_FOLDER",
    "PARTS",
    "STRIP",
    "TEST_EVERY",
    "DatasetError",
    "Frame",
    "Level",
    "Scene",
    "TrainingViews",
    "View",
    "assemble",
    "capture_state",
    "convert_dataset",
    "digest_scene",
    "find_lens_file",
    "find_lens_files",
    "keep_at_most",
    "list_some",
    "list_writable_layouts",
    "load_dataset",
    "read_capture",
    "read_dataset",
    "save_dataset",
    "scene_from_arrays",
    "write_transforms",
]
