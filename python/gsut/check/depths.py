"""Checks depth files against the points and the matches: their unit, and distance, z or inverse."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator

import numpy as np

from gsut._core import InputError
from gsut.check.evidence import Evidence, gather_evidence
from gsut.check.findings import Finding
from gsut.data import Scene
from gsut.data.scene import find_visible_points, read_depth
from gsut.render import compute_field_angles
from gsut.sampling import FEWEST_SAMPLES, choose_evenly

_AGREES = 0.02  # median relative difference below which files agree with points
_UNRELATED = 0.5  # likewise, beyond which they agree as no kind of depth
_KINDS = (  # what files may hold: words, power of the distance, power of the cosine to the axis
    ("distances along the rays", 1, 0),
    ("z along the camera's axis", 1, 1),
    ("distances, though they are stated to be z", 1, -1),
    ("the inverse of distances", -1, 0),
    ("the inverse of z", -1, -1),
)
_ADVICE = "depths are read along the rays, 16-bit pictures in thousandths of the poses' unit: "
_CURES = {
    1: 'write "depth_along": "z" into transforms.json',
    2: 'leave "depth_along" out of transforms.json',
}  # by kind
_Known = tuple[int, np.ndarray, np.ndarray]  # view, places (n, 2) and distances (n,)


def check_depths(scene: Scene, evidence: Evidence | None = None) -> list[Finding]:
    """Compares depth files with what points or else matches of the photographs say.

    Args:
        scene: with poses that the photographs agree with.
        evidence: of the photographs; None: gathered if points do not suffice.

    Returns:
        A warning that says in which unit, or as what, the files would agree, or nothing.
    """
    if all(view.depth_path is None for view in scene.views):
        return []
    others, samples = "the points", _look_up(scene, _list_points(scene))
    if samples.shape[1] < FEWEST_SAMPLES:
        evidence = gather_evidence(scene) if evidence is None else evidence
        if evidence is not None:
            others = "the matches of the photographs"
            samples = _look_up(scene, _list_matches(scene, evidence))
    if samples.shape[1] < FEWEST_SAMPLES:
        return []
    depth, distance, cosine = np.log(samples)
    offs = [depth - power * distance - tilt * cosine for _, power, tilt in _KINDS]
    scales = [float(np.median(off)) for off in offs]
    errors = [
        float(np.median(np.abs(off - scale))) for off, scale in zip(offs, scales, strict=True)
    ]
    best = int(np.argmin(errors))
    if errors[best] > _UNRELATED:
        what = f"depth files do not agree with {others}, in any unit: the median differs by a "
        what += f"factor of {np.exp(errors[best]):.2g}"
        return [_warn(scene, what, _ADVICE + "check that they are of these images and poses")]
    given, *others_off = (float(np.median(np.abs(off))) for off in offs)
    most = given / 2  # of what is named in its place
    if given < _AGREES:
        return []
    for kind, cure in _CURES.items():
        if others_off[kind - 1] < most:
            what = f"depth files agree with {others} as {_KINDS[kind][0]}"
            return [_warn(scene, what, _ADVICE + cure)]
    if errors[best] > most:
        return []
    what = f"depth files agree with {others} as {_KINDS[best][0]} times {np.exp(scales[best]):.3g}"
    cure = 'state "depth_unit" in transforms.json, or convert the files'
    return [_warn(scene, what, _ADVICE + cure)]


def _warn(scene: Scene, what: str, advice: str) -> Finding:
    return Finding("warning", str(scene.path), what, advice)


def _list_points(scene: Scene) -> Iterator[_Known]:
    views = [view for view, each in enumerate(scene.views) if each.depth_path is not None]
    for view in choose_evenly(views) if len(scene.points) else ():
        yield view, *find_visible_points(scene, view, scene.points)[1:]


def _list_matches(scene: Scene, evidence: Evidence) -> Iterator[_Known]:
    views, pixels, distances = evidence.measure_distances()
    for view in np.unique(views).tolist():
        camera, rows = scene.camera(view), views == view
        yield view, pixels[rows] / [camera.width, camera.height], distances[rows]


def _look_up(scene: Scene, known: Iterable[_Known]) -> np.ndarray:
    """Returns (3, N) depths of the files at places, their distances and cosines to the axis."""
    found = [np.zeros((3, 0))]
    for view, places, distances in known:
        with contextlib.suppress(InputError):  # reported by the checks of the files
            depth = read_depth(scene, view)
            if depth is None:
                continue
            angles = compute_field_angles(scene.camera(view))
            depth, angle = (_look_at(table, places) for table in (depth, angles))
            found.append(np.stack([depth, distances, np.cos(angle)]))
    rows = np.concatenate(found, axis=1)
    return rows[:, (np.isfinite(rows) & (rows > 0)).all(axis=0)]


def _look_at(table: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Returns the values (N, ...) of a picture at places (N, 2), shares of its size."""
    size = np.array(table.shape[1::-1])
    columns, rows = np.clip((places * size).astype(np.int64), 0, size - 1).T
    return table[rows, columns]
