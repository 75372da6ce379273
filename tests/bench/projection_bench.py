"""`./run bench projection`: time and error of each way to project a Gaussian, by lens and size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.gaussians import Gaussians
from gsut.render import DEFAULT_UNSCENTED, METHODS
from tests.bench.harness import Benchmark, Column, Option, Row, Settings
from tests.bench.projection_truth import compute_alphas, compute_moments, find_periods

# Standard deviation over the distance, and the ratio of the longest axis to the others.
SIZES = {"small": (0.003, 1.0), "medium": (0.02, 1.0), "large": (0.1, 1.0), "needle": (0.06, 30.0)}
# Rings of the field angle, shares of the widest angle of a pixel's ray; of a lens of parallel rays,
# of the distance from the axis.
RINGS = ((0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.0))
_TIMED = 8192  # Gaussians of a timing; enough that the call itself does not count
_ALPHA_MIN = 1.0 / 255.0  # below which a Gaussian is not drawn
_OPACITY_LOGIT = 2.0


def list_cases(settings: Settings) -> Iterator[Row]:
    """Lists lenses, sizes and methods."""
    known = _core.camera_models()
    for lens in settings.lenses:
        if lens not in known:
            raise InputError(f'--lenses: "{lens}" is unknown; known: {", ".join(known)}')
        for size in settings.sizes:
            for method in METHODS:
                yield {"lens": lens, "size": size, "method": method}


def measure(case: Row, settings: Settings) -> Row:
    """Projects Gaussians in all rings; errors are medians against quadrature in double."""
    camera = make_example_camera(case["lens"], settings.width)
    periods = find_periods(camera)
    rng = np.random.default_rng(0)
    seconds, off, spread, missed, loose = [], [], [], [], []
    for ring in RINGS:
        gaussians = place_gaussians(camera, case["size"], ring, _TIMED, rng)
        if gaussians is None:
            continue
        few = gaussians[: settings.samples].to_dtype(np.float64)
        centers, covariances = compute_moments(few, camera)
        alphas = compute_alphas(few, camera, _ALPHA_MIN)
        footprinter = _core.Footprinter(
            METHODS.index(case["method"]), DEFAULT_UNSCENTED, _ALPHA_MIN
        )
        _core.set_num_threads(1)
        times = [
            footprinter.find(gaussians, camera, np.eye(4))[1] for _ in range(1 + settings.runs)
        ]
        _core.set_num_threads(0)
        seconds.append(min(times[1:]) / len(gaussians))
        found = footprinter.arrays()
        picked = slice(0, settings.samples)
        away = found["centers"][picked].astype(np.float64) - centers
        away -= periods * np.round(away / periods)
        off += list(np.linalg.norm(away, axis=1))
        wrong = found["covariances"][picked].astype(np.float64) - covariances
        scale = np.linalg.norm(covariances, axis=(1, 2))
        spread += list(np.linalg.norm(wrong, axis=(1, 2)) / scale)
        outside, ratio = _measure_boxes(alphas, found["boxes"][picked], periods)
        missed.append(outside)
        loose.append(ratio)
    return {
        "ns_per_gaussian": 1e9 * float(np.median(seconds)),
        "center_px": _find_median(off),
        "covariance": _find_median(spread),
        "alpha_missed": max((share for share in missed if share is not None), default=None),
        "box_over_true": _find_median([ratio for ratio in loose if ratio is not None]),
    }


def _find_median(values: list[float]) -> float | None:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.median(finite)) if finite else None


def make_example_camera(name: str, width: int) -> _core.Camera:
    """Makes the first example of a lens; three times as wide if it sees behind itself."""
    _, params, full_width, full_height = _core.camera_examples(name)[0]
    whole = _core.Camera(name, params, full_width, full_height)
    if _find_widest_angle(whole.resize(32, max(1, 32 * full_height // full_width))) > 2.0:
        width *= 3
    return whole.resize(width, max(1, round(full_height * width / full_width)))


def _find_widest_angle(camera: _core.Camera) -> float:
    rays, valid = camera.rays()
    return float(np.arccos(np.clip(rays[valid][:, 2].min(), -1, 1)))


def place_gaussians(
    camera: _core.Camera,
    size: str,
    ring: tuple[float, float],
    count: int,
    rng: np.random.Generator,
) -> Gaussians | None:
    """Places Gaussians of one size on rays of pixels in one ring; None if the ring has no pixel."""
    rays, valid = camera.rays()
    candidates, origins = rays[valid], camera.origins()[valid]
    if camera.is_parallel:
        off_axis = np.linalg.norm(origins[:, :2], axis=1)
        share = off_axis / off_axis.max()
    else:
        share = np.arccos(np.clip(candidates[:, 2], -1, 1)) / _find_widest_angle(camera)
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


def _measure_boxes(
    alphas: np.ndarray, boxes: np.ndarray, periods: np.ndarray
) -> tuple[float | None, float | None]:
    """Returns the share of alpha outside the boxes, and the median area of box over true box."""
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


BENCHMARK = Benchmark(
    help="each way to project a Gaussian: ns beside the errors of centre, covariance and box",
    columns=(
        Column("lens"),
        Column("size"),
        Column("method"),
        Column("ns_per_gaussian", "a Gaussian", "ns", ".0f"),
        Column("center_px", "centre off", "px", ".1e"),
        Column("covariance", "covariance off", form=".1e"),
        Column("alpha_missed", "alpha outside the box", form=".1e"),
        Column("box_over_true", "box over true box", form=".2f"),
    ),
    cases=list_cases,
    measure=measure,
    options=(
        Option("lenses", ("kannala_brandt",), "models"),
        Option("sizes", tuple(SIZES), "of the Gaussians"),
        Option("width", 128, "of the images, pixels"),
        Option("samples", 6, "Gaussians of each ring with errors"),
        Option("runs", 3, "timings, of which the shortest counts"),
    ),
)
