"""A run's depths and mesh against a truth: depth files, a mesh, or a cloud of points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError
from gsut.data.scene import read_depth
from gsut.render import compute_field_angles, render, render_surface
from gsut.surface.extract import OnProgress, extract_mesh, ignore_progress
from gsut.surface.mesh import Mesh
from gsut.surface.mesh_files import load_mesh
from gsut.surface.rays import cast_onto
from gsut.surface.worth import build_tree, judge_depth, judge_mesh

KINDS = ("expected", "median", "strongest")


def judge_geometry(
    gaussians: Any,
    scene: Any,
    indices: Sequence[int],
    truth: Path | None,
    *,
    mesh: Mesh | None = None,
    background: Sequence[float] | None = (0.0, 0.0, 0.0),
    progress: OnProgress = ignore_progress,
) -> dict[str, Any]:
    """Judges depth on views, and the mesh if the truth is one.

    Args:
        gaussians: the Gaussians, in the dataset's coordinates.
        scene: the dataset.
        indices: of the views whose depth is judged.
        truth: a mesh (.ply, .obj), from which depths are cast through each view's lens; a cloud
            (a .ply without faces), by which only the mesh is judged; a folder of depth files named
            like the images; None: the dataset's own depth files.
        mesh: what is judged; None: that of `extract_mesh`.
        background: colour behind the Gaussians; None: see `render`.
        progress: called with (stage, done, total).

    Returns:
        dict depth: for each kind of depth the figures of `judge_depth` over all pixels of the
        views; mesh: those of `judge_mesh`. Either is absent where the truth says nothing.

    Raises:
        InputError: the truth is absent, empty or of another size than the images.
    """
    of_mesh = load_mesh(truth) if truth is not None and truth.is_file() else None
    figures: dict[str, Any] = {}
    if of_mesh is None or len(of_mesh.faces):
        tree = None if of_mesh is None else build_tree(of_mesh)
        rows = []
        for done, index in enumerate(indices):
            progress("depth", done, len(indices))
            true = (
                _read_depth(scene, index, truth)
                if tree is None
                else cast_onto(tree, scene.camera(index), scene.views[index].motion)[0]
            )
            if true is not None:
                rows.append((index, np.where(scene.mask(index), true, np.nan)))
        progress("depth", len(indices), len(indices))
        if not rows:
            raise InputError(
                f"{truth or scene.path} has no depth of these views (NAME.png in 16 bits, or "
                "NAME.npy); try --split all"
            )
        figures["depth"] = _judge_views(gaussians, scene, rows, background)
        figures["depth"]["views"] = len(rows)
    if of_mesh is not None:
        if mesh is None:
            mesh = extract_mesh(gaussians, scene, background=background, progress=progress)
        figures["mesh"] = judge_mesh(mesh, of_mesh, scene)
    return figures


def _judge_views(
    gaussians: Any,
    scene: Any,
    rows: list[tuple[int, np.ndarray]],
    background: Sequence[float] | None,
) -> dict[str, Any]:
    columns: dict[str, list[np.ndarray]] = {kind: [] for kind in (*KINDS, "truth", "angle")}
    for index, true in rows:
        camera, view = scene.camera(index), scene.views[index]
        drawn = gaussians.order_by_centers()
        result = render(drawn, camera, view.motion, background=background)
        surface = render_surface(result)
        for kind in KINDS:
            columns[kind].append(getattr(surface, kind).ravel())
        columns["truth"].append(true.ravel())
        columns["angle"].append(np.degrees(compute_field_angles(camera)).ravel())
    joined = {name: np.concatenate(parts)[None] for name, parts in columns.items()}
    return {kind: judge_depth(joined[kind], joined["truth"], joined["angle"]) for kind in KINDS}


def _read_depth(scene: Any, index: int, folder: Path | None) -> np.ndarray | None:
    view = scene.views[index]
    path = view.depth_path
    if folder is not None:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such file or folder")
        stem = Path(view.name).with_suffix("")
        names = (stem, Path(*stem.parts[-2:]), Path(stem.name))  # of a rig with its camera's folder
        choices = [folder / base.with_suffix(s) for base in names for s in (".npy", ".png")]
        path = next((choice for choice in choices if choice.is_file()), None)
    depth = read_depth(scene, index, None if folder is None else path) if path else None
    if depth is None:
        return None
    camera = scene.camera(index)
    rows, columns = (  # of the nearest depth
        (np.arange(size) + 0.5) * n // size
        for n, size in zip(depth.shape, (camera.height, camera.width), strict=True)
    )
    return depth[np.ix_(rows.astype(int), columns.astype(int))]
