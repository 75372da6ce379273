"""Dataset readers, one file a format; `load_dataset` finds out which one it is."""

from gsut.data.findings import DatasetError, Finding
from gsut.data.load import load_dataset
from gsut.data.scene import Scene, View

__all__ = ["DatasetError", "Finding", "Scene", "View", "load_dataset"]
