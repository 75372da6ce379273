"""The WebAssembly core in node and in Chromium, beside native code of four lanes."""

import base64
import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import gsut
from browser import browser
from gsut.render import place_about

ROOT = Path(__file__).resolve().parents[2]
CORE = ROOT / "python/gsut/view/exact"
HERE = Path(__file__).parent
BACKGROUND = (0.3, 0.1, 0.6)
PARTS = ("means", "quats", "log_scales", "opacity_logits", "sh")
NODE_SECONDS = 300


def require_node():
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    return node


def run_node(*arguments):
    return subprocess.run(
        [require_node(), *map(str, arguments)],
        capture_output=True, text=True, timeout=NODE_SECONDS, check=False,
    )  # fmt: skip


def describe_job(gaussians, camera, start, end, shutter, runs=0):
    return {
        "runs": runs,
        "size": len(gaussians), "coefficients": gaussians.sh.shape[1], "shutter": shutter,
        "start": np.ravel(place_about(start, gaussians.origin)).tolist(),
        "end": np.ravel(place_about(end, gaussians.origin)).tolist(),
        "background": BACKGROUND,
        "camera": {
            "model": camera.model, "params": list(camera.params), "width": camera.width,
            "height": camera.height,
            "valid_field_angle": camera.valid_field_angle,
        },
    }  # fmt: skip


def draw_in_node(folder, jobs):
    """Images, alphas, depths and images of two halves of each job, as (H, W, 8) float32."""
    with open(folder / "numbers.bin", "wb") as file:
        for part in list_parts(jobs):
            file.write(part)
    (folder / "jobs.json").write_text(json.dumps([describe_job(*job) for job in jobs]))
    done = run_node(HERE / "draw_jobs.js", folder, CORE)
    assert done.returncode == 0, done.stderr
    numbers, at, images = np.fromfile(folder / "images.bin", np.float32), 0, []
    for _, camera, *_ in jobs:
        planes = []
        for channels in (3, 1, 1, 3):
            count = camera.width * camera.height * channels
            planes.append(numbers[at : at + count].reshape(camera.height, camera.width, channels))
            at += count
        images.append(np.concatenate(planes, axis=2))
    assert at == len(numbers)
    return images


def draw_in_browser(folder, jobs):
    """Digests of what `draw_in_node` gives, see `digest`, by a page in headless Chromium."""
    page = folder / "draw.html"
    scripts = [(CORE / "core.js").read_text(), (HERE / "draw_jobs.js").read_text()]
    data = {"core": (CORE / "core.wasm.gz").read_bytes(), "numbers": b"".join(list_parts(jobs))}
    page.write_text(
        "<!doctype html><meta charset=utf-8>"
        + "".join(
            f'<script id="{name}" type="x">{base64.b64encode(value).decode()}</script>'
            for name, value in data.items()
        )
        + f'<script id="jobs" type="x">{json.dumps([describe_job(*job) for job in jobs])}</script>'
        + "".join(f"<script>{text}</script>" for text in scripts),
        encoding="utf-8",
    )
    with browser() as window:
        window.open(f"file://{page}")
        drawn = window.run("""
          const part = (id) => document.getElementById(id);
          const decode = (id) =>
            Uint8Array.from(atob(part(id).textContent), (c) => c.charCodeAt(0));
          const stream = new Blob([decode("core")]).stream();
          const unpacked = stream.pipeThrough(new DecompressionStream("gzip"));
          const core = await Core.load(new Uint8Array(await new Response(unpacked).arrayBuffer()));
          const out = [], bytes = decode("numbers");
          drawJobs(core, JSON.parse(part("jobs").textContent), new Float32Array(bytes.buffer),
            (array) => out.push(crypto.subtle.digest("SHA-256", array)));
          const hex = (byte) => byte.toString(16).padStart(2, "0");
          const text = (all) => Array.from(new Uint8Array(all), hex).join("");
          return (await Promise.all(out)).map(text);""")
    assert isinstance(drawn, list), drawn
    return [drawn[at : at + 4] for at in range(0, len(drawn), 4)]


def digest(image):
    """SHA-256 of image, alpha, depth and joined image of (H, W, 8) as `draw_in_node` gives them."""
    planes = np.split(image, (3, 4, 5), axis=2)
    return [hashlib.sha256(np.ascontiguousarray(plane)).hexdigest() for plane in planes]


def list_parts(jobs):
    """The arrays of all jobs' Gaussians as bytes, one after the other."""
    for gaussians, *_ in jobs:
        for name in PARTS:
            yield np.ascontiguousarray(getattr(gaussians, name), np.float32).tobytes()


def draw_natively(gaussians, camera, start, end, shutter):
    """As `draw_in_node`, by native code without vectors."""
    pose = start if shutter == "global" else (start, end)
    rolling = {} if shutter == "global" else {"shutter": shutter}
    seen = gsut.render(gaussians, camera, pose, background=BACKGROUND, **rolling)
    planes = (seen.image, seen.alpha[..., None], seen.depth[..., None], seen.image)
    return np.concatenate(planes, axis=2)


def hold_least_isa():
    """Draws natively on the least instruction set meanwhile: the body of a fixture."""
    before = gsut.machine.active_isa()
    gsut.machine.set_isa(gsut.machine.available_isas()[-1])
    yield
    gsut.machine.set_isa(before)
