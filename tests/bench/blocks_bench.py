"""`./run bench blocks`: one training against blocks: quality, at seams and elsewhere, and cost."""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gsut
from gsut.blocks import Layout
from gsut.data import TrainingViews
from gsut.demo import make_demo_scene
from gsut.gaussians import SH_C0
from tests.bench.block_runs import figures_of, print_stages, train_apart
from tests.bench.report_rows import add_files, bar, check_files, print_and_write, row_writer

_SEAM_SHARE, _SEAM_BLOCKS = 0.05, 2  # blocks of so much of a pixel that make it one of a seam
_COLUMNS = (
    ("scene", "scene", ""),
    ("training", "training", ""),
    ("PSNR [dB]", "psnr", ".2f"),
    ("below one of as many", "below", ".2f"),
    ("at seams", "below_seams", ".2f"),
    ("elsewhere", "below_rest", ".2f"),
    ("seam pixels [%]", "seam_percent", ".1f"),
    ("Gaussians", "num_gaussians", ",d"),
    ("steps", "steps", ",d"),
    ("Mpx rendered", "megapixels", ",.0f"),
    ("CPU-s", "cpu_seconds", ".0f"),
    ("s", "seconds", ".0f"),
    ("peak MB", "peak_mb", ",.0f"),
    ("MB written", "megabytes", ".1f"),
    ("same bits", "same_bits", ""),
)
_ONE, _MORE = "one", "one, as many steps"


@dataclasses.dataclass(frozen=True)
class BlocksBenchOptions:
    """What is trained.

    Args:
        data: datasets with held-out views; empty: the demo's hall.
        blocks: how many.
        flags: of all trainings.
        size: of the hall's images, pixels.
        workers: of the last row, which has one thread each.
        runs: folder of the runs, which are kept there and read again.
    """

    data: Sequence[Path]
    blocks: int
    flags: Sequence[str]
    size: int
    workers: int
    runs: Path

    def trainings(self) -> dict[str, list[str]]:
        """Flags by name; the last two must have the same bits."""
        blocks = ["--blocks", str(self.blocks)]
        return {
            _ONE: [],
            f"{self.blocks} blocks, 1 round": [*blocks, "--rounds", "1"],
            f"{self.blocks} blocks, 2 rounds": blocks,
            f"  by {self.workers} workers": [*blocks, "--workers", str(self.workers)],
        }


def blocks_bench(
    options: BlocksBenchOptions,
    say: Callable[[str], None],
    write: Callable[[list[dict[str, Any]]], None] = lambda rows: None,
) -> list[dict[str, Any]]:
    """A row a training of each scene.

    Args:
        options: what to train.
        say: told what begins.
        write: gets all rows after each scene.

    Returns:
        PSNR is the mean over held-out views; `below` how far it lies under that of one training
        of as many steps as the blocks have made together with the coarse model,
        `below_seams` and `below_rest` the same of the squared error over all pixels in which two
        blocks have more than 5 % each, and over the others.
    """
    rows: list[dict[str, Any]] = []
    for data in options.data or [_hall(options)]:
        runs: dict[str, Path] = {}
        own: list[dict[str, Any]] = []
        for number, (name, flags) in enumerate(options.trainings().items()):
            say(f"{data.name}, {name.strip()}")
            runs[name] = options.runs / f"{data.name}-{number}"
            metrics = train_apart(data, runs[name], [*flags, *options.flags])
            own.append({"scene": data.name, "training": name} | _figures(runs[name], metrics))
        say(f"{data.name}, one of as many steps")
        more = [*options.flags, "--steps", str(own[-1]["steps"])]
        runs[_MORE] = options.runs / f"{data.name}-more"
        figures = _figures(runs[_MORE], train_apart(data, runs[_MORE], more))
        own.append({"scene": data.name, "training": _MORE} | figures)
        say(f"{data.name}, seams")
        _judge(own, runs)
        rows += own
        write(rows)
    return rows


def _hall(options: BlocksBenchOptions) -> Path:
    folder = options.runs / f"hall{options.size}"
    if not folder.is_dir():
        make_demo_scene(folder, size=options.size)
    return folder


def _figures(run: Path, metrics: dict[str, Any]) -> dict[str, Any]:
    row = figures_of(metrics)
    return row if "stages" in row else row | {"megapixels": _pixels_of(run) / 1e6}


def _pixels_of(run: Path) -> int:
    """Rendered in the steps of a plain training."""
    trained = gsut.load_run(run)
    o = trained.options.resolved()
    views, counts, total = TrainingViews(trained.scene, o.coarse_to_fine), {}, 0
    for step in range(o.steps):
        camera = views.at(step / o.steps).scene.cameras[0]
        if camera.width not in counts:
            counts[camera.width] = int(np.count_nonzero(camera.rays()[1]))
        total += counts[camera.width]
    return total


