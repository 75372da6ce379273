"""Makes the demo's scenes in python/gsut/demo, or checks that they are what the tracer makes.

.venv/bin/python -m lab.demo_tracer [--check]
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from gsut.demo.scenes import DEMO_SCENES
from lab.demo_tracer import make_demo_rig, make_demo_scene

SHIPPED = Path(__file__).resolve().parents[2] / "python" / "gsut" / "demo"
RIG_FRAMES, RIG_PATH_SHARE = 7, 0.35  # a third of the walk
RIG_FIRST = 1  # at the walk's first pose the cameras share too little with the second
RIG_TEST_EVERY = 8  # images whose depth is kept: those that `gsut train` holds out
NOT_SHIPPED = ("truth.ply",)


def trace_scenes(folder: Path) -> None:
    """Ray-casts each scene of DEMO_SCENES into a folder of its name."""
    make_demo_scene(folder / "fisheye_hall")
    rig = make_demo_rig(folder / "rig_hall", RIG_FRAMES, path_share=RIG_PATH_SHARE, first=RIG_FIRST)
    for number, depth in enumerate(sorted((rig / "depth").rglob("*.png"))):
        if number % RIG_TEST_EVERY:
            depth.unlink()


def list_files(scene: Path) -> list[Path]:
    """Lists the files of a traced scene that come with gsut, relative to it."""
    files = (path.relative_to(scene) for path in sorted(scene.rglob("*")) if path.is_file())
    return [file for file in files if str(file) not in NOT_SHIPPED]


def pack_file(made: Path, shipped: Path) -> None:
    """Copies a file; colour pictures become lossless WebP, others small PNG."""
    shipped.parent.mkdir(parents=True, exist_ok=True)
    if made.suffix != ".png":
        shutil.copyfile(made, shipped)
        return
    picture = Image.open(made)
    if picture.mode == "RGB":
        picture.save(shipped.with_suffix(".webp"), lossless=True, quality=100, method=6, exact=True)
    else:
        picture.save(shipped, optimize=True)


def is_same_file(made: Path, shipped: Path) -> bool:
    """Compares pixels of pictures, bytes of others; a YAML's head follows OpenCV's version."""
    if not shipped.is_file():
        shipped = shipped.with_suffix(".webp")
    if not shipped.is_file():
        return False
    if made.suffix != ".png":
        own, other = (path.read_bytes().split(b"\n---\n")[-1] for path in (made, shipped))
        return own == other
    pictures = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (made, shipped)]
    return pictures[0].dtype == pictures[1].dtype and np.array_equal(*pictures)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lab.demo_tracer", description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare only; exit status 1: differ")
    arguments = parser.parse_args()
    wrong = []
    with tempfile.TemporaryDirectory() as temporary:
        trace_scenes(Path(temporary))
        for name in DEMO_SCENES:
            made, shipped = Path(temporary) / name, SHIPPED / name
            if not arguments.check:
                shutil.rmtree(shipped, ignore_errors=True)
                for file in list_files(made):
                    pack_file(made / file, shipped / file)
            wrong += [
                f"{name}/{file}" for file in list_files(made)
                if not is_same_file(made / file, shipped / file)
            ]  # fmt: skip
    for file in wrong:
        print(f"differs: {file}")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
