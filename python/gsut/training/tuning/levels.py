"""Makes levels of detail of a finished run, each with its measured PSNR."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gsut.compact import compact, list_seen_views, score_gaussians
from gsut.evaluate import mean_psnr
from gsut.gaussians import Gaussians, merge_gaussians
from gsut.training.first import SKY_DISTANCE, measure_reach
from gsut.training.record import TrainedRun

# Gaussians of the coarsest level: of degree 3 they take at most 250 kB as SOG.
_FIRST = 6144
# Most times that a level has the Gaussians of the next coarser one: twice as fine along each side.
_STEP = 4


class Levels(NamedTuple):
    """Levels of detail.

    Attributes:
        gaussians: of each level, from the finest.
        psnrs: of each level, dB with the environment; of held-out photographs where there are some.
        environment: the far Gaussians, which belong to every level; None: there are none.
    """

    gaussians: list[Gaussians]
    psnrs: list[float]
    environment: Gaussians | None


def make_levels(
    trained: TrainedRun, on_level: Callable[[int, float], object] = lambda count, psnr: None
) -> Levels:
    """Compacts a run's Gaussians to levels of detail, down to one that is loaded first.

    A level between the finest and the coarsest is left out unless it is better than all coarser
    ones.

    Args:
        trained: the run.
        on_level: called with the number of Gaussians and the PSNR of each level.
    """
    scene, whole = trained.scene, trained.gaussians
    far = _find_far(trained)
    environment = whole[far] if far.any() else None
    near = whole[~far] if far.any() else whole
    indices = scene.test_indices or scene.train_indices

    def measure(g: Gaussians) -> float:
        shown = g if environment is None else merge_gaussians([g, environment])
        psnr = mean_psnr(scene, shown, indices, trained.options.background, light=trained.light)
        on_level(len(g), psnr)
        return psnr

    kept, psnrs = [near], [measure(near)]
    steps = max(0, math.ceil(math.log(len(near) / _FIRST, _STEP)))
    if not steps:
        return Levels(kept, psnrs, environment)
    views = list_seen_views(scene, scene.train_indices)
    scores = score_gaussians(near, "ghap", views)
    for step in range(1, steps + 1):
        count = round(len(near) * (_FIRST / len(near)) ** (step / steps))
        level = compact(near, count=count, views=views, scores=scores).gaussians
        psnr = measure(level)
        while len(kept) > 1 and psnr >= psnrs[-1]:
            del kept[-1], psnrs[-1]
        kept.append(level)
        psnrs.append(psnr)
    return Levels(kept, psnrs, environment)


def _find_far(trained: TrainedRun) -> np.ndarray:
    """Finds Gaussians (N,) of the environment; none where the dataset has no points.

    They lie at least half as far as where training seeds a sky: parallax is below two pixels.
    """
    scene, g = trained.scene, trained.gaussians
    if not len(scene.points):
        return np.zeros(len(g), bool)
    middle = np.mean([view.camera_center for view in scene.views], axis=0)
    sky = SKY_DISTANCE * measure_reach(scene.points, middle)
    far: np.ndarray = np.linalg.norm(g.means + (g.origin - middle), axis=1) > sky / 2
    return far if not far.all() else np.zeros(len(g), bool)
