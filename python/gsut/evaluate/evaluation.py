"""Figures and pictures of a trained scene on views of a dataset."""

from __future__ import annotations

import concurrent.futures
import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut import _core
from gsut.bounds import name_wrong_kinds
from gsut.evaluate.detail import measure_details
from gsut.evaluate.unseen import find_unseen
from gsut.gaussians import OPAQUE
from gsut.metrics import (
    RING_EDGES_DEGREES,
    Ring,
    color_corrected_psnr,
    psnr,
    ring_psnr,
)
from gsut.orientation import turn_picture
from gsut.render import (
    Light,
    compute_field_angles,
    name_pictures,
    render,
    to_uint8,
    write_png,
)
from gsut.run import TrainOptions, measure_peak_rss

# Of a view, and their means over the views.
FIGURES = (
    "psnr", "ssim", "detail", "unseen", "moving", "psnr_unit_gain", "psnr_color_corrected",
)  # fmt: skip
_DETAILS = "detail", "detail_shifted", "wrong_patch", "detail_outside"  # by `measure_details`
# Called with a view, width and height; returns (height, width) bool, or None if nothing moved.
FindMoving = Callable[[int, int, int], np.ndarray | None]


@name_wrong_kinds
def evaluate(
    gaussians: Any,
    scene: Any,
    indices: Sequence[int],
    *,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    light: Light | None = None,
    find_moving: FindMoving | None = None,
    render_folder: Path | None = None,
    on_view: Callable[[int, int], None] | None = None,
    keep_patches: bool = False,
) -> dict[str, Any]:
    """Renders views of a scene and compares them with their photographs, inside their masks.

    Args:
        gaussians: the Gaussians, in the scene's coordinates.
        scene: a dataset, from `load_dataset`.
        indices: which of `scene.views`.
        background: colour behind the Gaussians, 3 values in [0, 1]; None: see `render`.
        light: exposure of the views and falloff of the cameras, by which renders are multiplied
            before they are compared; None: 1.
        find_moving: returns what moved in a view; None: nothing did.
        render_folder: an existing folder that gets NAME_truth.png and NAME_render.png (8 bit,
            masked pixels black) and NAME_depth.png (16 bit; distance = value x `depth_unit` of the
            view's row, 0 = less than half opaque); None writes nothing.
        on_view: called with (views done, views in all) after each.
        keep_patches: add to a view's row "wrong_patch", the pixels of "patch" as an array, which is
            not ready for JSON.

    Returns:
        dict, ready for JSON:
            psnr, ssim: means over the views (PSNR in dB); None if no view. In the photographs'
                light: this is what is scored.
            detail: share of the photographs' detail that renders show in the right place, where
                some training view could see what is there and nothing moved.
            patch: of a view: share of the picture that a connected patch takes in which far less
                detail is right than in the whole; 0: there is none.
            detail_outside: of a view: detail outside that patch.
            unseen: share of the pixels that show what no training view could see.
            moving: share of the pixels that show what moved.
            detail_median, detail_min, least_detailed: of the views: median and least, and the
                name of the view that has the least; absent if no view.
            detail_shifted_median: median of the detail that is right after each render is shifted
                as a whole, as wrong poses and lenses need; absent if no view.
            psnr_unit_gain: PSNR of the renders as they are shown, without `light`.
            psnr_color_corrected: PSNR after the affine map of colours that fits best.
            psnr_min, worst_view: the least PSNR and its view's name.
            render_ms: median time of one render in milliseconds.
            rings: list of dict from_degrees, to_degrees, psnr (mean over the views that have
                pixels there; None if none has), pixels (of all views).
            views: list of dict name, the figures above, render_ms, pixels, and with
                `render_folder` truth, render, depth (file names) and depth_unit.

        Renders are clipped to [0, 1] but not rounded to 8 bits before they are compared.
    """
    stems = name_pictures([scene.views[index].name for index in indices])
    threads = _core.num_threads()
    rows: list[tuple[dict[str, Any], list[Ring]]] = []

    def compare(index: int, stem: str, rendered: Any, milliseconds: float) -> Any:
        camera = scene.camera(index)
        moving = find_moving and find_moving(index, camera.width, camera.height)
        return _compare(scene, index, rendered, light, milliseconds, render_folder, stem, moving)

    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        for first in range(0, len(indices), threads):
            some = list(indices[first : first + threads])
            drawn = [_render_alone(scene, index, gaussians, background) for index in some]
            stems_of = stems[first : first + threads]
            for row in pool.map(compare, some, stems_of, *zip(*drawn, strict=True)):
                rows.append(row)
                if on_view is not None:
                    on_view(len(rows), len(stems))
    views = [row for row, _ in rows]
    for row in views:
        row["patch"] = float(row["wrong_patch"].mean())
        if not keep_patches:
            del row["wrong_patch"]
    worst = min(views, key=lambda row: row["psnr"], default=None)
    return {
        **{name: _mean(row[name] for row in views) for name in FIGURES},
        "psnr_min": worst["psnr"] if worst else None,
        "worst_view": worst["name"] if worst else None,
        **_summarize_detail(views),
        "render_ms": statistics.median(row["render_ms"] for row in views) if views else None,
        "rings": _join_rings([rings for _, rings in rows]),
        "views": views,
    }


