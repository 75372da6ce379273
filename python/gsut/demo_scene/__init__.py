"""The demo's data set: a furnished hall with known geometry, ray-cast through a fisheye lens."""

from gsut.demo_scene.dataset import make_demo_scene

__all__ = ["make_demo_scene"]
