"""The flags of `gsut bench ...`; what they do stands in command.py, imported when it is called.

A new benchmark is one more function `_add_...` in `add_bench` and one more in command.py.
"""

from __future__ import annotations

import argparse
from typing import Any


def add_bench(parser: argparse.ArgumentParser) -> None:
    """Adds the benchmarks to a parser."""
    benchmarks = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    _add_render(benchmarks)
    _add_train(benchmarks)
    _add_compact(benchmarks)
    _add_poses(benchmarks)
    _add_projection(benchmarks)
    _add_refine(benchmarks)


def _command(name: str):
    """A benchmark's function out of gsut.bench.command, which is imported only when called."""

    def run(arguments: argparse.Namespace) -> int:
        from gsut.bench import command

        return getattr(command, name)(arguments)

    return run


def _add_render(benchmarks: Any) -> None:
    parser = benchmarks.add_parser(
        "render",
        help="forward, backward and training step, against the double reference and a scalar "
        "baseline",
        description="Times the renderer and a training step on scenes made from a seed, beside "
        "their errors against the double-precision reference and the times of a plain scalar "
        "renderer. A result that is wrong (image rms above 1e-5, gradients above 1e-4, relative) "
        "prints no time.",
    )
    parser.add_argument(
        "--scenes",
        metavar="A,B",
        help="synthetic_100k_640x480, synthetic_1m_1920x1080, peer_10k_480x480, "
        "peer_100k_480x480, rolling_shutter_100k_640x480, or alike with other numbers; trained "
        "[default: all but the third and the last]",
    )
    parser.add_argument("--isa", metavar="A,B", help="instruction sets [default: all there are]")
    parser.add_argument(
        "--threads", default="0", metavar="N,M", help="numbers of threads; 0 = all [default 0]"
    )
    parser.add_argument(
        "--repeats", type=int, default=20, metavar="N",
        help="most runs of each measurement, of which the shortest counts [default 20]",
    )  # fmt: skip
    parser.add_argument(
        "--scalar-repeats", type=int, default=2, metavar="N",
        help="runs of the scalar baseline; 0 leaves it out [default 2]",
    )  # fmt: skip
    parser.add_argument(
        "--steps", type=int, metavar="N",
        help="training steps timed; 0 leaves them out [default 10; with --scale 5]",
    )  # fmt: skip
    parser.add_argument(
        "--tiles", type=int, default=32, metavar="N",
        help="16 x 16 tiles on which errors are measured, drawn at random [default 32]",
    )  # fmt: skip
    parser.add_argument("--ply", metavar="FILE", help="Gaussians of the scene trained")
    parser.add_argument(
        "--data", metavar="DATA",
        help="dataset of the scene trained [default: the demo scene, trained shortly]",
    )  # fmt: skip
    parser.add_argument(
        "--scale",
        action="store_true",
        help="measure time and memory over numbers of Gaussians and image sizes instead",
    )
    parser.add_argument(
        "--counts", metavar="N,M", help="with --scale: Gaussians [default 10k,100k,1m]"
    )
    parser.add_argument(
        "--megapixels", metavar="X,Y", help="with --scale: image sizes [default 0.1,0.3,1,2,8]"
    )
    _add_files(
        parser,
        "speed against error of the first scene with one knob turned at a time; with --scale time "
        "and memory",
    )
    parser.set_defaults(run=_command("render"))


def _add_train(benchmarks: Any) -> None:
    parser = benchmarks.add_parser(
        "train",
        help="held-out PSNR against seconds of each preset",
        description="Trains with each preset and measures held-out PSNR on the way. Seconds "
        "count from the reading of the dataset on; measuring does not count.",
    )
    parser.add_argument("data", metavar="DATA", help="dataset with held-out views")
    parser.add_argument(
        "--preset", metavar="A,B", help="presets [default: fast,balanced,best]", dest="presets"
    )
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="0 = all [default 0]")
    parser.add_argument(
        "--scale", type=float, default=1.0, metavar="X",
        help="size of the images used, of the originals' [default 1]",
    )  # fmt: skip
    parser.add_argument(
        "--steps", type=int, metavar="N", help="training steps instead of the preset's"
    )
    parser.add_argument(
        "--measurements", type=int, default=12, metavar="N",
        help="points of each curve [default 12]",
    )  # fmt: skip
    _add_files(parser, "PSNR against seconds")
    parser.set_defaults(run=_command("train"))


