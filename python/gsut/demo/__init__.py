"""The demo's scenes: a furnished hall with exact truth, as pictures that come with gsut."""

from gsut.demo.scenes import write_demo_scene
