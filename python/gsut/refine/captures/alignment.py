"""Places one capture in the frame of another: photographs of one are located in the other's scene.

Each located photograph has a pose in both frames. The rotation between them is the mean of those of
the photographs, scale and shift follow from their centres; what disagrees is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import InputError, SolveError
from gsut.bounds import name_wrong_kinds
from gsut.data import Scene
from gsut.data.poses import find_centers, move_poses
from gsut.gaussians import Gaussians, find_nearest_rotation, transform_gaussians
from gsut.refine.photograph import localize
from gsut.sampling import choose_evenly

# Photographs that are located: their mean is then sure to a third of one.
_LOCATED = 12
# Photographs that must agree: with fewer, none shows which is wrong.
_FEWEST = 4
# Times the median disagreement, from which a photograph is left out.
_FAR = 4.0
# Rounds of leaving out: the median no longer moves then.
_ROUNDS = 4


@dataclasses.dataclass(frozen=True)
class CaptureAlignment:
    """How world coordinates of one capture become those of another: x -> scale rotation x + shift.

    Attributes:
        scale, rotation (3, 3), shift (3,): the similarity.
        scale_sigma: relative standard deviation of the scale.
        rotation_sigma: standard deviation of the rotation, degrees.
        position_sigma: standard deviation of positions amid the photographs, in units of the frame.
        names: of the photographs that agree.
        rejected: of those that were not located, or disagree.
    """

    scale: float
    rotation: np.ndarray
    shift: np.ndarray
    scale_sigma: float
    rotation_sigma: float
    position_sigma: float
    names: tuple[str, ...]
    rejected: tuple[str, ...]

    @property
    def matrix(self) -> np.ndarray:
        """(4, 4), of homogeneous coordinates."""
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.scale * self.rotation, self.shift
        return result

    def apply(self, gaussians: Gaussians) -> Gaussians:
        """Returns the Gaussians in the other frame."""
        return transform_gaussians(gaussians, self.rotation, self.scale, self.shift)

    def move_pose(self, camera_from_world: np.ndarray) -> np.ndarray:
        """Returns a pose (4, 4) in the other frame."""
        return move_poses(camera_from_world, self.scale, self.rotation, self.shift)


@name_wrong_kinds
def align_captures(
    scene: Scene,
    gaussians: Gaussians,
    other: Scene,
    *,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    on_progress: Callable[[str, int, int], None] | None = None,
) -> CaptureAlignment:
    """Finds the similarity from the world of `other` to that of `scene`, in datasets' coordinates.

    Args:
        scene, gaussians: a trained scene.
        other: another capture of the place, with its poses.
        background: colour behind the Gaussians, as in training.
        on_progress: called with (stage, done, total).

    Returns:
        The similarity with its standard deviations.

    Raises:
        SolveError: fewer than four photographs of `other` show this scene at places that agree.
    """
    chosen = choose_evenly(other.train_indices or range(len(other.views)), _LOCATED)
    count = len(chosen)
    names, pairs, own, rejected = [], [], [], []
    for done, index in enumerate(chosen):
        if on_progress is not None:
            on_progress("photographs", done, count)
        view = other.views[index]
        try:
            found = localize(
                other.image(index), scene, gaussians, camera=other.camera(index),
                mask=other.mask(index), background=background,
                shutter="global" if view.shutter is None else "rolling",
            )  # fmt: skip
        except (SolveError, InputError):
            rejected.append(view.name)
            continue
        names.append(view.name)
        own.append([np.linalg.norm(found.pose.center_std), np.linalg.norm(found.pose.rotation_std)])
        here = scene.to_dataset(found.pose.camera_from_world)
        pairs.append((here, other.to_dataset(view.camera_from_world)))
    if len(pairs) < _FEWEST:
        raise SolveError(
            f"only {len(pairs)} of {count} photographs of {other.path} show the scene of "
            f"{scene.path}: {_FEWEST} are needed; do both captures show the same place?"
        )
    here, there = np.array(pairs).transpose(1, 0, 2, 3)
    kept = _find_agreeing(here, there)
    if kept.sum() < _FEWEST:
        raise SolveError(
            f"photographs of {other.path} were located in {scene.path} at places that contradict "
            "each other: do both captures show the same place?"
        )
    scale, rotation, shift = _fit(here[kept], there[kept])
    rejected += [name for name, keep in zip(names, kept, strict=True) if not keep]
    names = [name for name, keep in zip(names, kept, strict=True) if keep]
    sigmas = _measure_sigmas(here[kept], there[kept], np.array(own)[kept])
    return CaptureAlignment(scale, rotation, shift, *sigmas, tuple(names), tuple(rejected))


def _fit(here: np.ndarray, there: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Fits scale, rotation and shift to poses (n, 4, 4) in both frames."""
    turns = np.einsum("nji,njk->ik", here[:, :3, :3], there[:, :3, :3])
    rotation = find_nearest_rotation(turns)
    target, source = find_centers(here), find_centers(there) @ rotation.T
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    scale = float((a * b).sum() / max((a * a).sum(), np.finfo(float).tiny))
    return scale, rotation, target.mean(axis=0) - scale * source.mean(axis=0)