def _summarize_detail(views: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarizes the detail of views by their median and the view that shows the least."""
    if not views:
        return {}
    least = min(views, key=lambda row: row["detail"])
    return {
        "detail_median": statistics.median(row["detail"] for row in views),
        "detail_shifted_median": statistics.median(row["detail_shifted"] for row in views),
        "detail_min": least["detail"],
        "least_detailed": least["name"],
    }


def _render_alone(
    scene: Any,
    index: int,
    gaussians: Any,
    background: Sequence[float] | None,
) -> tuple[Any, float]:
    """Renders a view while nothing else runs, and measures the milliseconds."""
    view, camera = scene.views[index], scene.camera(index)
    started = time.perf_counter()
    rendered = render(gaussians, camera, view.motion, background=background)
    return rendered, 1e3 * (time.perf_counter() - started)


def _compare(
    scene: Any,
    index: int,
    rendered: Any,
    light: Light | None,
    milliseconds: float,
    render_folder: Path | None,
    stem: str,
    moving: np.ndarray | None,
) -> tuple[dict[str, Any], list[Ring]]:
    """Compares a render with its photograph: the view's row and its rings, see `evaluate`."""
    view, camera, mask = scene.views[index], scene.camera(index), scene.mask(index)
    photograph = scene.image(index)
    truth = photograph.astype(np.float32) / np.float32(255)
    plain = image = np.clip(rendered.image, 0.0, 1.0)
    if light is not None:
        lit = rendered.image * light.on(camera, index, view.camera_index)
        image = np.clip(lit, 0.0, 1.0)

    def select_pixels(picture: np.ndarray) -> np.ndarray:
        """Selects the pixels (1, N, 3) inside the mask in double, once for all figures."""
        return picture[mask].astype(np.float64)[None]

    seen, bare = select_pixels(truth), select_pixels(plain)
    shown = bare if light is None else select_pixels(image)
    unseen = find_unseen(scene, index, rendered) & mask
    moving = np.zeros_like(mask) if moving is None else moving & mask
    judged, count = mask & ~unseen & ~moving, max(1, mask.sum())
    row = {
        "name": view.name,
        "psnr": psnr(shown, seen),
        "ssim": _ssim(photograph, image, mask),
        **dict(zip(_DETAILS, measure_details(photograph, image, judged), strict=True)),
        "unseen": float(unseen.sum() / count),
        "moving": float(moving.sum() / count),
        "psnr_unit_gain": psnr(bare, seen),
        "psnr_color_corrected": color_corrected_psnr(bare, seen),
        "render_ms": milliseconds,
        "pixels": seen.shape[1],
    }
    rings = ring_psnr(shown, seen, compute_field_angles(camera)[mask][None])
    if render_folder is not None:
        row |= _write_pictures(render_folder, stem, photograph, image, mask, rendered, view.turns)
    return row, rings


def _ssim(photograph: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Computes SSIM with the loss' kernel, which agrees to 1e-7 in a fifth of the time."""
    target = _core.PhotometricTarget(photograph, mask, "valid", False)
    return 1.0 - target.value(np.ascontiguousarray(image, np.float32), 1.0)[2]


def run_metrics(
    evaluation: dict[str, Any],
    gaussians: Any,
    scene: Any,
    options: TrainOptions,
    *,
    steps: int,
    train_seconds: float,
) -> dict[str, Any]:
    """Collects the content of metrics.json: an evaluation together with what training cost.

    Args:
        evaluation: from `evaluate`.
        gaussians: gsut.Gaussians.
        scene: gsut.Scene.
        options: of the run.
        steps: training steps done.
        train_seconds: wall time of the steps, without reading data and evaluating.
    """
    return {
        "psnr": evaluation["psnr"],
        "ssim": evaluation["ssim"],
        "num_gaussians": len(gaussians),
        "sh_degree": gaussians.sh_degree,
        "steps": steps,
        "train_seconds": train_seconds,
        "seconds_per_step": train_seconds / steps if steps else None,
        "render_ms": evaluation["render_ms"],
        "peak_rss_mb": measure_peak_rss(),
        "camera_model": ", ".join(sorted({camera.model for camera in scene.cameras})),
        "image_size": sorted({(camera.width, camera.height) for camera in scene.cameras}),
        "threads": _core.num_threads(),
        "isa": _core.active_isa(),
        "seed": options.seed,
        "version": _core.__version__,
        "dataset": scene.path.resolve().name,
        "world_offset": [float(value) for value in scene.world_offset],
        "train_views": len(scene.train_indices),
        "test_views": [scene.views[index].name for index in scene.test_indices],
        "notes": list(scene.notes),
        **evaluation,
    }


def _write_pictures(
    folder: Path,
    stem: str,
    photograph: np.ndarray,
    image: np.ndarray,
    mask: np.ndarray,
    rendered: Any,
    turns: int,
) -> dict[str, Any]:
    """Writes truth, render and depth, upright; returns their names and the depth's unit."""
    alpha = np.asarray(rendered.alpha, np.float64)
    shown = mask & (alpha >= OPAQUE)
    distance = np.where(shown, rendered.depth / np.where(shown, alpha, 1.0), 0.0)
    unit = float(distance.max()) / np.iinfo(np.uint16).max or 1.0
    pictures = {
        "truth": photograph * mask[..., None],
        "render": to_uint8(image) * mask[..., None],
        "depth": np.rint(distance / unit).astype(np.uint16),
    }
    for kind, picture in pictures.items():
        write_png(folder / f"{stem}_{kind}.png", turn_picture(picture, turns))
    return {kind: f"{stem}_{kind}.png" for kind in pictures} | {"depth_unit": unit}


def _join_rings(of_views: list[list[Ring]]) -> list[dict[str, Any]]:
    """Joins the rings of all views into one row each."""
    joined = []
    for low, high in itertools.pairwise(RING_EDGES_DEGREES):
        rows = [
            row
            for rows in of_views
            for row in rows
            if row["from_degrees"] == low and row["to_degrees"] == high and row["pixels"] > 0
        ]
        joined.append(
            {
                "from_degrees": low,
                "to_degrees": high,
                "psnr": _mean(row["psnr"] for row in rows),
                "pixels": int(sum(row["pixels"] for row in rows)),
            }
        )
    return joined


def _mean(values: Any) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
