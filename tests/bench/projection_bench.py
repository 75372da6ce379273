"""Speed against error of every way to project a Gaussian, for every lens, size and field angle."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians
from gsut.render import METHODS
from gsut.run import add_option_flags, check_options, describe_options, given_options, option
from tests.bench.projection_truth import alpha_images, periods, projected_moments
from tests.bench.report_rows import (
    MEASURED,
    add_files,
    bar,
    check_files,
    print_and_write,
    write_json,
)

# (name, method of the core, alpha beta kappa)
BENCH_METHODS: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("ewa", "ewa", (1.0, 2.0, 0.0)),
    ("unscented alpha 1", "unscented", (1.0, 2.0, 0.0)),
    ("unscented alpha 0.1", "unscented", (0.1, 2.0, 0.0)),
    ("simplex", "simplex", (1.0, 2.0, 0.0)),
    ("cubature", "cubature", (1.0, 2.0, 0.0)),
    ("gauss_hermite", "gauss_hermite", (1.0, 2.0, 0.0)),
    ("silhouette", "silhouette", (1.0, 2.0, 0.0)),
)
# Standard deviation over the distance, and the ratio of the longest axis to the others.
SIZES = {"small": (0.003, 1.0), "medium": (0.02, 1.0), "large": (0.1, 1.0), "needle": (0.06, 30.0)}
# Rings of the field angle, shares of the widest angle of a pixel's ray; of a lens of parallel rays,
# of the distance from the axis.
RINGS = ((0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.0))
# Gaussians a timing; enough that the call itself does not count.
_TIMED = 8192
_ALPHA_MIN = 1.0 / 255.0
_OPACITY_LOGIT = 2.0
# gsplat's PyTorch reference for 1 M Gaussians on the machine of the project's benchmarks, CPU-s.
PEER_MILLION_CPU_SECONDS = 3.1

PROJECTION_COLUMNS = (
    ("lens", "lens", ""),
    ("method", "method", ""),
    ("size", "size", ""),
    ("ring", "ring", ""),
    ("ns", "ns_per_gaussian", ".1f"),
    ("centre px", "center_error_px", ".1e"),
    ("covariance", "covariance_relative_error", ".1e"),
    ("alpha missed", "alpha_missed", ".1e"),
    ("box / true", "box_over_true", ".2f"),
)


@describe_options
@dataclasses.dataclass(frozen=True)
class ProjectionBenchOptions:
    """What is measured.

    Raises:
        InputError: a value of the wrong kind or out of range.
    """

    lenses: tuple[str, ...] = option((), MEASURED, "models; none: all")
    width: int = option(128, MEASURED, "of the images; three times that for panoramas", low=16)
    samples: int = option(6, MEASURED, "Gaussians a cell (size x ring) with errors", low=1)
    repeats: int = option(3, MEASURED, "timings, of which the shortest counts", low=1)
    million: bool = option(True, MEASURED, "also time the projection of a million Gaussians")
    seed: int = option(0, MEASURED, "of the Gaussians", low=0)

    def __post_init__(self) -> None:
        check_options(self)


def bench_lenses(names: Sequence[str]) -> list[str]:
    """The models asked for, or all."""
    known = _core.camera_models()
    for name in names:
        if name not in known:
            raise InputError(f'--lenses: "{name}" is unknown; known: {", ".join(known)}')
    return list(names) or known


def projection_bench(
    options: ProjectionBenchOptions, on_progress: Callable[[str], None] = lambda text: None
) -> list[dict[str, Any]]:
    """One row for each lens x method x size x ring.

    Errors are medians over `samples` Gaussians, against quadrature in double (see
    projection_truth.py); `alpha_missed` is the share of the alpha that the image holds outside the
    box, `box_over_true` the box' area over the one of the pixels seen, median. A cell without an
    answer has null. Times are processor time of one thread, with the best instruction set.
    """
    threads = _core.num_threads()
    rows: list[dict[str, Any]] = []
    for name in bench_lenses(options.lenses):
        on_progress(name)
        camera = _example_camera(name, options.width)
        rng = np.random.default_rng(options.seed)
        for size in SIZES:
            for ring in RINGS:
                rows += _cell(name, camera, size, ring, rng, options)
    _core.set_num_threads(threads)
    return rows


def _example_camera(name: str, width: int) -> _core.Camera:
    _, params, full_width, full_height = _core.camera_examples(name)[0]
    whole = _core.Camera(name, params, full_width, full_height)
    if _widest_angle(whole.resized(32, max(1, 32 * full_height // full_width))) > 2.0:
        width *= 3
    return whole.resized(width, max(1, round(full_height * width / full_width)))


def _widest_angle(camera: _core.Camera) -> float:
    rays, valid = camera.rays()
    return float(np.arccos(np.clip(rays[valid][:, 2].min(), -1, 1)))


def _gaussians(
    camera: _core.Camera,
    size: str,
    ring: tuple[float, float],
    count: int,
    rng: np.random.Generator,
) -> Gaussians | None:
    """Gaussians of one size on rays of pixels in one ring; None if the ring has no pixel."""
    rays, valid = camera.rays()
    candidates, origins = rays[valid], camera.origins()[valid]
    if camera.is_parallel:
        off_axis = np.linalg.norm(origins[:, :2], axis=1)
        share = off_axis / off_axis.max()
    else:
        share = np.arccos(np.clip(candidates[:, 2], -1, 1)) / _widest_angle(camera)
    (in_ring,) = np.nonzero((share >= ring[0]) & (share <= ring[1]))
    if not len(in_ring):
        return None
    deviation, aspect = SIZES[size]
    distance = np.exp(rng.uniform(0.0, 1.5, count))
    picked = in_ring[rng.integers(len(in_ring), size=count)]
    means = origins[picked] + candidates[picked] * distance[:, None]
    log_scales = np.log(deviation * distance)[:, None] + rng.normal(0.0, 0.2, (count, 3))
    log_scales[:, 1:] -= np.log(aspect)
    return Gaussians(
        means, rng.normal(size=(count, 4)), log_scales, np.full(count, _OPACITY_LOGIT),
        np.zeros((count, 1, 3)),
    ).to_dtype(np.float32)  # fmt: skip


def _cell(
    lens: str,
    camera: _core.Camera,
    size: str,
    ring: tuple[float, float],
    rng: np.random.Generator,
    options: ProjectionBenchOptions,
) -> list[dict[str, Any]]:
    gaussians = _gaussians(camera, size, ring, _TIMED, rng)
    if gaussians is None:
        return []
    few = gaussians[: options.samples].to_dtype(np.float64)
    _core.set_num_threads(0)
    centers, covariances = projected_moments(few, camera)
    alphas = alpha_images(few, camera, _ALPHA_MIN)
    _core.set_num_threads(1)
    rows = []
    for name, method, unscented in BENCH_METHODS:
        footprinter = _core.Footprinter(METHODS.index(method), unscented, _ALPHA_MIN)
        footprinter.find(gaussians, camera, np.eye(4))
        seconds = min(
            footprinter.find(gaussians, camera, np.eye(4))[1] for _ in range(options.repeats)
        )
        found = footprinter.arrays()
        picked = slice(0, options.samples)
        off = found["centers"][picked].astype(np.float64) - centers
        off -= periods(camera) * np.round(off / periods(camera))
        center = np.linalg.norm(off, axis=1)
        covariance = np.linalg.norm(
            found["covariances"][picked].astype(np.float64) - covariances, axis=(1, 2)
        ) / np.linalg.norm(covariances, axis=(1, 2))
        missed, loose = _box_quality(alphas, found["boxes"][picked], periods(camera))
        rows.append({
            "lens": lens, "method": name, "size": size, "ring": f"{ring[0]:g}-{ring[1]:g}",
            "ns_per_gaussian": 1e9 * seconds / len(gaussians),
            "center_error_px": _median(center),
            "covariance_relative_error": _median(covariance),
            "alpha_missed": missed, "box_over_true": loose,
            "isa": _core.active_isa(), "width": camera.width, "height": camera.height,
        })  # fmt: skip
    return rows


def _median(values: np.ndarray) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else None


def _box_quality(
    alphas: np.ndarray, boxes: np.ndarray, periods: np.ndarray
) -> tuple[float | None, float | None]:
    """Share of all alpha outside the boxes, and the median area of box over true box."""
    height, width = alphas.shape[1:]
    inside = []
    for axis, length in ((0, width), (1, height)):
        place = np.arange(length) + 0.5
        held = np.zeros((len(boxes), length), bool)
        for copy in (-1, 0, 1):
            shifted = place + copy * periods[axis]
            held |= (shifted >= boxes[:, axis, None]) & (shifted <= boxes[:, axis + 2, None])
        inside.append(held)
    held = inside[1][:, :, None] & inside[0][:, None, :]
    total = alphas.sum()
    if not total > 0:
        return None, None
    true_area = np.any(alphas > 0, axis=1).sum(axis=1) * np.any(alphas > 0, axis=2).sum(axis=1)
    seen = true_area > 0
    ratio = held.sum(axis=(1, 2))[seen] / true_area[seen]
    return float(alphas[~held].sum() / total), float(np.median(ratio))


def million_row(repeats: int = 5) -> dict[str, Any]:
    """Processor seconds of the unscented projection of a million Gaussians, all threads."""
    from tests.bench.scenes import make_scene

    scene = make_scene("synthetic_1m_1920x1080")
    footprinter = _core.Footprinter(METHODS.index("unscented"), (1.0, 2.0, 0.0), _ALPHA_MIN)
    times = [
        footprinter.find(scene.gaussians, scene.camera, scene.camera_from_world)
        for _ in range(1 + repeats)
    ][1:]
    cpu = min(cpu for _, cpu in times)
    return {
        "name": "unscented_1m", "num_gaussians": len(scene.gaussians), "cpu_seconds": cpu,
        "wall_seconds": min(wall for wall, _ in times), "threads": _core.num_threads(),
        "isa": _core.active_isa(), "peer_cpu_seconds": PEER_MILLION_CPU_SECONDS,
        "peer_over_gsut": PEER_MILLION_CPU_SECONDS / cpu,
    }  # fmt: skip


# --- the command ----------------------------------------------------------------------------------

HELP = (
    "every lens x method of projection x size x field angle: ns a Gaussian, beside the errors of "
    "centre and covariance against quadrature in double and the alpha outside the method's box"
)


def add_flags(parser: argparse.ArgumentParser) -> None:
    add_option_flags(parser, ProjectionBenchOptions)
    parser.add_argument("--plots", metavar="FOLDER", help="draw one picture a lens (svg) there")
    add_files(parser)


def run(arguments: argparse.Namespace) -> int:
    from tests.bench.lens_cost import lens_cost_row
    from tests.bench.projection_plots import plot_projection

    check_files(arguments)
    if arguments.plots and not Path(arguments.plots).is_dir():
        raise InputError(f"--plots {arguments.plots}: there is no such folder; make it first")
    options = ProjectionBenchOptions(**given_options(ProjectionBenchOptions, arguments))
    with bar(len(bench_lenses(options.lenses))) as advance:
        rows = projection_bench(options, advance)
    print_and_write(rows, PROJECTION_COLUMNS, arguments)
    if options.million:
        row, cost = million_row(), lens_cost_row()
        print(
            f"processor time through a splined lens over a pinhole of the same image: forward and "
            f"backward {cost['ratio_forward_backward']:.3f}, forward {cost['ratio_forward']:.3f}, "
            f"projection {cost['ratio_project']:.2f}"
        )
        print(
            f"unscented projection of {row['num_gaussians']} Gaussians: {row['cpu_seconds']:.4f} "
            f"CPU-s; gsplat's PyTorch reference {row['peer_cpu_seconds']:g} CPU-s, "
            f"{row['peer_over_gsut']:.0f} times as much"
        )
        if arguments.json:
            write_json(arguments.json, [*rows, row, cost])
    if arguments.plots:
        plot_projection(arguments.plots, rows)
    return 0
