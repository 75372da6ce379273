"""`gsut bench`: speed beside error on this machine, of rendering a run and of training."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.cli import _bench_train
from gsut.cli._flags import add_json, add_run, print_json

HELP = "speed against error, on this machine"
DESCRIPTION = (
    "Measures speed and, beside it, error: against a double-precision reference or the held-out "
    "photographs, never speed alone."
)
# Largest error of a right image against the double reference; above it, no time is reported.
_IMAGE_RMS_BOUND = 1e-5
_GRADIENT_BOUND = 1e-4  # relative, of each parameter
_PIXELS = 256  # drawn at random, at which errors are measured
# Relative move of the rule's cut-offs that finds pixels where it jumps, which the last bit decides.
_JUMP = 1e-4
_BACKGROUND = (0.0, 0.0, 0.0)
_FORWARD = ("project", "records", "bin", "forward")
_BACKWARD = ("backward", "gradients")
_TINY = 1e-300
_PARAMETERS = ("means", "quats", "log_scales", "opacity_logits", "sh")


def add_flags(parser: argparse.ArgumentParser) -> None:
    benchmarks = parser.add_subparsers(title="benchmarks", metavar="BENCHMARK", required=True)
    added = benchmarks.add_parser(
        "render",
        help="forward and backward of a run's view, against the double reference",
        description="Times the renderer on the first held-out view of a run, beside its errors "
        "against the double-precision reference. A wrong result (image rms above 1e-5, gradients "
        "above 1e-4, relative) prints no time.",
    )
    add_run(added)
    added.add_argument(
        "--repeats", type=int, default=10, metavar="N", help="the shortest counts [default 10]"
    )
    added.add_argument("--threads", type=int, default=0, metavar="N", help="0 = all [default 0]")
    add_json(added)
    added.set_defaults(run=_render)
    added = benchmarks.add_parser(
        "train", help=_bench_train.HELP, description=_bench_train.DESCRIPTION
    )
    _bench_train.add_flags(added)
    added.set_defaults(run=_bench_train.run)


def _render(arguments: argparse.Namespace) -> int:
    from gsut.run import RunFolder
    from gsut.training import read_trained
    from gsut.training.first import center_on_cameras

    if arguments.repeats < 1:
        raise InputError(f"--repeats must be at least 1, found {arguments.repeats}")
    _, scene, gaussians = read_trained(RunFolder.open(arguments.folder), arguments.data)
    scene, gaussians = center_on_cameras(scene, gaussians)
    index = (scene.test_indices or scene.train_indices)[0]
    _core.set_num_threads(arguments.threads)
    row = {"view": scene.views[index].name, "num_gaussians": len(gaussians)}
    row |= _measure(gaussians, scene.camera(index), scene.views[index].motion, arguments.repeats)
    if arguments.json:
        print_json(row)
        return 0
    errors = (
        f"image rms {row['image_rms_error']:.1e}, gradients {row['gradient_relative_error']:.1e}"
    )
    if row["forward_ms"] is None:
        print(f"no times: {errors} against the double reference are out of bounds")
        return 0
    print(
        f"{row['view']}: {row['width']} x {row['height']}, {len(gaussians):,} Gaussians, "
        f"{row['isa']}, {row['threads']} threads: forward {row['forward_ms']:.1f} ms, backward "
        f"{row['backward_ms']:.1f} ms; {errors} against the double reference"
    )
    return 0


def _measure(gaussians: Any, camera: Any, place: Any, repeats: int) -> dict[str, Any]:
    """Times and errors of one view, see _render."""

    rng = np.random.default_rng(0)
    rule, degree = _core.BlendRule(), gaussians.sh_degree
    pixels = np.zeros((camera.height, camera.width), np.uint8)
    seen = np.flatnonzero(np.asarray(camera.rays()[1], bool))
    pixels.flat[rng.permutation(seen)[:_PIXELS]] = 1
    exact = gaussians.to_dtype(np.float64)

    def render_reference(factor: float) -> tuple[np.ndarray, np.ndarray]:
        moved = _core.BlendRule()
        for name in ("alpha_min", "transmittance_min", "response_min"):
            setattr(moved, name, factor * getattr(rule, name))
        job = _core.RenderJob(camera, place, rule=moved, background=_BACKGROUND, sh_degree=degree)
        image, _, _, blended, _ = _core.render_reference(exact, job, pixels)
        return image, blended

    truth, blended = render_reference(1.0)
    smooth = pixels.astype(bool)
    for factor in (1.0 - _JUMP, 1.0 + _JUMP):
        smooth &= render_reference(factor)[1] == blended
    weights = (rng.normal(size=truth.shape) * smooth[..., None]).astype(np.float32)
    wanted = _make_zeros(exact)
    job = _core.RenderJob(camera, place, rule=rule, background=_BACKGROUND, sh_degree=degree)
    _core.render_reference_backward(exact, job, weights.astype(np.float64), wanted, pixels=pixels)

    renderer, image = _core.Renderer(), np.zeros(truth.shape, np.float32)
    found, touched = _make_zeros(gaussians), np.zeros(len(gaussians), np.uint8)
    best: dict[str, float] = {}
    for _ in range(1 + repeats):  # the first warms up
        job = _core.RenderJob(camera, place, rule=rule, background=_BACKGROUND, sh_degree=degree)
        renderer.render(gaussians, job, image)
        renderer.backward(weights, found, touched, with_poses=False)
        for stage, (wall, _) in renderer.timings().items():
            best[stage] = min(wall, best.get(stage, np.inf))
    rms = float(np.sqrt(np.mean((image - truth)[smooth] ** 2)))
    sizes = {name: float(np.linalg.norm(getattr(wanted, name))) for name in _PARAMETERS}
    # Of round Gaussians it vanishes, as a difference of terms as large as the scales' gradient.
    sizes["quats"] = max(sizes["quats"], sizes["log_scales"])
    relative = max(
        float(np.linalg.norm(getattr(found, name) - getattr(wanted, name))) / max(size, _TINY)
        for name, size in sizes.items()
    )
    right = rms <= _IMAGE_RMS_BOUND and relative <= _GRADIENT_BOUND
    return {
        "width": camera.width,
        "height": camera.height,
        "isa": _core.active_isa(),
        "threads": _core.num_threads(),
        "forward_ms": 1e3 * sum(best[stage] for stage in _FORWARD) if right else None,
        "backward_ms": 1e3 * sum(best[stage] for stage in _BACKWARD) if right else None,
        "image_rms_error": rms,
        "gradient_relative_error": relative,
    }


def _make_zeros(gaussians: Any) -> Any:
    from gsut.gaussians import Gaussians

    return Gaussians(*(np.zeros_like(getattr(gaussians, name)) for name in _PARAMETERS))
