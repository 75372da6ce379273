"""`./run bench page`: a page of one file in Chromium: size, start, moving frames, errors."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gsut.lens import Camera
from gsut.render import render, to_uint8
from tests.bench.harness import WRONG, Benchmark, Column, Option, Row, Settings

_ROOT = Path(__file__).resolve().parents[2]
_MOST_LEVELS = 1  # of 255, of a right picture at rest
# Flags of Chromium and what follows the page's address, by what draws.
_WAYS: dict[str, tuple[tuple[str, ...], str]] = {
    "WebAssembly": ((), ""),
    "WebGL 2 on SwiftShader": (("--enable-unsafe-swiftshader",), "#card"),
}
_SIDE = 400  # pixels, of the frames that are compared
# Field angles, degrees, between which moving frames are compared with those at rest.
_FIELD = (0.0, 30.0, 60.0, 90.0, 180.0)
# A frame of a moving eye and the same at rest, and milliseconds of ten more, each from a new place.
_BOTH = """
  const values = {{ ...request(false), width: {side}, height: {side} }}, times = [];
  const read = ({{ picture }}) => {{
    const copy = new OffscreenCanvas(picture.width, picture.height), brush = copy.getContext("2d");
    brush.drawImage(picture, 0, 0);
    return Array.from(brush.getImageData(0, 0, picture.width, picture.height).data);
  }};
  const moving = read(await server.frame({{ ...values, moving: true }}));
  const still = read(await server.frame(values));
  for (let k = 0; k < 10; k++) {{
    const began = performance.now(), pose = [...values.pose];
    pose[3] += 0.01 * k;
    await server.frame({{ ...values, pose, moving: true }});
    times.push(performance.now() - began);
  }}
  return [moving, still, times];"""
# Turns the eye for some seconds; returns frames a second and their mean width, in the second half
# unless a frame takes longer.
_WALK = """
  const log = [], frame = server.frame.bind(server), end = performance.now() + 1000 * {seconds};
  server.frame = async (values) => {{
    const shown = await frame(values);
    log.push([performance.now(), values.width]);
    return shown;
  }};
  await new Promise((done) => {{
    const tick = () => {{
      if (performance.now() > end) return done();
      look(0.02, 0.004 * Math.sin(log.length / 20));
      setTimeout(tick, 12);
    }};
    tick();
  }});
  server.frame = frame;
  const half = log.filter(([when]) => when > end - 500 * {seconds});
  const [late, seconds] = half.length > 1 ? [half, 0.5 * {seconds}] : [log, {seconds}];
  const width = late.reduce((sum, [, each]) => sum + each, 0) / late.length;
  return [late.length / seconds, width || 0];"""


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists what can draw a page."""
    for way in _WAYS:
        yield {"page": Path(settings.page).name, "way": way}


def measure(case: Row, settings: Settings) -> Row:
    """Opens the page from the disk, compares it at rest, and walks."""
    sys.path.append(str(Path(__file__).parents[1] / "python"))
    from browser import browser

    path = _ROOT / settings.page
    text = path.read_text(encoding="utf-8")
    flags, part = _WAYS[case["way"]]
    with browser(more_flags=flags) as window:
        began = time.perf_counter()
        window.open(f"file://{path}{part}")
        window.wait("document.body.dataset.frames > 0")
        first = time.perf_counter() - began
        window.run("state.lossless = true; redraw(false);")
        window.wait("JSON.parse(document.body.dataset.frame).lossless && !busy && !wanted")
        found = window.read_canvas()[..., :3].astype(np.int64)
        pace = window.run("return $('pace').textContent;")
        gaussians = window.read_gaussians()
        content = json.loads(window.run("return JSON.stringify(server.content);"))
        moved, still, times = window.run(_BOTH.format(side=_SIDE))
        window.run("state.lossless = false;")
        moving, width = window.run(_WALK.format(seconds=settings.seconds))
        height = width * window.run("return lens.height / lens.width;")
    camera = _read_camera(content)
    off = int(np.abs(found - _draw_again(content, camera, gaussians)).max())
    row = {
        "first_seconds": first, "moving": moving, "size": f"{width:.0f} x {height:.0f}",
        "by_angle": _compare(moved, still, camera), "frame_ms": float(np.median(times)),
        "levels": off, "megabytes": len(text.encode()) / 1e6, "module_kb": _read_size(text) / 1e3,
        "drawn_by": pace.rpartition(", ")[2],
    }  # fmt: skip
    if off > _MOST_LEVELS:
        row[WRONG] = "the picture at rest is not the renderer's"
    return row


def _read_part(text: str, name: str) -> str:
    found = re.search(rf'<script id="{name}"[^>]*>([^<]*)', text)
    assert found is not None
    return found[1]


def _read_size(text: str) -> int:
    """Reads the size of the compressed module, bytes."""
    return len(_read_part(text, "core")) * 13 // 16  # two digits for 13 bits


def _read_camera(content: dict[str, Any]) -> Camera:
    """Reads the camera of what the page shows first."""
    lens = content["lenses"][content["scene"]["views"][0]["lens"]]
    return Camera(
        lens["model"], lens["params"], lens["width"], lens["height"],
        **({"valid_field_angle": lens["valid_field_angle"]} if lens["valid_field_angle"] else {}),
    )  # fmt: skip


def _compare(moved: list[int], still: list[int], camera: Camera) -> str:
    """Compares two frames by field angle: rms, levels of 255, from ring to ring of _FIELD."""
    off = np.subtract(moved, still).astype(np.float64).reshape(_SIDE, _SIDE, 4)[..., :3]
    rays, valid = camera.resize(_SIDE, _SIDE).rays()
    angles = np.degrees(np.arccos(np.clip(rays[..., 2], -1, 1)))
    rings = (valid & (angles >= low) & (angles < high) for low, high in pairwise(_FIELD))
    return ", ".join(f"{np.sqrt((off[ring] ** 2).mean()):.2f}" for ring in rings if ring.any())


def _draw_again(content: dict[str, Any], camera: Camera, gaussians: Any) -> np.ndarray:
    """Draws what the page shows first by gsut.render."""
    view = content["scene"]["views"][0]
    pose = np.reshape(view["pose"], (4, 4))
    image = render(gaussians, camera, pose, background=content["background"]).image
    return np.rot90(to_uint8(image).astype(np.int64), -view.get("turns", 0))


BENCHMARK = Benchmark(
    help="a page of one file in headless Chromium: size, start, moving frames, errors",
    columns=(
        Column("page"),
        Column("way"),
        Column("drawn_by", "it says", form="s"),
        Column("module_kb", "module, compressed", "kB", ".0f"),
        Column("megabytes", "page", "MB", ".1f"),
        Column("first_seconds", "first picture", "s", ".1f"),
        Column("moving", "moving frames per second", form=".1f"),
        Column("size", "their size", "px", "s"),
        Column("frame_ms", "one of 400 x 400", "ms", ".0f"),
        Column("by_angle", "rms to rest, within 30, 60, 90 degrees, beyond", "levels", "s"),
        Column("levels", "off at rest", "levels of 255", "d"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("page", "docs/demo.html", "the page, made by ./run docs"),
        Option("seconds", 6.0, "of the walk"),
    ),
)
