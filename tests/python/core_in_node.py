"""The WebAssembly core in node, beside native code without vectors."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import gsut
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
        for gaussians, *_ in jobs:
            for name in PARTS:
                file.write(np.ascontiguousarray(getattr(gaussians, name), np.float32).tobytes())
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


def draw_natively(gaussians, camera, start, end, shutter):
    """As `draw_in_node`, by native code without vectors."""
    pose = start if shutter == "global" else (start, end)
    rolling = {} if shutter == "global" else {"shutter": shutter}
    seen = gsut.render(gaussians, camera, pose, background=BACKGROUND, **rolling)
    planes = (seen.image, seen.alpha[..., None], seen.depth[..., None], seen.image)
    return np.concatenate(planes, axis=2)


def hold_scalar():
    """Draws natively without vectors meanwhile: the body of a fixture."""
    before = gsut.machine.active_isa()
    gsut.machine.set_isa("scalar")
    yield
    gsut.machine.set_isa(before)
