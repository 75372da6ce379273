"""One page that shows a scene by a double click, offline: the SuperSplat viewer around a SOG file.

The viewer (folder supersplat/) is PlayCanvas' @playcanvas/supersplat-viewer 1.36.2, minified by
esbuild into one script; MIT, its licence stands in the page and beside it.
"""

from __future__ import annotations

import base64
import gzip
import importlib.resources
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gsut.files import write_file
from gsut.formats import sog
from gsut.formats._format import Format, StartView, WriteSettings, Written
from gsut.gaussians import Gaussians, rotate_upright, transform_gaussians

_UP = np.array([0.0, -1.0, 0.0])  # of a file, as viewers take it
_HALF_TURN = np.array([-1.0, -1.0, 1.0])  # from a file's axes to the viewer's, where y is up
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1.0, viewport-fit=cover">
<meta name="generator" content="gsut">
<title>{title}</title>
<!--
Viewer: @playcanvas/supersplat-viewer 1.36.2
{license}-->
<style>{style} html, body {{ height: 100%; margin: 0; overflow: hidden; background: #000; }}</style>
</head>
<body>
<script>{viewer}</script>
<script id="scene" type="application/octet-stream;base64">{scene}</script>
<script>
const element = document.getElementById("scene");
const bytes = Uint8Array.from(atob(element.textContent), (letter) => letter.charCodeAt(0));
element.remove();
const asked = new URL(location.href).searchParams;
SuperSplat.createViewer({{
  container: document.body,
  settings: {settings},
  contentUrl: "scene.sog",
  contentFilename: "scene.sog",
  contents: Promise.resolve(new Response(bytes)),
  renderer: asked.has("webgl") ? "webgl" : "webgpu",
  ui: !asked.has("noui"),
  noanim: true,
  aa: {antialiased},
  exposeGlobals: true,
}});
</script>
</body>
</html>
"""


def _write(path: Path, gaussians: Gaussians, settings: WriteSettings) -> Written:
    view = settings.view
    if view is not None:
        gaussians = transform_gaussians(gaussians, rotate_upright(view.up))
    with TemporaryDirectory(prefix="gsut-") as folder:
        content = Path(folder) / "scene.sog"
        written = sog.FORMAT.write(content, gaussians, settings)
        scene = base64.b64encode(content.read_bytes()).decode()
    parts = importlib.resources.files(__package__) / "supersplat"
    page = _PAGE.format(
        title=path.stem.replace("&", "&amp;").replace("<", "&lt;"),
        license=(parts / "LICENSE").read_text(encoding="utf-8"),
        style=(parts / "viewer.css").read_text(encoding="utf-8"),
        viewer=gzip.decompress((parts / "viewer.js.gz").read_bytes()).decode(),
        scene=scene,
        settings=json.dumps(_build_settings(gaussians, view)),
        antialiased=json.dumps(settings.antialiased),
    )
    write_file(path, page)
    return written


def _build_settings(gaussians: Gaussians, view: StartView | None) -> dict[str, Any]:
    """Builds the viewer's settings: background and first view."""
    if view is None:
        view = _look_from_outside(gaussians)
        turn = np.eye(3)
    else:
        turn = rotate_upright(view.up)
    initial = {
        "position": (_HALF_TURN * (turn @ view.position)).tolist(),
        "target": (_HALF_TURN * (turn @ view.target)).tolist(),
        "fov": view.fov_degrees,
    }
    off = {"enabled": False}
    effects = {
        "sharpness": off | {"amount": 0},
        "bloom": off | {"intensity": 0.1, "blurLevel": 2},
        "grading": off | {"brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
        "vignette": off | {"intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1},
        "fringing": off | {"intensity": 0.5},
    }
    return {
        "version": 2,
        "tonemapping": "linear",
        "highPrecisionRendering": False,
        "background": {"color": [0, 0, 0]},
        "postEffectSettings": effects,
        "animTracks": [],
        "cameras": [{"initial": initial}],
        "annotations": [],
        "startMode": "default",
    }


def _look_from_outside(gaussians: Gaussians) -> StartView:
    """Places the first view outside the scene, looking at its middle."""
    middle = np.median(gaussians.means, axis=0).astype(np.float64)
    extent = float(np.percentile(np.linalg.norm(gaussians.means - middle, axis=1), 80))
    place = middle + 2 * max(extent, 1e-6) * np.array([0.0, -0.3, -1.0])
    return StartView(place, middle, _UP, 60.0)


FORMAT = Format("HTML", (".html",), _write, None, lambda head: True)