def _judge(rows: list[dict[str, Any]], runs: dict[str, Path]) -> None:
    """Adds what lies below one training, at the seams of the blocks and elsewhere, and the bits."""
    names = list(runs)
    by_blocks = names[-3:-1]
    trained = {name: gsut.load_run(run) for name, run in runs.items()}
    layout = Layout.read(str(runs[by_blocks[-1]] / "blocks/layout.json"))
    scene = trained[_ONE].scene
    errors = {name: np.zeros(2) for name in names}
    pixels = np.zeros(2)
    for index in scene.test_indices:
        mask, seam = scene.mask(index), _seam(trained[by_blocks[-1]], layout, index)
        truth = scene.image(index).astype(np.float32) / 255
        where = (mask & seam, mask & ~seam)
        pixels += [np.count_nonzero(each) for each in where]
        for name, run in trained.items():
            squared = (_picture(run, index) - truth) ** 2
            errors[name] += [3 * squared[each].mean(axis=1).sum() / 3 for each in where]
    levels = {name: -10 * np.log10(error / np.maximum(pixels, 1)) for name, error in errors.items()}
    for name, row in zip(names, rows, strict=True):
        below = levels[_MORE] - levels[name]
        row |= {
            "below": rows[-1]["psnr"] - row["psnr"], "below_seams": float(below[0]),
            "below_rest": float(below[1]), "seam_percent": float(100 * pixels[0] / pixels.sum()),
        }  # fmt: skip
    scenes = [(runs[name] / "scene.ply").read_bytes() for name in by_blocks]
    rows[-2]["same_bits"] = "yes" if scenes[0] == scenes[1] else "NO"


def _picture(run: Any, index: int) -> np.ndarray:
    view, camera = run.scene.views[index], run.scene.camera(index)
    image = gsut.render(run.gaussians, camera, view.motion, background=run.options.background).image
    if run.light is not None:
        image = image * run.light.on(camera, index, view.camera_index)
    return np.clip(image, 0.0, 1.0)


def _seam(run: Any, layout: Layout, index: int) -> np.ndarray:
    """(H, W) bool: pixels in which two blocks have more than 5 % each."""
    g = run.gaussians
    owners = layout.owners(g.means.astype(np.float64) + g.origin)
    view, camera = run.scene.views[index], run.scene.camera(index)
    count = np.zeros((camera.height, camera.width), int)
    for block in range(len(layout)):
        sh = np.where(owners == block, 0.5 / SH_C0, -0.5 / SH_C0).astype(np.float32)
        shown = dataclasses.replace(g, sh=np.repeat(sh[:, None, None], 3, axis=2))
        count += gsut.render(shown, camera, view.motion).image[..., 0] > _SEAM_SHARE
    return count >= _SEAM_BLOCKS


# --- the command ----------------------------------------------------------------------------------

HELP = "one training against blocks in one and two rounds: held-out PSNR, seams, work, workers"


def add_flags(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("data", metavar="DATA", nargs="*", type=Path, help="datasets [default: the demo's hall]")
    add("--blocks", type=int, default=4, metavar="N", help="[default 4]")
    add("--steps", type=int, default=1000, metavar="N", help="of one training [default 1000]")
    add("--max-gaussians", metavar="N", default="20000", help="[default 20000]")
    add("--scale", type=float, default=1.0, metavar="X", help="of the images [default 1]")
    add("--size", type=int, default=160, metavar="PX", help="of the hall's images [default 160]")
    add("--threads", type=int, default=2, metavar="N", help="of all workers [default 2]")
    add("--workers", type=int, default=2, metavar="N", help="of the last row [default 2]")
    add("--runs", type=Path, metavar="FOLDER", help="keep the runs here, and go on with them")
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    check_files(arguments)
    gsut.set_num_threads(arguments.threads)
    flags = [
        "--steps", str(arguments.steps), "--max-gaussians", arguments.max_gaussians, "--scale",
        str(arguments.scale), "--threads", str(arguments.threads),
    ]  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="gsut-bench-") as temporary:
        runs = arguments.runs or Path(temporary)
        runs.mkdir(parents=True, exist_ok=True)
        options = BlocksBenchOptions(
            arguments.data, arguments.blocks, flags, arguments.size, arguments.workers, runs
        )
        total = max(1, len(arguments.data)) * (2 + len(options.trainings()))
        with bar(total) as advance:
            rows = blocks_bench(options, advance, row_writer(arguments))
    print_and_write(rows, _COLUMNS, arguments)
    print_stages(rows, "scene")
    return 0
