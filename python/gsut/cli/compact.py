"""`gsut compact`: fewer Gaussians, of a run or a PLY file, and what the picture loses."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import sys
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.cli._flags import (
    FILE_SUFFIXES,
    Number,
    add_json,
    add_moved_data,
    add_quiet,
    finite,
    print_json,
    whole,
)
from gsut.files import refuse_existing
from gsut.run.options import add_rare_option

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
        "--target-size", metavar="SIZE",
        help="instead: the most Gaussians that fit into a PLY file of this size, such as 5MB",
    )  # fmt: skip
    parser.add_argument(
        "--method", default="auto", metavar="METHOD",
        help="ghap: merge neighbours where it costs least, weighted by what the lenses see, and "
        "fit colours to the whole model's pictures; field: without the fit; ghap-paper: the "
        "published k-means; lightgaussian, pup: prune by score; auto: ghap, but with --finetune "
        "where photographs differ in light and more than a fifth is kept, the same number is "
        "trained from the start for the same work, which is better there [default auto]",
    )  # fmt: skip
    parser.add_argument(
        "--finetune", type=whole, default=0, metavar="STEPS",
        help="train the result STEPS steps on the photographs; the fewer Gaussians are kept, the "
        "more steps pay, up to the number of the run [default 0: no photograph is used]",
    )  # fmt: skip
    parser.add_argument(
        "--harmonics-drop", type=finite, metavar="DB",
        help="lower each Gaussian's degree of harmonics as far as the held-out views lose at most "
        "DB by it [default: leave them]",
    )  # fmt: skip
    add_moved_data(parser)
    add_quiet(parser)
    add_json(parser)
    add_rare_option(
        parser, "seed", Number(0, whole=True), 0, metavar="N",
        help="seed of every random number [default 0]",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    from gsut.run.options import parse_size
    from gsut.training.tuning import CompactOptions

    size = arguments.target_size
    options = CompactOptions(
        method=arguments.method,
        keep=arguments.keep,
        target_psnr_drop=arguments.target_psnr_drop,
        target_bytes=None if size is None else parse_size(size),
        finetune=arguments.finetune,
        harmonics_drop=arguments.harmonics_drop,
        seed=arguments.seed,
    )
    if Path(arguments.source).suffix.lower() == _PLY or Path(arguments.source).is_file():
        figures = _compact_file(arguments, options)
    else:
        figures = _compact_run(arguments, options)
    if arguments.json:
        print_json(figures)
    return 0


def _compact_file(arguments: argparse.Namespace, options: Any) -> dict[str, Any]:
    """Compacts a PLY file without cameras or photographs."""
    import time

    import gsut
    from gsut.compact import check_method, compact
    from gsut.formats import check_room
    from gsut.training.tuning import count_for_bytes

    wishes = (options.target_psnr_drop, options.harmonics_drop)
    if options.finetune or any(wish is not None for wish in wishes):
        raise InputError(
            "--finetune, --target-psnr-drop and --harmonics-drop need photographs; give the folder "
            "of a run"
        )
    check_method(options.merging, False)
    out = Path(arguments.out)
    if out.suffix.lower() != _PLY:
        raise InputError(f"-o {out}: of a PLY file a PLY file is made; give a name ending in .ply")
    refuse_existing(out)
    gaussians = gsut.formats.load_ply(arguments.source)
    check_room("compacting", [gaussians], _WORKING)
    keep, count = options.keep, None
    if options.target_bytes is not None:
        count = count_for_bytes(gaussians, options.target_bytes)
    started = time.perf_counter()
    result = compact(gaussians, keep, count=count, method=options.merging, seed=options.seed)
    seconds = time.perf_counter() - started
    gsut.formats.save_ply(out, result.gaussians)
    if not arguments.quiet and not arguments.json:
        print(
            f"{len(gaussians):,} -> {len(result.gaussians):,} Gaussians in {seconds:.1f} s: {out}"
        )
    return {
        "method": options.merging,
        "source_num_gaussians": len(gaussians),
        "num_gaussians": len(result.gaussians),
        "dropped": result.dropped,
        "compact_seconds": seconds,
        "bytes": out.stat().st_size,
    }


def _compact_run(arguments: argparse.Namespace, options: Any) -> dict[str, Any]:
    from gsut.formats import check_room
    from gsut.gaussians import StoredGaussians
    from gsut.run import Progress, RunFile, RunFolder, read_plan
    from gsut.training import load_run
    from gsut.training.tuning import RunCompactor, write_compacted_run

    source = RunFolder.open(arguments.source)
    if Path(arguments.out).suffix.lower() in FILE_SUFFIXES:
        raise InputError(
            f"-o {arguments.out}: of a run a run is made, a folder; then gsut convert makes a file"
        )
    target = RunFolder.claim(arguments.out, "compact", arguments.source)
    target.refuse_finished(arguments.source)  # before anything that takes long
    trained = load_run(arguments.source, arguments.data)
    check_room("compacting", [trained.gaussians], _WORKING, StoredGaussians.DRAWN_BYTES)
    if read_plan(source) is not None:  # too large, perhaps, to be trained as a whole
        options = dataclasses.replace(options, method=options.merging)

    def on_try(count: int, psnr: float) -> None:
        if not arguments.quiet:
            print(f"gsut: {count:,} Gaussians: {psnr:.2f} dB", file=sys.stderr)

    earlier = (source.read_json(RunFile.METRICS) or {}).get("compaction") or {}
    done, views = itertools.count(), len(trained.scene.train_indices)
    with Progress(not arguments.quiet) as bars:
        compactor = RunCompactor(
            trained, options,
            keep_degrees=earlier.get("harmonics_degrees") is not None,
            on_view=lambda: bars.show("views", next(done) % views + 1, views),
            on_step=lambda loop, loss: bars.show_step(
                loop.step, loop.options.steps, loss, len(loop.gaussians)
            ),
            on_try=on_try,
        )  # fmt: skip
        if compactor.because:
            bars.note(compactor.because)
        made = compactor.make()
    run = write_compacted_run(target.path, source, compactor, made)
    metrics = run.read_json(RunFile.METRICS)
    if not arguments.quiet and not arguments.json:
        _print_summary(metrics, (run.path / RunFile.SCENE).stat().st_size)
    return metrics


def _print_summary(metrics: dict[str, Any], size: int) -> None:
    from gsut.training.tuning import FROM_START

    done = metrics["compaction"]
    way, steps = f"by {done['method']}", done["finetune_steps"]
    seconds = done["compact_seconds"] + done["finetune_seconds"]
    if done["method"] == FROM_START:
        way, steps, seconds = "from the start", metrics["steps"], metrics["train_seconds"]
    tuned = f", {steps} steps" if steps else ""
    print(
        f"{done['source_num_gaussians']:,} -> {metrics['num_gaussians']:,} Gaussians {way}{tuned} "
        f"in {seconds:.1f} s, {size / 1e6:.1f} MB"
    )
    if done["harmonics_degrees"]:
        counts = enumerate(done["harmonics_degrees"])
        print("harmonics: " + ", ".join(f"{count:,} of degree {d}" for d, count in counts))
    if metrics["psnr"] is not None:
        before = done["source_psnr"]
        was = ""
        if before is not None:
            change = metrics["psnr"] - before
            was = f" ({'gains' if change > 0 else 'loses'} {abs(change):.2f} dB)"
        print(
            f"PSNR {metrics['psnr']:.2f} dB{was}, SSIM {metrics['ssim']:.4f}, "
            f"{metrics['render_ms']:.1f} ms a view"
        )
