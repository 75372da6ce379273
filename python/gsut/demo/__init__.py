"""The demo's data set: a furnished hall with known geometry, ray-cast through a fisheye lens."""

from gsut.demo.dataset import make_demo_scene
from gsut.demo.rig import make_demo_rig

__all__ = [
    "make_demo_rig",
    "make_demo_scene",
]
