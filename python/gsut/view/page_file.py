"""Writes the viewer's page as one file that holds the scene, photographs and the renderer."""

from __future__ import annotations

import base64
import gzip
import html
import math
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urljoin

import numpy as np

from gsut._core import CameraMotion
from gsut.files import (
    format_json,
    read_bytes,
    read_package_file,
    unpack_gzip,
    write_file,
)
from gsut.formats import WriteSettings, prepare_for_file, save_gaussians
from gsut.gaussians import order_by_morton_code
from gsut.orientation import turn_size
from gsut.sampling import choose_evenly
from gsut.view.named_views import NamedView
from gsut.view.stage import Stage

# Longer side in pixels of the photographs in the page.
_PHOTO_SIDE = 800
# Longer side in pixels of the picture that programs show beside a link to the page.
_PREVIEW_SIDE = 1200
# What the page can show by itself.
_MODES = ("color", "distance")
# The page's scripts, in the order in which they run.
_SCRIPTS = (
    "exact/core.js", "exact/moving.js", "exact/page_server.js", "select.js", "view.js",
)  # fmt: skip
# Texts that these hand on: workers run scripts of their own, a graphics card runs shaders.
_TEXTS = ("exact/worker.js", "exact/order.js", "exact/moving.glsl")
# Bytes of a scene or a program: an array of a browser holds no more.
_MOST_BYTES = 1 << 31
# Bytes of the header of an SPZ.
_HEADER = 16
# First bytes of a scene whose positions are packed.
_PACKED = b"GPAG"
# Step of a position, of a small standard deviation of the Gaussians: 2 % of it by rms.
_STEP_SHARE = 1 / 16
# Percentile of the Gaussians' smallest standard deviations that counts as a small one.
_FEW_PERCENT = 5.0
# The page may load nothing: scripts, styles, pictures and workers are its own.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:; base-uri 'none'"
)
_NOTICE = (
    "<!-- Made by gsut (Apache-2.0). The module core holds code of Google Highway (Apache-2.0), "
    "Eigen (MPL-2.0), musl (MIT) and LLVM's libc++ (Apache-2.0 with LLVM exception). -->"
)


def write_page(
    path: Path, session: Any, photographs: int, views: Sequence[NamedView] = (),
    title: str | None = None, address: str | None = None, credit: str | None = None,
) -> Any:  # fmt: skip
    """Writes a page that shows a stage by gsut's own renderer, without a server.

    Args:
        path: of the page, .html.
        session: a `Session` of a stage with Gaussians.
        photographs: how many held-out photographs at most; the others are left out.
        views: to choose from; the page starts at the first.
        title: of the page; the stage's name if None.
        address: where the page will be published; programs that show links then find a picture,
            which is written beside the page as .jpg.
        credit: who made the scene.

    Returns:
        What became of the Gaussians, which the page holds as SPZ does.
    """
    stage = session.stage
    whole = session.shown.load_all()
    if len(whole):  # neighbours differ little, which packs well
        whole = whole[order_by_morton_code(whole.means)]
    with TemporaryDirectory(prefix="gsut-") as folder:
        scene = Path(folder) / "scene.spz"
        written = save_gaussians(scene, whole, WriteSettings(antialiased=stage.antialiased))
        packed = _pack_scene(unpack_gzip(read_bytes(scene), scene, _MOST_BYTES))
    content = _describe(session, _choose_photographs(stage, photographs))
    content["origin"] = prepare_for_file(whole).origin
    if title is not None:
        content["scene"]["name"] = title
    content["scene"]["credit"] = credit
    content["scene"]["presets"] = [_add_view(view, stage, content) for view in views]
    if address is not None:
        write_file(path.with_suffix(".jpg"), _draw_preview(session, views))
    write_file(path, _assemble(content, packed, _describe_link(path, content["scene"], address)))
    return written


def _add_view(view: NamedView, stage: Stage, content: dict[str, Any]) -> dict[str, Any]:
    """Describes a view by its lens' number; a lens that the page lacks is added to it."""
    cameras = list(stage.cameras)
    lens = cameras.index(view.camera) if view.camera in cameras else len(content["lenses"])
    if lens == len(content["lenses"]):
        content["lenses"].append({**_describe_lens(view.camera), "turns": view.turns})
    poses = [pose.ravel() for pose in view.poses]
    return {"name": view.name, "lens": lens, "turns": view.turns, "poses": poses}


def _draw_preview(session: Any, views: Sequence[NamedView]) -> bytes:
    """Draws the page's first view as JPEG."""
    stage = session.stage
    camera, pose, turns = stage.cameras[0], stage.place()["pose"], 0
    if views:
        camera, pose, turns = views[0].camera, views[0].poses[0], views[0].turns
    width, height = turn_size(camera.width, camera.height, turns)
    shrink = _PREVIEW_SIDE / max(width, height)
    wanted = {
        "pose": np.ravel(pose), "lens": session.lenses.add(camera), "turns": turns,
        "width": round(shrink * width), "height": round(shrink * height),
    }  # fmt: skip
    return bytes(session.draw_frame(wanted).content)


def _describe_link(path: Path, scene: dict[str, Any], address: str | None) -> str:
    """Describes the page to programs that show a link to it (Open Graph)."""
    values = {
        "title": scene["name"], "type": "website",
        "description": f"A scene of {scene['num_gaussians']:,} Gaussians to walk through",
    }  # fmt: skip
    if scene["credit"] is not None:
        values["description"] += f" · {scene['credit']}"
    if address is not None:
        picture = urljoin(address, path.with_suffix(".jpg").name)
        values |= {"url": address, "image": picture}
    rows = (
        f'<meta property="og:{key}" content="{html.escape(str(value))}">'
        for key, value in values.items()
    )
    return "\n".join(rows)


