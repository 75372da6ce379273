"""Puts a page of one file together: markup, style, scripts, the renderer's module and data."""

from __future__ import annotations

import base64
import importlib.resources
import math
from collections.abc import Mapping, Sequence
from typing import Any

from gsut.files import format_json

# The page may load nothing: scripts, styles, pictures and workers are its own.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:; base-uri 'none'"
)
_NOTICE = (
    "<!-- Made by gsut (Apache-2.0). The module core holds code of Google Highway (Apache-2.0), "
    "Eigen (MPL-2.0), musl (MIT) and LLVM's libc++ (Apache-2.0 with LLVM exception). -->"
)
# Of every page: calls into the module, and lens files.
_SCRIPTS = ("exact/core.js", "exact/lens_files.js")


def assemble_page(markup: str, parts: Mapping[str, Any], scripts: Sequence[str]) -> str:
    """Puts a page together that needs nothing beside it.

    Args:
        markup: name of the page's HTML in this folder.
        parts: data by the id of its element: bytes are stored as base64, text as it is, other
            values as JSON. The module is a part of every page.
        scripts: names of the page's scripts, in the order in which they run.

    Returns:
        The page's text.
    """
    module = (importlib.resources.files("gsut.view") / "exact/core.wasm.gz").read_bytes()
    elements = [_store_part(name, value) for name, value in {**parts, "core": module}.items()]
    elements += [f"<script>{read_page_file(name)}</script>" for name in (*_SCRIPTS, *scripts)]
    head = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n{_NOTICE}'
    page = read_page_file(markup).replace(
        '<meta charset="utf-8">', f'<meta charset="utf-8">\n{head}'
    )
    link = '<link rel="stylesheet" href="view.css">'
    page = page.replace(link, f"<style>{read_page_file('view.css')}</style>")
    page = page.replace('<script src="view.js" defer></script>\n', "")
    return page.replace("</body>", "\n".join(elements) + "\n</body>")


def read_page_file(name: str, package: str = "gsut.view") -> str:
    """Reads one of the texts of which pages are made."""
    return (importlib.resources.files(package) / name).read_text(encoding="utf-8")


def _store_part(name: str, value: Any) -> str:
    """Returns an element that holds data, which the page reads by its id."""
    if isinstance(value, bytes):
        kind, text = "application/octet-stream", encode_part(value)
    elif isinstance(value, str):
        kind, text = "text/plain", value
    else:
        kind, text = "application/json", format_json(value).replace("</", "<\\/")
    return f'<script id="{name}" type="{kind}">{text}</script>'


def encode_part(data: bytes) -> str:
    """Encodes bytes as base64."""
    return base64.b64encode(data).decode()


def describe_lens(camera: Any) -> dict[str, Any]:
    """Describes a camera's lens as the page takes it."""
    angle = camera.valid_field_angle
    return {
        "model": camera.model, "params": list(camera.params), "width": camera.width,
        "height": camera.height,
        "valid_field_angle": angle if angle is not None and math.isfinite(angle) else None,
    }  # fmt: skip