def _find_agreeing(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Returns which poses (n,) agree with the similarity that the most agree with."""
    kept = _start(here, there)
    for _ in range(_ROUNDS):
        scale, rotation, shift = _fit(here[kept], there[kept])
        errors = _measure_errors(here, there, scale, rotation, shift)
        limit = _FAR * np.median(errors[kept], axis=0) + np.finfo(np.float32).eps
        kept = (errors <= limit).all(axis=1)
        if kept.sum() < _FEWEST:
            return kept
    return kept


def _start(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Returns the half of the photographs (n,) whose rotations between the frames agree best."""
    turns = np.einsum("nji,njk->nik", here[:, :3, :3], there[:, :3, :3])
    apart = np.linalg.norm(turns[:, None] - turns[None], axis=(2, 3))
    best = np.argsort(np.median(apart, axis=1))[0]
    kept = np.zeros(len(here), bool)
    kept[np.argsort(apart[best])[: max(_FEWEST, (len(here) + 1) // 2)]] = True
    return kept


def _measure_errors(
    here: np.ndarray, there: np.ndarray, scale: float, rotation: np.ndarray, shift: np.ndarray
) -> np.ndarray:
    """Measures by how much the centres, and the rotations, of poses differ: (n, 2)."""
    off = scale * find_centers(there) @ rotation.T + shift - find_centers(here)
    turned = here[:, :3, :3] @ rotation - there[:, :3, :3]
    return np.stack([np.linalg.norm(off, axis=1), np.linalg.norm(turned, axis=(1, 2))], axis=1)


def _measure_sigmas(
    here: np.ndarray, there: np.ndarray, own: np.ndarray
) -> tuple[float, float, float]:
    """Measures the standard deviations of scale (relative), rotation (degrees) and positions.

    By the jackknife: the fit is repeated without each photograph. What all photographs of a few
    share does not show there: their own deviations `own` (n, 2), of centre and degrees, are added.
    """
    n, middle = len(here), find_centers(there).mean(axis=0)
    fits = [_fit(np.delete(here, i, axis=0), np.delete(there, i, axis=0)) for i in range(n)]
    scales = np.array([scale for scale, _, _ in fits])
    turns = np.array([rotation for _, rotation, _ in fits])
    places = np.array([scale * turn @ middle + shift for scale, turn, shift in fits])

    def spread(values: np.ndarray) -> float:
        return float(np.sqrt((n - 1) / n * ((values - values.mean(axis=0)) ** 2).sum()))

    shared, turned = np.sqrt((own**2).mean(axis=0))
    reach = np.sqrt(((find_centers(here) - find_centers(here).mean(axis=0)) ** 2).sum(1).mean())
    # Of a small rotation, the norm of the matrix' change is the angle times the root of 2.
    return (
        float(np.hypot(spread(scales) / abs(scales.mean()), shared / reach / np.sqrt(n))),
        float(np.hypot(np.degrees(spread(turns) / np.sqrt(2)), turned / np.sqrt(n))),
        float(np.hypot(spread(places), shared / np.sqrt(n))),
    )