def _add_poses(benchmarks: Any) -> None:
    parser = benchmarks.add_parser(
        "poses",
        help="seconds of gsut poses beside its errors against a dataset's own poses",
        description="Estimates the poses of datasets that have some, and compares them after the "
        "best similarity. Where the dataset's poses are COLMAP's, that is agreement, not truth. "
        "Seconds of the processor (CPU-s) count all threads and hardly feel other work on the "
        "machine.",
    )
    parser.add_argument(
        "data", metavar="DATA", nargs="+", help="datasets with poses, or folders of images"
    )
    parser.add_argument(
        "--lens", metavar="A,B", default="known", dest="lenses",
        help="known, unknown or both [default known]",
    )  # fmt: skip
    parser.add_argument(
        "--rig", metavar="RIG",
        help="the true rig of DATA, whose poses are in its unit: scale and poses with it, without "
        "it, and with it disturbed by 0.5 degrees and 1 %% of its baseline",
    )  # fmt: skip
    parser.add_argument(
        "--shutter", metavar="A,B", default="auto", dest="shutters",
        help="auto, global or rolling; global beside a rolling data set gets errors let through "
        "as large as the motion makes them [default auto]",
    )  # fmt: skip
    parser.add_argument(
        "--pycolmap", metavar="PYTHON",
        help="a Python that has pycolmap: its incremental mapping, in the same table",
    )  # fmt: skip
    parser.add_argument(
        "--programs", metavar="A,B", default="gsut,pycolmap",
        help="gsut, pycolmap or both [default both, if --pycolmap is given]",
    )  # fmt: skip
    parser.add_argument(
        "--train", type=int, default=0, metavar="STEPS",
        help="train on the poses found and tell the PSNR of every eighth image, which needs no "
        "reference [default 0: do not]",
    )  # fmt: skip
    parser.add_argument(
        "--train-scale", type=float, default=0.5, metavar="X",
        help="with --train: size of the images, of the originals' [default 0.5]",
    )  # fmt: skip
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="0 = all [default 0]")
    parser.add_argument("--json", metavar="FILE", help="write the rows as JSON, after each row")
    parser.add_argument(
        "--resume", action="store_true", help="keep the rows that the --json file holds already"
    )
    parser.add_argument("--csv", metavar="FILE", help="write the rows as CSV")
    parser.set_defaults(run=_command("poses"), plot=None)


def _add_compact(benchmarks: Any) -> None:
    parser = benchmarks.add_parser(
        "compact",
        help="quality, size and speed of each method of compaction",
        description="Compacts finished runs with every method, with and without fine-tuning, and "
        "trains a model with as many Gaussians from the start in the same total time.",
    )
    parser.add_argument(
        "runs", metavar="RUN", nargs="+", help="finished runs of gsut train; with --start, datasets"
    )
    parser.add_argument(
        "--start", metavar="A,B", default="",
        help="train these models of the datasets first: mcmc (up to --cap), adc (adaptive density "
        "control as published, without a cap), lean (up to --lean)",
    )  # fmt: skip
    parser.add_argument("--folder", metavar="DIR", help="that holds, or gets, the starts' runs")
    parser.add_argument("--start-steps", type=int, default=1500, metavar="N", help="[default 1500]")
    parser.add_argument("--cap", type=int, default=500_000, metavar="N", help="[default 500000]")
    parser.add_argument("--lean", type=int, default=100_000, metavar="N", help="[default 100000]")
    parser.add_argument(
        "--scale", type=float, default=1.0, metavar="X", help="of the datasets' images [default 1]"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="keep the rows that the --json file holds already, but those of these runs with other "
        "settings; rows of other runs are printed and drawn, too",
    )
    parser.add_argument("--methods", metavar="A,B", help="[default: all of gsut compact]")
    parser.add_argument(
        "--keep", metavar="X,Y", default="", help="fractions [default 0.05,0.1,0.2,0.5]"
    )
    parser.add_argument(
        "--finetune", type=int, default=500, metavar="STEPS", help="[default 500]"
    )  # fmt: skip
    parser.add_argument(
        "--no-rival", action="store_true", help="do not train models that small from the start"
    )
    _add_files(parser, "PSNR against Gaussians and render time")
    parser.set_defaults(run=_command("compact"))


