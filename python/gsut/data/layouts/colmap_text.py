"""COLMAP's layout with a model as text: `colmap` reads it, this writes it."""

from __future__ import annotations

from gsut.data.layouts._layout import Layout
from gsut.data.layouts.colmap import write_colmap_text

LAYOUT = Layout(
    "colmap-text", "see colmap", rank=41, holds=lambda path: False, write=write_colmap_text
)
