"""`gsut compact`: fewer Gaussians, of a run or a PLY file, and what the picture loses."""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import (
    FILE_SUFFIXES,
    add_json,
    add_quiet,
    finite,
    print_result,
    show_findings,
    whole,
)
from gsut.files import refuse_existing
from gsut.terminal import say

HELP = "fewer Gaussians, for a picture as near as they allow"
DESCRIPTION = (
    "Merges or prunes the Gaussians of a finished run, or of a PLY file, and writes a new run or "
    "file. Nothing in RUN changes."
)
_PLY = ".ply"
_WORKING = 1.5  # of the Gaussians' numbers, beside them: pairs, and the result


def add_flags(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source", metavar="RUN|FILE.ply", help="a finished run, or any PLY file of Gaussians"
    )
    parser.add_argument(
        "-o", "--out", metavar="RUN2|FILE2.ply", required=True,
        help="folder of the new run; of a PLY file the PLY file to write",
    )  # fmt: skip
    parser.add_argument(
        "--keep", type=finite, metavar="X", help="fraction of the Gaussians to keep, such as 0.1"
    )
    parser.add_argument(
        "--target-psnr-drop", type=finite, metavar="DB",
        help="instead: the fewest Gaussians that lose at most DB on the held-out views",
    )  # fmt: skip
    parser.add_argument(
        "--method", default="ghap", metavar="METHOD",
        help="ghap: merge neighbours where it costs least, weighted by what the lenses see, and "
        "fit colours to the whole model's pictures; field: without the fit; ghap-paper: the "
        "published k-means; lightgaussian, pup: prune by score [default ghap]",
    )  # fmt: skip
    parser.add_argument(
        "--finetune", type=whole, default=0, metavar="STEPS",
        help="train the result STEPS steps on the photographs; the fewer Gaussians are kept, the "
        "more steps pay, up to the number of the run [default 0: no photograph is used]",
    )  # fmt: skip
    add_quiet(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    from gsut.training.tuning import CompactOptions

    options = CompactOptions(
        method=arguments.method,
        keep=arguments.keep,
        target_psnr_drop=arguments.target_psnr_drop,
        finetune=arguments.finetune,
    )
    if Path(arguments.source).suffix.lower() == _PLY or Path(arguments.source).is_file():
        return _compact_file(arguments, options)
    return _compact_run(arguments, options)


def _compact_file(arguments: argparse.Namespace, options: Any) -> int:
    """Compacts a PLY file without cameras or photographs."""
    import time

    import gsut
    from gsut.compact import check_method, compact
    from gsut.formats import check_room

    if options.finetune or options.target_psnr_drop is not None:
        raise InputError(
            "--finetune and --target-psnr-drop need photographs; give the folder of a run"
        )
    check_method(options.method, False)
    out = Path(arguments.out)
    if out.suffix.lower() != _PLY:
        raise InputError(f"-o {out}: of a PLY file a PLY file is made; give a name ending in .ply")
    refuse_existing(out)
    gaussians = gsut.formats.load_ply(arguments.source)
    check_room("compacting", [gaussians], _WORKING)
    started = time.perf_counter()
    result = compact(gaussians, options.keep, method=options.method, seed=options.seed)
    seconds = time.perf_counter() - started
    gsut.formats.save_ply(out, result.gaussians)
    line = f"{len(gaussians):,} -> {len(result.gaussians):,} Gaussians in {seconds:.1f} s: {out}"
    figures = {
        "method": options.method,
        "source_num_gaussians": len(gaussians),
        "num_gaussians": len(result.gaussians),
        "dropped": result.dropped,
        "compact_seconds": seconds,
        "bytes": out.stat().st_size,
    }
    return print_result(arguments, figures, [line])


def _compact_run(arguments: argparse.Namespace, options: Any) -> int:
    from gsut.formats import check_room
    from gsut.gaussians import StoredGaussians
    from gsut.run import Progress, RunFile, RunFolder
    from gsut.training import load_run
    from gsut.training.tuning import RunCompactor, write_compacted_run

    source = RunFolder.open(arguments.source)
    if Path(arguments.out).suffix.lower() in FILE_SUFFIXES:
        raise InputError(
            f"-o {arguments.out}: of a run a run is made, a folder; then gsut convert makes a file"
        )
    target = RunFolder.claim(arguments.out, "compact", arguments.source)
    target.refuse_finished(arguments.source)  # before anything that takes long
    trained = load_run(arguments.source)
    show_findings(trained.scene, source, arguments.quiet)
    check_room("compacting", [trained.gaussians], _WORKING, StoredGaussians.DRAWN_BYTES)

    def on_try(count: int, psnr: float) -> None:
        if not arguments.quiet:
            say(f"{count:,} Gaussians: {psnr:.2f} dB")

    done, views = itertools.count(), len(trained.scene.train_indices)
    with Progress(not arguments.quiet) as bars:
        compactor = RunCompactor(
            trained, options,
            on_view=lambda: bars.show("views", next(done) % views + 1, views),
            on_step=lambda loop, loss: bars.show_step(
                loop.step, loop.options.steps, loss, len(loop.gaussians)
            ),
            on_try=on_try,
        )  # fmt: skip
        made = compactor.make()
    run = write_compacted_run(target.path, source, compactor, made)
    metrics = run.read_json(RunFile.METRICS)
    lines = _summarize(metrics, (run.path / RunFile.SCENE).stat().st_size)
    return print_result(arguments, metrics, lines)


def _summarize(metrics: dict[str, Any], size: int) -> Iterator[str]:
    done = metrics["compaction"]
    steps, seconds = done["finetune_steps"], done["compact_seconds"] + done["finetune_seconds"]
    tuned = f", {steps} steps" if steps else ""
    yield (
        f"{done['source_num_gaussians']:,} -> {metrics['num_gaussians']:,} Gaussians by "
        f"{done['method']}{tuned} in {seconds:.1f} s, {size / 1e6:.1f} MB"
    )
    if metrics["psnr"] is not None:
        before = done["source_psnr"]
        was = ""
        if before is not None:
            change = metrics["psnr"] - before
            was = f" ({'gains' if change > 0 else 'loses'} {abs(change):.2f} dB)"
        yield (
            f"PSNR {metrics['psnr']:.2f} dB{was}, SSIM {metrics['ssim']:.4f}, "
            f"{metrics['render_ms']:.1f} ms a view"
        )
