"""How far an estimated lens and readout time ended from those of the database."""

from __future__ import annotations

import math
from typing import Any

from gsut.lens import Camera, LensProfile, measure_field_of_view
from gsut.sfm.core import Photographs, PosesOptions

_CONTRADICTS = 0.1  # share by which focal lengths differ


def compare_lens(
    photographs: Photographs, lens: Camera, options: PosesOptions, extra: dict[str, Any]
) -> list[str]:
    """Sentences on what was said of the lens and what was found; "lens_start" is added to extra."""
    words = []
    if extra["lens"] == "estimated" and photographs.said_focal_px is not None:
        words += contradiction(photographs.said_focal_px, lens)
    if photographs.profile is not None:
        extra["lens_start"] = compare_with_profile(
            photographs.profile, lens, extra.get("readout"), options
        )
        words.append(start_words(extra["lens_start"]))
    return words


def compare_with_profile(
    profile: LensProfile, lens: Camera, readout: dict[str, Any] | None, options: PosesOptions
) -> dict[str, Any]:
    """What poses.json holds as "lens_start".

    Args:
        profile: the lens was sought from here.
        lens: as estimated.
        readout: of poses.json, with the time estimated; None: a global shutter.
        options: with the readout time given.

    Returns:
        name and doubts of the profile, its focal length and field of view and the estimated ones,
        and by how many percent focal length and readout time differ from the start; None where
        one of them is not known.
    """
    start = profile.make_camera(lens.width, lens.height)
    found = given = None
    if readout is not None and "seconds" in readout:  # by the flow of a video
        found = readout["seconds"]
        given = None if profile.readout_ms is None else abs(profile.readout_ms) / 1000
    elif readout is not None:
        found, given = readout["estimated"], options.readout_time
    return {
        "name": profile.name,
        "doubts": list(profile.doubts),
        "focal_px": [float(start.params[0]), float(lens.params[0])],
        "focal_percent": 100 * float(lens.params[0] / start.params[0] - 1),
        "fov_degrees": [measure_field_of_view(start), measure_field_of_view(lens)],
        "readout_percent": 100 * (found / given - 1) if found and given else None,
    }


def start_words(values: dict[str, Any]) -> str:
    """The comparison as a sentence."""
    before, after = values["focal_px"]
    text = (
        f"the lens was sought from {values['name']} of the database and found with a focal length "
        f"of {after:.1f} px, {values['focal_percent']:+.1f} % of its {before:.1f} px"
    )
    if None not in values["fov_degrees"]:
        text += " (field of view {:.1f} -> {:.1f} degrees)".format(*values["fov_degrees"])
    if values["readout_percent"] is not None:
        text += f", its readout time {values['readout_percent']:+.0f} %"
    if values["doubts"]:
        text += f"; that calibration is doubtful: {', '.join(values['doubts'])}"
    return text


def contradiction(said_focal_px: float, lens: Camera) -> list[str]:
    """A sentence if the lens found is far from the focal length that EXIF names."""
    found = float(lens.params[0])
    if abs(found / said_focal_px - 1) <= _CONTRADICTS:
        return []
    said = 2 * math.degrees(math.atan(lens.width / 2 / said_focal_px))
    field = measure_field_of_view(lens)
    seen = "" if field is None else f", {field:.0f} degrees across"
    return [
        f"EXIF says a focal length of {said_focal_px:.0f} px ({said:.0f} degrees across as a "
        f"perspective lens), but {found:.0f} px were found{seen}: the photographs were cropped or "
        "corrected in the camera, or the lens found is wrong; if renders look bent, give the field "
        "of view by --fov or a lens by --camera"
    ]
