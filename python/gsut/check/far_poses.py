"""Finds one camera far from all others, unless the photographs show that it stands there."""

from __future__ import annotations

import numpy as np

from gsut.check.chance import judge_pairs
from gsut.check.evidence import Evidence
from gsut.check.findings import Finding
from gsut.data import Scene

_FEWEST_OTHERS = 5  # cameras, from which one can stand out


def check_far_pose(scene: Scene, evidence: Evidence | None) -> list[Finding]:
    """Names a camera that stands farther from every other than any two of these are apart.

    Args:
        scene: with poses.
        evidence: of the photographs, or None: they may show that the pose is right.
    """
    centers = np.array([view.camera_center for view in scene.views])
    if len(centers) < _FEWEST_OTHERS:
        return []
    away = int(np.argmax(np.linalg.norm(centers - np.median(centers, axis=0), axis=1)))
    others = np.delete(centers, away, axis=0)
    size = float(np.linalg.norm(np.ptp(others, axis=0)))
    distance = float(np.linalg.norm(others - centers[away], axis=1).min())
    if distance <= size:
        return []
    if evidence is not None:
        supports = [evidence.pairs[each.number] for each in judge_pairs(evidence).supports]
        if any(away in (pair.first, pair.second) for pair in supports):
            return []
    return [
        Finding(
            "warning",
            str(scene.path),
            f"{scene.views[away].name} stands farther from all other cameras ({distance:.3g} "
            f"units) than these are apart ({size:.3g})",
            "check its pose, or leave it out: it makes the scene's extent and its steps too large",
        )
    ]
