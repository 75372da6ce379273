"""What is looked at before time is spent on a dataset, and what `gsut doctor` adds to the files."""

from __future__ import annotations

import os
from collections.abc import Sequence

from gsut._core import InputError
from gsut.check.evidence import gather_evidence
from gsut.check.matches import ImagePair, neighbouring_matches
from gsut.check.memory import check_memory
from gsut.check.photographs import check_half_pixel, check_photographs
from gsut.check.points import check_points_frame
from gsut.data import (
    TEST_EVERY,
    Finding,
    Scene,
    check_bits,
    check_colors,
    check_lenses,
    check_points,
    check_poses,
    diagnose_scene,
    load_dataset,
    sorted_findings,
)
from gsut.data import diagnose as diagnose_files

_VIEWS = 5  # whose colours are compared with the points'


def check_scene(scene: Scene, matches: list[ImagePair] | None = None) -> list[Finding]:
    """The doctor's checks that take seconds: lens, poses and points, against some photographs.

    Args:
        scene: from `load_dataset`; some of its images are decoded.
        matches: from `neighbouring_matches`, where they are known already.

    Returns:
        Findings, errors first.
    """
    findings = [*check_lenses(scene), *check_poses(scene), *check_points(scene)]
    findings += check_bits(scene)
    return sorted_findings([*findings, *check_against_photographs(scene, _VIEWS, matches)])


def check_against_photographs(
    scene: Scene, color_views: int | None = None, matches: list[ImagePair] | None = None
) -> list[Finding]:
    """Poses and lens by matches of neighbouring photographs; points by distances and colours.

    Args:
        scene: from `load_dataset`.
        color_views: views whose colours are compared; None: the colours were compared before.
        matches: where they are known already.
    """
    evidence = gather_evidence(scene.about((0.0, 0.0, 0.0)), matches)
    findings = check_photographs(scene, evidence)
    if any(finding.severity == "error" for finding in findings):
        return findings  # what follows from it needs no words of its own
    points = check_points_frame(scene, evidence)
    if points or color_views is None:
        return [*findings, *points]
    return [*findings, *check_colors(scene, views=color_views, progress=False)]


def doctor(
    data: str | os.PathLike | Scene, *, test_every: int = TEST_EVERY, progress: bool = True
) -> list[Finding]:
    """Reads a dataset without stopping at the first error, and looks at all of it.

    Files, sizes and poses; every image is decoded; blur, exposure and repeats; lens domain; cameras
    against points; colours of points against pixels; memory; and poses and lens against the
    photographs: where they contradict each other, what was probably meant is named.

    Args:
        data: a folder with transforms.json, a COLMAP model or images with lens and poses; a
            transforms.json file itself; or a scene, such as `make_scene` makes of arrays.
        test_every: of a folder: hold out every n-th image by name, 0 for none.
        progress: show bars while images are decoded.

    Returns:
        Findings, errors first. Training can start if none has severity "error".
    """
    if isinstance(data, Scene):
        findings = sorted_findings(diagnose_scene(data, progress=progress))
    else:
        findings = diagnose_files(data, test_every=test_every, progress=progress)
    if any(finding.severity == "error" for finding in findings):
        return findings
    scene = data if isinstance(data, Scene) else load_dataset(data, test_every=0)
    findings += check_memory(scene)
    found = check_against_photographs(scene)
    if all(finding.severity == "info" for finding in found):
        found += look_closer(scene)
    return sorted_findings([*findings, *found])


def look_closer(scene: Scene, matches: list[ImagePair] | None = None) -> list[Finding]:
    """What takes several times the quick checks' time: half a pixel of the principal point.

    Args:
        scene: in the dataset's coordinates, that the quick checks found nothing against.
        matches: from `neighbouring_matches(scene, closely=True)`, where they are known already.
    """
    matches = neighbouring_matches(scene, closely=True) if matches is None else matches
    evidence = gather_evidence(scene.about((0.0, 0.0, 0.0)), matches)
    return [] if evidence is None else check_half_pixel(evidence, str(scene.path))


def stop_at_errors(findings: Sequence[Finding], force: bool) -> None:
    """Raises InputError for the first error of the findings, unless `force`."""
    errors = [finding for finding in findings if finding.severity == "error"]
    if errors and not force:
        more = f" (and {len(errors) - 1} more: gsut doctor)" if len(errors) > 1 else ""
        first = errors[0]
        raise InputError(
            f"{first.where}: {first.what}; {first.advice}{more}; --force goes on as it is"
        )
