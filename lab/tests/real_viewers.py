"""Viewers that nobody here wrote, in headless Chromium: their pictures of our files.

Spark and three.js are found in the folder that GSUT_VIEWER_MODULES names:
npm install @sparkjsdev/spark@2.2.0 three.
"""

from __future__ import annotations

import contextlib
import functools
import http.server
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from browser import Browser, browser
from gsut.lens import Camera

SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])  # from a file's axes to the viewers', where y is up
_PAGE = """<!doctype html>
<style>body {{ margin: 0; background: #000; }} canvas {{ display: block; }}</style>
<script type="importmap">{{"imports": {{"three": "/three/build/{three}.js",
"three/webgpu": "/three/build/three.webgpu.js", "three/tsl": "/three/build/three.tsl.js",
"three/addons/": "/three/examples/jsm/",
"@sparkjsdev/spark": "/@sparkjsdev/spark/dist/spark.module.js"}}}}</script>
<script type="module">
import * as THREE from "three";
{imports}
const url = "/files/{name}", scene = new THREE.Scene();
{load}
renderer.setPixelRatio(1);
renderer.setSize({width}, {height});
document.body.append(renderer.domElement);
const camera = new THREE.PerspectiveCamera({fov}, {width} / {height}, 0.05, 1000);
camera.matrixAutoUpdate = false;
camera.matrix.fromArray({matrix});
camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
camera.matrixWorldNeedsUpdate = true;
for (let k = 0; k < 12; k++) {{
  renderer.render(scene, camera);
  await new Promise((done) => setTimeout(done, 60));
}}
document.body.dataset.ready = "1";
</script>"""
_SPARK = {
    "three": "three.module",
    "imports": 'import { SplatMesh, SparkRenderer } from "@sparkjsdev/spark";',
    "load": """const renderer = new THREE.WebGLRenderer({ antialias: false });
scene.add(new SparkRenderer({ renderer }));
const mesh = new SplatMesh({ url });
await mesh.initialized;
mesh.quaternion.set(0, 0, 1, 0);  // viewers' half turn about z
scene.add(mesh);""",
}
_THREE = {
    "three": "three.webgpu",
    "imports": """import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { GLTFGaussianSplatLoaderExtension as Splats }
  from "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js";""",
    "load": """const renderer = new THREE.WebGPURenderer({ antialias: false, forceWebGL: true });
await renderer.init();
renderer.setClearColor(0x000000, 1);
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;  // colours are the display's already
const loader = new GLTFLoader();
loader.register((parser) => new Splats(parser));
scene.add((await loader.loadAsync(url)).scene);""",
}


@contextlib.contextmanager
def viewer_window(width: int, height: int) -> Iterator[Browser]:
    """A window of so many pixels, with WebGL in software."""
    with browser(width, height, SOFTWARE_WEBGL) as window:
        window.devtools(
            "Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        yield window


def pinhole(width: int, height: int, field_degrees: float) -> Camera:
    """Across the longer side."""
    focal = max(width, height) / 2 / np.tan(np.radians(field_degrees) / 2)
    return Camera("pinhole", [focal, focal, width / 2, height / 2], width, height)


def level_pose(position: np.ndarray, forward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(4, 4) camera_from_world of a camera that holds its horizon level."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = [x, np.cross(z, x), z]
    pose[:3, 3] = -pose[:3, :3] @ position
    return pose


def picture_of(window: Browser) -> np.ndarray:
    """(H, W, 3) in 0 to 1, once two pictures are alike."""
    before = None
    end = time.monotonic() + 60
    while True:
        data = np.frombuffer(window.picture(), np.uint8)
        now = cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
        if before is not None and np.array_equal(before, now) and now.any():
            return now / 255.0
        assert time.monotonic() < end, "the viewer never comes to rest"
        before = now
        time.sleep(0.4)


@contextlib.contextmanager
def viewer_pages(folder: Path) -> Iterator[Any]:
    """A function (name of a file in `folder`, camera, pose) -> address of a page that shows it.

    glTF is shown by three.js, all else by Spark.
    """
    modules = os.environ.get("GSUT_VIEWER_MODULES")
    if not modules or not (Path(modules) / "@sparkjsdev/spark").is_dir():
        pytest.skip("GSUT_VIEWER_MODULES names no node_modules with Spark and three.js")
    (folder / "pages").mkdir(exist_ok=True)

    class Handler(http.server.SimpleHTTPRequestHandler):
        def translate_path(self, path: str) -> str:
            path = path.partition("?")[0].lstrip("/")
            for prefix, where in (("files/", folder), ("pages/", folder / "pages")):
                if path.startswith(prefix):
                    return str(where / path.removeprefix(prefix))
            return str(Path(modules) / path)

        def log_message(self, *_: Any) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler))
    threading.Thread(target=server.serve_forever, daemon=True).start()

    def page(name: str, camera: Camera, pose: np.ndarray) -> str:
        axes = _HALF_TURN @ pose[:3, :3].T @ np.diag([1.0, -1.0, -1.0])
        matrix = np.eye(4)
        matrix[:3, :3] = axes
        matrix[:3, 3] = _HALF_TURN @ (-pose[:3, :3].T @ pose[:3, 3])
        field = 2 * np.degrees(np.arctan(camera.height / 2 / camera.params[1]))
        viewer = _THREE if name.endswith(".glb") else _SPARK
        text = _PAGE.format(
            **viewer, width=camera.width, height=camera.height, name=name, fov=field,
            matrix=matrix.T.ravel().tolist(),
        )  # fmt: skip
        (folder / "pages" / f"{name}.html").write_text(text)
        return f"http://127.0.0.1:{server.server_address[1]}/pages/{name}.html"

    try:
        yield page
    finally:
        server.shutdown()
        server.server_close()
