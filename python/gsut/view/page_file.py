"""Writes the viewer's page as one file that holds the scene, photographs and the renderer."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gsut._core import CameraMotion
from gsut.files import write_file
from gsut.formats import WriteSettings, prepare_for_file, save_gaussians
from gsut.view.page_parts import assemble_page, describe_lens, encode_part, read_page_file
from gsut.view.stage import Stage

# Longer side in pixels of the photographs in the page.
_PHOTO_SIDE = 800
# What the page can show by itself.
_MODES = ("color", "distance", "alpha", "error")
# Colours that the page maps distances and errors to, as the viewer does.
_COLOR_MAPS = ("turbo", "inferno")


def write_page(path: Path, session: Any, photographs: int, sh_degree: int = 3) -> Any:
    """Writes a page that shows a stage by gsut's own renderer, without a server.

    Args:
        path: of the page, .html.
        session: a `Session` of a stage with Gaussians.
        photographs: how many held-out photographs it carries at most; the others are left out.
        sh_degree: harmonics above it are left out.

    Returns:
        What became of the Gaussians, which the page holds as SPZ.
    """
    stage = session.stage
    whole = session.frames.load_all()
    if whole.sh_degree > sh_degree:
        whole = dataclasses.replace(whole, sh=whole.sh[:, : (sh_degree + 1) ** 2])
    with TemporaryDirectory(prefix="gsut-") as folder:
        scene = Path(folder) / "scene.spz"
        written = save_gaussians(scene, whole, WriteSettings(antialiased=stage.antialiased))
        packed = scene.read_bytes()
    content = _describe(session, _choose_photographs(stage, photographs))
    content["origin"] = prepare_for_file(whole).origin
    write_file(path, assemble_scene_page(content, packed))
    return written


def assemble_scene_page(content: dict[str, Any], packed: bytes) -> str:
    """Puts the viewer's page together around a scene.

    Args:
        content: what the page's server answers from.
        packed: the Gaussians as SPZ.
    """
    # Workers run a script of the page again, and one of their own.
    parts = {
        "content": content, "scene": packed, "core-code": read_page_file("exact/core.js"),
        "worker-code": read_page_file("exact/worker.js"),
        "shaders": read_page_file("forward.wgsl", "gsut.render"),
    }  # fmt: skip
    return assemble_page("view.html", parts, ("exact/card.js", "exact/page_server.js", "view.js"))


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
        {**describe_lens(camera), "turns": shown["turns"]}
        for camera, shown in zip(stage.cameras, scene.pop("lenses"), strict=True)
    ]
    del scene["models"]
    photographs, motions = [], []
    for row in rows:
        sent = session.send_photograph({"view": row, "side": _PHOTO_SIDE})
        photographs.append("data:image/jpeg;base64," + encode_part(sent.content))
        motions.append(None if stage.scene is None else _describe_motion(stage.scene.views[row]))
    return {
        "scene": scene, "lenses": lenses, "photographs": photographs, "motions": motions,
        "background": stage.background,
        "offset": np.zeros(3) if stage.scene is None else stage.scene.world_offset,
        "colors": {name: _sample_colors(name) for name in _COLOR_MAPS},
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
