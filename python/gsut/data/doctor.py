"""The doctor's checks of a dataset's files, poses, points and pixels, each by itself."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from gsut._core import InputError
from gsut.data.assemble import assemble
from gsut.data.check_colors import check_colors
from gsut.data.check_geometry import check_lenses, check_points, check_poses
from gsut.data.check_images import as_finding, check_images
from gsut.data.findings import SEVERITIES, Finding, sorted_findings
from gsut.data.load import read_dataset
from gsut.data.scene import Scene
from gsut.data.split import TEST_EVERY

__all__ = ["Finding", "diagnose", "diagnose_scene", "findings_text"]


def diagnose(
    path: str | os.PathLike, *, test_every: int = TEST_EVERY, progress: bool = True
) -> list[Finding]:
    """Reads a dataset without stopping at the first error, and looks at all of it.

    Files, sizes and poses; every image is decoded; blur, exposure and repeats; lens domain; cameras
    against points; colours of points against pixels.

    Args:
        path: a folder with transforms.json, a COLMAP model or images with lens and poses; or a
            transforms.json file itself.
        test_every: hold out every n-th image by name, 0 for none.
        progress: show bars while images are decoded.

    Returns:
        Findings, errors first. Training can start if none has severity "error".
    """
    findings: list[Finding] = []

    def collect(error: InputError) -> None:
        findings.append(as_finding(error))

    try:
        listing = read_dataset(Path(path), on_error=collect)
        if findings and not (listing.frames or listing.missing):  # what they lack is said
            return sorted_findings(findings)
        scene = assemble(listing, test_every=test_every, on_error=collect)
    except InputError as error:
        collect(error)
        return sorted_findings(findings)
    return sorted_findings([*findings, *diagnose_scene(scene, progress=progress)])


def diagnose_scene(scene: Scene, *, progress: bool = True) -> list[Finding]:
    """What `diagnose` says of a dataset once it is read.

    Args:
        scene: at full size.
        progress: show bars while images are decoded.
    """
    where, scene = str(scene.path), scene.centred
    findings = [Finding("warning", where, note) for note in scene.notes]
    findings.append(
        Finding(
            "info",
            where,
            f"{len(scene)} views ({len(scene.train_indices)} for training,"
            f" {len(scene.test_indices)} held out), {len(scene.cameras)} cameras",
        )
    )
    findings += check_lenses(scene)
    findings += check_poses(scene)
    findings += check_points(scene)
    findings += check_images(scene, progress=progress)
    findings += check_colors(scene, progress=progress)
    return findings


def findings_text(findings: Sequence[Finding]) -> str:
    """The findings as text: one line each, errors first, and a last line that counts them."""
    count = {s: sum(f.severity == s for f in findings) for s in SEVERITIES}
    verdict = "training cannot start" if count["error"] else "training can start"
    lines = [str(finding) for finding in findings]
    lines.append(f"{count['error']} errors, {count['warning']} warnings: {verdict}")
    return "\n".join(lines)