def _add_projection(benchmarks: Any) -> None:
    parser = benchmarks.add_parser(
        "projection",
        help="every lens x method of projection x size x field angle: ns beside errors",
        description="Times each method of projecting Gaussians, beside the errors of centre and "
        "covariance against quadrature in double, and the share of alpha that falls outside the "
        "method's box, on every lens, four sizes and four rings of the field angle.",
    )
    parser.add_argument("--lenses", metavar="A,B", help="models [default: all]")
    parser.add_argument(
        "--samples", type=int, default=6, metavar="N",
        help="Gaussians a cell whose errors are measured [default 6]",
    )  # fmt: skip
    parser.add_argument(
        "--no-million", action="store_true",
        help="leave out the unscented projection of a million Gaussians",
    )  # fmt: skip
    parser.add_argument("--json", metavar="FILE", help="write the rows as JSON")
    parser.add_argument("--csv", metavar="FILE", help="write the rows as CSV")
    parser.add_argument("--plots", metavar="FOLDER", help="draw one picture a lens (svg) there")
    parser.set_defaults(run=_command("projection"), plot=None)


def _add_refine(benchmarks: Any) -> None:
    parser = benchmarks.add_parser(
        "refine",
        help="disturbed poses and lens, and how far training brings them back",
        description="Puts the poses of a dataset off by 0.5 degrees and 2 cm (small) and by 2 "
        "degrees and 8 cm (large), and its lens by 2 % of the focal length and 20 % of the first "
        "coefficient (lens); trains with the truth, and each with and without refinement; prints "
        "what is left against the truth after the best similarity.",
    )
    parser.add_argument("data", metavar="DATA", help="dataset whose poses and lens are the truth")
    parser.add_argument("--cases", metavar="A,B", help="of small, large, lens [default: all]")
    parser.add_argument("--steps", type=int, default=1000, metavar="N", help="[default 1000]")
    parser.add_argument("--gaussians", type=int, default=50_000, metavar="N", help="[50000]")
    parser.add_argument("--scale", type=float, default=1.0, metavar="X", help="of the images [1]")
    parser.add_argument("--threads", type=int, default=0, metavar="N", help="0: all")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="[default 0]")
    parser.add_argument(
        "--jitter", type=float, default=0.02, metavar="X",
        help="the dataset's points are moved by so much first, one sigma [default 0.02]",
    )  # fmt: skip
    parser.add_argument(
        "--no-tracks", action="store_true", help="refine against the Gaussians alone"
    )
    parser.add_argument(
        "--basin", metavar="X,Y", help="degrees of the disturbances [0.5,1,2,4,8,16,32]"
    )
    parser.add_argument("--no-basin", action="store_true", help="leave the basin out")
    parser.add_argument(
        "--resume", action="store_true",
        help="keep the rows of --json FILE that were made with the same settings",
    )  # fmt: skip
    _add_files(parser, "the share of poses that come back against the disturbance")
    parser.set_defaults(run=_command("refine"))


def _add_files(parser: argparse.ArgumentParser, plot: str) -> None:
    parser.add_argument("--json", metavar="FILE", help="write the rows as JSON")
    parser.add_argument("--csv", metavar="FILE", help="write the rows as CSV")
    parser.add_argument("--plot", metavar="FILE", help=f"draw (svg, png or pdf) {plot}")
