"""`./run bench viewers`: pages of a run in the SuperSplat viewer, against gsut's own pictures."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.cli._flags import add_json, print_json
from gsut.gaussians import rotate_upright
from gsut.render import psnr, render
from gsut.run import RunFolder
from gsut.training import read_trained

HELP = "pages of a run in the SuperSplat viewer (headless Chromium), against gsut's own pictures"
_SIZE = (960, 720)
_FIELDS_DEGREES = (60.0, 75.0, 90.0)


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="RUN", help="the run that the pages were made of")
    parser.add_argument("pages", metavar="PAGE.html", nargs="+", help="of `gsut convert RUN ...`")
    parser.add_argument("--data", metavar="DATA", help="its dataset, if that has moved")
    parser.add_argument("--poses", type=int, default=3, metavar="N", help="held out [default 3]")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    sys.path.append(str(Path(__file__).parents[1] / "python"))
    from real_viewers import level_pose, pinhole, supersplat_pictures, viewer_window

    options, scene, gaussians = read_trained(RunFolder.open(arguments.folder), arguments.data)
    rows = list(scene.test_indices)
    if not rows or arguments.poses < 1:
        raise InputError(f"{arguments.folder} has {len(rows)} held-out views; 1 at least")
    rows = [rows[i] for i in np.linspace(0, len(rows) - 1, arguments.poses).round().astype(int)]
    first = list(scene.train_indices or range(len(scene)))
    up = -scene.poses(first)[:, 1, :3].mean(axis=0)  # as gsut convert turns its pages
    poses = [scene.views[row].camera_from_world for row in rows]
    cameras = [
        (level_pose(-pose[:3, :3].T @ pose[:3, 3], pose[2, :3], up), field)
        for pose in poses
        for field in _FIELDS_DEGREES
    ]
    truths = [
        np.clip(
            render(gaussians, pinhole(*_SIZE, field), pose, background=options.background).image,
            0, 1,
        )
        for pose, field in cameras
    ]  # fmt: skip
    found: list[dict[str, Any]] = []
    with viewer_window(*_SIZE) as window:
        for page in arguments.pages:
            shown = supersplat_pictures(window, Path(page), cameras, rotate_upright(up))
            each = [psnr(picture, truth) for picture, truth in zip(shown, truths, strict=True)]
            found.append({"page": page, "psnr": float(np.mean(each)), "each": each})
            if not arguments.json:
                print(f"{page}: {np.mean(each):.2f} dB, {min(each):.2f} to {max(each):.2f}")
    if arguments.json:
        print_json(found)
    return 0
