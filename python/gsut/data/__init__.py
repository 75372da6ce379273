"""Datasets: scene and views, readers and writers of every layout, masks, splits and points.

Rooms of their own, whose doors anyone may use: `images`, `scene`, `points`, `poses`, `rigs` and
`colmap`.
"""

from gsut.data.assemble import assemble
from gsut.data.capture_file import CAPTURE, CAPTURE_FOLDER, STRIP, read_capture
from gsut.data.convert import convert_dataset, list_writable_layouts, save_dataset
from gsut.data.errors import DatasetError, list_some
from gsut.data.layouts import find_lens_file, find_lens_files
from gsut.data.listing import Frame
from gsut.data.load import load_dataset, read_dataset
from gsut.data.memory import scene_from_arrays
from gsut.data.scene import Scene, View
from gsut.data.write_nerfstudio import write_transforms
