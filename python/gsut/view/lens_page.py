"""Writes the lens page as one file: a lens file dropped on it is drawn, in the browser alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gsut.files import write_file
from gsut.view.page_parts import assemble_page, describe_lens

# What a page shows that is made without a lens: a fisheye whose image circle lies in the image.
_EXAMPLE = "kannala_brandt"


def write_lens_page(path: Path, camera: Any = None, name: str = "") -> None:
    """Writes a page that draws lenses, and turns pixels into rays and points into pixels.

    Args:
        path: of the page, .html.
        camera: the lens that it shows first; None: an example.
        name: of the lens.
    """
    content = None
    if camera is not None:
        content = {"example": _EXAMPLE, "lens": {"name": name, **describe_lens(camera)}}
    write_file(path, assemble_lens_page(content))


def assemble_lens_page(content: dict[str, Any] | None = None) -> str:
    """Puts the lens page together; without `content` it starts with an example."""
    content = {"example": _EXAMPLE, "lens": None} if content is None else content
    return assemble_page("lens.html", {"content": content}, ("lens.js",))
