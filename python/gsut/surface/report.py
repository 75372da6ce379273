"""A page about a surface: photographs' views of the mesh, their depths, and where these err."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gsut._core import CameraMotion
from gsut.orientation import turn_picture
from gsut.page import (
    build_page,
    build_table,
    embed_picture,
    format_number,
    paint_values,
    render_template,
)
from gsut.surface.mesh import Mesh
from gsut.surface.shading import shade_mesh

_MOST_VIEWS = 6  # on the page
_MOST_WIDE = 380  # pixels of a picture
_FULL_ERROR = 0.05  # of the distance: the brightest colour
_GREY = 190  # level of pixels without a value
_OF_DEPTH = "Distances are along the rays, blue near to red far; grey: none."
_OF_ERROR = (
    f"Errors are black where there is none, bright from {100 * _FULL_ERROR:.0f} % of the distance "
    "on; grey: no depth, or no truth."
)
_DEPTH = """<h2>Depth</h2><p>{{ views }} views; by field angle: the median of AbsRel.</p>
{{ table(rows, heading) }}"""
_VIEW = """<h3>{{ name }}</h3>
<div class="plots" style="grid-template-columns: repeat({{ pictures | length }},
 minmax(0, {{ most_wide }}px))">
{%- for text, address in pictures %}<figure style="margin:0"><img src="{{ address }}" alt="">
<figcaption><small>{{ text }}</small></figcaption></figure>{% endfor %}</div>"""
_OF_MESH = "The mesh is lit from the camera: grey in front, blue from behind, white: nothing."


@dataclasses.dataclass(frozen=True)
class SurfaceView:
    """What a view shows of a surface.

    Attributes:
        name: of the photograph.
        camera, motion: as the depth was rendered.
        image: (H, W, 3) uint8.
        depth: (H, W) along the rays; not finite: none.
        truth: (H, W) likewise, or None.
        turns: quarter turns clockwise that show it upright.
    """

    name: str
    camera: Any
    motion: np.ndarray | CameraMotion
    image: np.ndarray
    depth: np.ndarray
    truth: np.ndarray | None = None
    turns: int = 0


def choose_views(indices: Sequence[int]) -> list[int]:
    """Chooses a few of many views for a page, spread evenly."""
    count = min(len(indices), _MOST_VIEWS)
    return [indices[(2 * k + 1) * len(indices) // (2 * count)] for k in range(count)]


def build_surface_page(
    title: str, views: Sequence[SurfaceView], mesh: Mesh | None, parts: Sequence[str] = ()
) -> str:
    """Builds a self-contained HTML page.

    Args:
        title: of the page.
        views: that are shown, see `choose_views`.
        mesh: shown as each view sees it, if given.
        parts: what stands before the pictures, such as `build_geometry_tables`.
    """
    shown = [_build_view(view, mesh) for view in views]
    judged = any(view.truth is not None for view in views)
    said = [_OF_DEPTH, _OF_ERROR * judged, _OF_MESH * (mesh is not None)]
    words = render_template("<h2>Views</h2><p>{{ said | join(' ') }}</p>", said=said)
    return build_page(title, [], [*parts, words, *shown])


def build_geometry_tables(figures: dict[str, Any]) -> list[str]:
    """Builds tables of what `judge_geometry` found, as parts of a page."""
    parts = []
    depth = {kind: row for kind, row in figures.get("depth", {}).items() if kind != "views"}
    if depth:
        rings = next(iter(depth.values()))["rings"]
        heading = [
            "depth", "AbsRel [%]", "its median", "RMSE", "RMSE of log", "δ < 1.25 [%]",
            "pixels [%]", *(f"{r['from_degrees']:.0f}° to {r['to_degrees']:.0f}°" for r in rings),
        ]  # fmt: skip
        rows = [
            [
                kind, _format_percent(row["abs_rel"]), _format_percent(row["abs_rel_median"]),
                format_number(row["rmse"], 4), format_number(row["rmse_log"], 4),
                _format_percent(row["delta1"]), _format_percent(row["coverage"]),
                *(_format_percent(ring["abs_rel_median"]) for ring in row["rings"]),
            ]
            for kind, row in depth.items()
        ]  # fmt: skip
        views = figures["depth"]["views"]
        parts.append(render_template(_DEPTH, views=views, rows=rows, heading=heading))
    if mesh := figures.get("mesh"):
        names = ("accuracy", "completeness", "chamfer", "normal_consistency")
        rows = [[name.replace("_", " "), format_number(mesh[name], 4)] for name in names]
        scores = [
            [f"{row['distance']:g}", *(format_number(row[n], 3) for n in _SCORES)]
            for row in mesh["fscores"]
        ]
        heading = ["at a distance of", *(name.replace("fscore", "F-score") for name in _SCORES)]
        title = render_template("<h2>Mesh</h2>")
        parts += [title, build_table(rows), build_table(scores, heading)]
    return parts


_SCORES = ("precision", "recall", "fscore")


def _format_percent(value: float | None) -> str:
    return format_number(None if value is None else 100 * value)


def _build_view(view: SurfaceView, mesh: Mesh | None) -> str:
    pictures = [("render", view.image), ("depth", _paint_depth(view.depth))]
    if view.truth is not None:
        with np.errstate(invalid="ignore", divide="ignore"):
            error = np.abs(view.depth - view.truth) / view.truth
        middle = float(np.nanmedian(error)) if np.isfinite(error).any() else float("nan")
        pictures.append((f"error, median {_format_percent(middle)} %", _paint_error(error)))
    if mesh is not None and len(mesh):
        width = min(view.camera.width, _MOST_WIDE)
        camera = view.camera.resize(width, round(view.camera.height * width / view.camera.width))
        pictures.append(("mesh", shade_mesh(mesh, camera, view.motion)))
    embedded = [
        (text, embed_picture(turn_picture(image, view.turns), _MOST_WIDE))
        for text, image in pictures
    ]
    return render_template(_VIEW, name=view.name, pictures=embedded, most_wide=_MOST_WIDE)


def _paint_depth(depth: np.ndarray) -> np.ndarray:
    import cv2  # here, because gsut --help needs none

    has = np.isfinite(depth) & (depth > 0)
    logs = np.log(np.where(has, depth, 1))
    low, high = np.percentile(logs[has], (2, 98)) if has.any() else (0.0, 1.0)
    return paint_values((logs - low) / max(high - low, 1e-9), cv2.COLORMAP_TURBO, has, _GREY)


def _paint_error(error: np.ndarray) -> np.ndarray:
    import cv2

    has = np.isfinite(error)
    error = np.where(has, error, 0) / _FULL_ERROR
    return paint_values(error, cv2.COLORMAP_INFERNO, has, _GREY)
