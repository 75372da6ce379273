"""The demo's data set: a furnished hall with known geometry, ray-cast through a fisheye lens."""

from gsut.demo_scene.dataset import make_demo_scene
from gsut.demo_scene.rig import make_demo_rig

__all__ = ["make_demo_rig", "make_demo_scene"]
