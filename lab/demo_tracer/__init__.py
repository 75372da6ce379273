"""Ray-casts the demo's furnished hall, with exact truth, at any size and through any lens."""

from lab.demo_tracer.dataset import make_demo_scene
from lab.demo_tracer.rig import make_demo_rig

__all__ = [
    "make_demo_rig",
    "make_demo_scene",
]
