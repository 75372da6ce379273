"""The doctor's entries: checks a scene quickly, its files alone, or everything."""

from __future__ import annotations

import os
from pathlib import Path

from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.check.colors import check_colors
from gsut.check.depths import check_depths
from gsut.check.evidence import gather_evidence
from gsut.check.findings import Finding, finding_from_error, sort_findings
from gsut.check.geometry import check_lenses, check_points, check_poses
from gsut.check.images import check_bits, check_images
from gsut.check.masks import check_masks
from gsut.check.matches import ImagePair
from gsut.check.memory import check_memory
from gsut.check.photographs import check_photographs, name_far_views
from gsut.check.points import check_points_frame
from gsut.data import Scene, assemble, read_dataset
from gsut.data.scene import TEST_EVERY, find_bad_depths


def check_scene(scene: Scene, matches: list[ImagePair] | None = None) -> list[Finding]:
    """Checks lens, poses and points against some photographs, within seconds.

    Args:
        scene: from `load_dataset`; some of its images are decoded.
        matches: from `match_neighbours`, if already computed.

    Returns:
        Findings, errors first.
    """
    findings = [*check_lenses(scene), *check_poses(scene), *check_points(scene)]
    findings += [*check_bits(scene), *check_masks(scene)]
    return sort_findings([*findings, *check_against_photographs(scene, True, matches)])


def check_against_photographs(
    scene: Scene, with_colors: bool = False, matches: list[ImagePair] | None = None
) -> list[Finding]:
    """Checks poses and lens by matches of neighbouring photographs, points by distance and colour.

    Args:
        scene: from `load_dataset`.
        with_colors: compare the colours of points with the photographs.
        matches: from `match_neighbours`, if already computed.
    """
    evidence = gather_evidence(scene.move_origin((0.0, 0.0, 0.0)), matches)
    findings = check_photographs(scene, evidence)
    if any(finding.severity == "error" for finding in findings):
        return findings  # whatever else is wrong follows from it
    points = check_points_frame(scene, evidence)
    if not points:
        findings += check_depths(scene, evidence)
    if points or not with_colors:
        return [*findings, *points]
    return [*findings, *check_colors(scene, progress=False)]


def diagnose(path: str | os.PathLike, *, progress: bool = True) -> list[Finding]:
    """Checks a dataset's files, sizes, poses, images, lenses and points, each on its own.

    Continues after errors. Unlike `doctor`, it does not compare poses with photographs.

    Args:
        path: the dataset's folder or its transforms.json.
        progress: show bars while images are decoded.

    Returns:
        Findings, errors first. Training can start if none has severity "error".
    """
    findings, scene = _read(path, TEST_EVERY)
    if scene is not None:
        findings += [*name_far_views(scene), *_diagnose_scene(scene, progress)]
    return sort_findings(findings)


def _read(path: str | os.PathLike, test_every: int) -> tuple[list[Finding], Scene | None]:
    """Reads a dataset; returns the errors of its files, and a scene of what is left, if any."""
    errors: list[InputError] = []
    scene = None
    try:
        listing = read_dataset(Path(path), on_error=errors.append)
        if listing.frames or listing.missing or not errors:  # else they say what is absent
            scene = assemble(listing, test_every=test_every, on_error=errors.append)
    except InputError as error:
        errors.append(error)
    return [finding_from_error(error) for error in errors], scene


def _diagnose_scene(scene: Scene, progress: bool) -> list[Finding]:
    where, scene = str(scene.path), scene.centred
    counts = (
        f"{len(scene)} views ({len(scene.train_indices)} for training,"
        f" {len(scene.test_indices)} held out), {len(scene.cameras)} cameras"
    )
    return [
        *(Finding("warning", where, note) for note in scene.notes),
        Finding("info", where, counts),
        *check_lenses(scene),
        *check_poses(scene),
        *check_points(scene),
        *check_masks(scene),
        *check_images(scene, progress=progress),
        *(
            Finding("warning", where, str(error), "training stops there: mend it, or leave it out")
            for error in find_bad_depths(scene)
        ),
        *check_colors(scene, progress=progress),
    ]


@name_wrong_kinds
def doctor(
    data: str | os.PathLike | Scene, *, test_every: int = TEST_EVERY, progress: bool = True
) -> list[Finding]:
    """Checks a dataset for everything that would stop or spoil training, beyond the first error.

    Files, sizes and poses; every image is decoded; blur, exposure and repeats; lens domain; cameras
    against points; colours of points against pixels; memory; and poses and lens against the
    photographs: where they contradict each other, it names what was probably meant.

    Args:
        data: a folder with transforms.json, a COLMAP model or images with lens and poses; a
            transforms.json file itself; or a scene, such as `scene_from_arrays` makes of arrays.
        test_every: of a folder: hold out every n-th image by name, 0 for none.
        progress: show bars while images are decoded.

    Returns:
        Findings, errors first. Training can start if none has severity "error".
    """
    errors, scene = ([], data) if isinstance(data, Scene) else _read(data, test_every)
    findings = [*errors]
    if scene is not None:
        findings += _diagnose_scene(scene, progress)
        if not errors:
            findings += [*check_memory(scene), *check_against_photographs(scene)]
    return sort_findings(findings)
