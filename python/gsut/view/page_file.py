"""Writes the viewer's page as one file that holds the scene, photographs and the renderer."""

from __future__ import annotations

import base64
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gsut._core import CameraMotion
from gsut.files import read_bytes, read_package_file, write_file
from gsut.formats import WriteSettings, prepare_for_file, save_gaussians
from gsut.page import embed_json
from gsut.view.stage import Stage

# Longer side in pixels of the photographs in the page.
_PHOTO_SIDE = 800
# What the page can show by itself.
_MODES = ("color", "distance", "alpha", "error")
# Colours that the page maps distances and errors to, as the viewer does.
_COLOR_MAPS = ("turbo", "inferno")
# The page's scripts, in the order in which they run.
_SCRIPTS = (
    "exact/core.js", "exact/card.js", "exact/moving.js", "exact/page_server.js", "view.js",
)  # fmt: skip
# Texts that the page hands on, by the id of their element: workers run a script of the page again
# and one of their own, a graphics card runs the shaders.
_TEXTS = {
    "core-code": "exact/core.js", "worker-code": "exact/worker.js",
    "shaders": "exact/forward.wgsl", "moving-shader": "exact/moving.glsl",
    "order-code": "exact/order.js",
}  # fmt: skip
# The page may load nothing: scripts, styles, pictures and workers are its own.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:; base-uri 'none'"
)
_NOTICE = (
    "<!-- Made by gsut (Apache-2.0). The module core holds code of Google Highway (Apache-2.0), "
    "Eigen (MPL-2.0), musl (MIT) and LLVM's libc++ (Apache-2.0 with LLVM exception). -->"
)


def write_page(path: Path, session: Any, photographs: int) -> Any:
    """Writes a page that shows a stage by gsut's own renderer, without a server.

    Args:
        path: of the page, .html.
        session: a `Session` of a stage with Gaussians.
        photographs: how many held-out photographs it carries at most; the others are left out.

    Returns:
        What became of the Gaussians, which the page holds as SPZ.
    """
    stage = session.stage
    whole = session.shown.load_all()
    with TemporaryDirectory(prefix="gsut-") as folder:
        scene = Path(folder) / "scene.spz"
        written = save_gaussians(scene, whole, WriteSettings(antialiased=stage.antialiased))
        packed = read_bytes(scene)
    content = _describe(session, _choose_photographs(stage, photographs))
    content["origin"] = prepare_for_file(whole).origin
    write_file(path, _assemble(content, packed))
    return written


def _assemble(content: dict[str, Any], scene: bytes) -> str:
    """Puts the page together: markup, style, scripts, the renderer's module, and the scene.

    Args:
        content: what the page's server answers from.
        scene: the Gaussians as SPZ.
    """
    core = read_package_file("gsut.view", "exact/core.wasm.gz")
    elements = [
        _embed("content", "application/json", embed_json(content)),
        _embed("scene", "application/octet-stream", base64.b64encode(scene).decode()),
        _embed("core", "application/octet-stream", base64.b64encode(core).decode()),
        *(_embed(key, "text/plain", _read_text(name)) for key, name in _TEXTS.items()),
        *(f"<script>{_read_text(name)}</script>" for name in _SCRIPTS),
    ]
    page = _read_text("view.html")
    for old, new in (
        ("<meta charset=\"utf-8\">",
         f'<meta charset="utf-8">\n<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
         f"\n{_NOTICE}"),
        ('<link rel="stylesheet" href="view.css">', f"<style>{_read_text('view.css')}</style>"),
        ('<script src="view.js" defer></script>\n', ""),
        ("</body>", "\n".join(elements) + "\n</body>"),
    ):  # fmt: skip
        page = page.replace(old, new)
    return page


def _embed(name: str, kind: str, text: str) -> str:
    """Returns an element that holds data, which the page reads by its id."""
    return f'<script id="{name}" type="{kind}">{text}</script>'


def _read_text(name: str) -> str:
    """Reads one of the texts of which the page is made."""
    return read_package_file("gsut.view", name).decode()


def _choose_photographs(stage: Stage, most: int) -> list[int]:
    """Chooses evenly among the held-out photographs; among all where none is held out."""
    if stage.scene is None or most < 1:
        return []
    rows = list(stage.scene.test_indices or range(len(stage.scene)))
    places = np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int)
    return [rows[place] for place in places]


def _describe(session: Any, rows: list[int]) -> dict[str, Any]:
    """Describes the scene as the viewer's server does, with these photographs alone."""
    stage = session.stage
    scene = dict(session.describe_scene({}).content)
    scene |= {
        "alone": True, "modes": _MODES, "folder": None, "num_points": 0, "live": False,
        "kind": "file", "views": [scene["views"][row] for row in rows],
    }  # fmt: skip
    lenses = [
        {**_describe_lens(camera), "turns": shown["turns"]}
        for camera, shown in zip(stage.cameras, scene.pop("lenses"), strict=True)
    ]
    del scene["models"]
    photographs, motions = [], []
    for row in rows:
        sent = session.send_photograph({"view": row, "side": _PHOTO_SIDE})
        photographs.append("data:image/jpeg;base64," + base64.b64encode(sent.content).decode())
        motions.append(None if stage.scene is None else _describe_motion(stage.scene.views[row]))
    return {
        "scene": scene, "lenses": lenses, "photographs": photographs, "motions": motions,
        "background": stage.background,
        "offset": np.zeros(3) if stage.scene is None else stage.scene.world_offset,
        "colors": {name: _sample_colors(name) for name in _COLOR_MAPS},
    }  # fmt: skip


def _describe_lens(camera: Any) -> dict[str, Any]:
    """Describes a camera's lens as the page takes it."""
    angle = camera.valid_field_angle
    return {
        "model": camera.model, "params": list(camera.params), "width": camera.width,
        "height": camera.height,
        "valid_field_angle": angle if angle is not None and math.isfinite(angle) else None,
    }  # fmt: skip


def _describe_motion(view: Any) -> dict[str, Any] | None:
    motion = view.motion
    if not isinstance(motion, CameraMotion):
        return None
    return {
        "pose": np.ravel(view.camera_from_world), "start": np.ravel(motion.start),
        "end": np.ravel(motion.end), "direction": motion.shutter.direction,
    }  # fmt: skip


def _sample_colors(name: str) -> list[int]:
    """Samples a colour map at 256 steps, red, green, blue."""
    import cv2

    steps = np.arange(256, dtype=np.uint8)[:, None]
    mapped = cv2.applyColorMap(steps, getattr(cv2, f"COLORMAP_{name.upper()}"))
    return [int(value) for value in mapped[:, 0, ::-1].ravel()]