def _assemble(content: dict[str, Any], scene: bytes, link: str) -> str:
    """Puts the page together: markup, style, scripts, the renderer's module, and the scene.

    Args:
        content: what the page's server answers from.
        scene: the Gaussians, see `_pack_scene`.
        link: elements of the head, see `_describe_link`.
    """
    name = "exact/core.wasm.gz"
    core = unpack_gzip(read_package_file("gsut.view", name), name, _MOST_BYTES)
    texts = {name: _read_text(name) for name in (*_SCRIPTS, *_TEXTS)} | {"scripts": _SCRIPTS}
    elements = [
        _embed("content", "application/octet-stream", _encode(format_json(content).encode())),
        _embed("scene", "application/octet-stream", _encode(scene)),
        _embed("core", "application/octet-stream", _encode(core)),
        _embed("texts", "application/octet-stream", _encode(format_json(texts).encode())),
        f"<script>{_read_text('exact/loader.js')}</script>",
    ]
    page = _read_text("view.html")
    for old, new in (
        ("<meta charset=\"utf-8\">",
         f'<meta charset="utf-8">\n<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
         f"\n{_NOTICE}\n{link}"),
        ("<title>gsut view</title>", f"<title>{html.escape(content['scene']['name'])}</title>"),
        ('<link rel="stylesheet" href="view.css">', f"<style>{_read_text('view.css')}</style>"),
        ('<script src="select.js" defer></script>\n<script src="view.js" defer></script>\n', ""),
        ("</body>", "\n".join(elements) + "\n</body>"),
    ):  # fmt: skip
        page = page.replace(old, new)
    return page


def _pack_scene(spz: bytes) -> bytes:
    """Packs an SPZ so that it compresses well: positions, scales and rotations byte by byte.

    Positions are rounded to a step that Gaussians do not notice, and each is stored by its
    difference to the one before, lowest bytes first.
    """
    data = np.frombuffer(spz, np.uint8)
    size = int.from_bytes(spz[8:12], "little")
    wide = np.zeros((3 * size, 4), np.uint8)
    wide[:, 1:] = data[_HEADER : _HEADER + 9 * size].reshape(-1, 3)
    places = (wide.view("<i4")[:, 0] >> 8).reshape(size, 3)
    scales = data[_HEADER + 13 * size : _HEADER + 16 * size].reshape(size, 3)  # as SPZ stores them
    bits = int(spz[13])
    if size:
        smallest = np.exp(np.percentile(scales.min(axis=1), _FEW_PERCENT) / 16 - 10)
        drop = max(0, min(bits, math.floor(math.log2(smallest * _STEP_SHARE) + bits)))
        places, bits = (places + (1 << drop >> 1)) >> drop, bits - drop
    steps = np.diff(places, axis=0, prepend=0)
    words = np.ascontiguousarray(((steps << 1) ^ (steps >> 31)).astype("<u4").T)
    planes = words.view(np.uint8).reshape(3, size, 4)[..., :3].transpose(0, 2, 1)
    header = _PACKED + spz[4:13] + bytes([bits]) + spz[14:_HEADER]
    rotations = data[_HEADER + 16 * size : _HEADER + 20 * size].reshape(size, 4)
    between, rest = spz[_HEADER + 9 * size : _HEADER + 13 * size], spz[_HEADER + 20 * size :]
    return b"".join(
        (header, planes.tobytes(), between, scales.T.tobytes(), rotations.T.tobytes(), rest)
    )


def _encode(data: bytes) -> str:
    """Compresses bytes and writes them as text."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()


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
    return choose_evenly(stage.scene.test_indices or range(len(stage.scene)), most)


def _describe(session: Any, rows: list[int]) -> dict[str, Any]:
    """Describes the scene as the viewer's server does, with these photographs alone."""
    stage = session.stage
    scene = dict(session.describe_scene({}).content)
    scene |= {
        "alone": True, "modes": _MODES, "num_points": 0, "live": False, "kind": "file",
        "selectable": False, "views": [scene["views"][row] for row in rows],
    }  # fmt: skip
    lenses = [
        {**_describe_lens(camera), "turns": shown["turns"]}
        for camera, shown in zip(stage.cameras, scene.pop("lenses"), strict=True)
    ]
    del scene["models"]
    photographs, motions = [], []
    for row in rows:
        sent = session.send_photograph({"view": row, "side": _PHOTO_SIDE, "kind": "webp"})
        photographs.append("data:image/webp;base64," + base64.b64encode(sent.content).decode())
        motions.append(None if stage.scene is None else _describe_motion(stage.scene.views[row]))
    return {
        "scene": scene, "lenses": lenses, "photographs": photographs, "motions": motions,
        "background": stage.background,
        "offset": np.zeros(3) if stage.scene is None else stage.scene.world_offset,
        "colors": _sample_colors(),
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


def _sample_colors() -> list[int]:
    """Samples the colour map of distances at 256 steps, red, green, blue, as the viewer has it."""
    import cv2

    steps = np.arange(256, dtype=np.uint8)[:, None]
    mapped = cv2.applyColorMap(steps, cv2.COLORMAP_TURBO)
    return [int(value) for value in mapped[:, 0, ::-1].ravel()]
