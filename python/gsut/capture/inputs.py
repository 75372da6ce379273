"""Collects videos, photographs and folders of them into one folder of pictures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gsut._core import InputError
from gsut.bounds import check_number, name_wrong_kinds
from gsut.capture.folders import expand_folders
from gsut.capture.frames import Capture, OnProgress, extract_frames
from gsut.capture.panorama import find_other_lens, prepare_panoramas
from gsut.capture.photographs import collect_photographs, find_photograph_files
from gsut.capture.strip import write_strip
from gsut.capture.video import is_video
from gsut.data import CAPTURE, find_lens_file, find_lens_files, read_capture
from gsut.data.scene import describe_changes
from gsut.files import write_json
from gsut.lens import is_lens_name


@name_wrong_kinds
def capture(
    inputs: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    count: int | None = None,
    nadir_cap: float = 0.0,
    on_progress: OnProgress | None = None,
) -> Capture:
    """Makes one folder of pictures from videos and photographs of one camera.

    Pictures of 360-degree cameras are recognised, see `prepare_panoramas`; their two lenses may
    also be two streams of a video, or two videos.

    Args:
        inputs: videos, photographs and folders of photographs, in any number.
        out: the folder; what is finished in it is not repeated.
        count: frames to choose of each video; None: by how far its view moves.
        nadir_cap: degrees from straight down that are masked in 360-degree pictures.
        on_progress: called with (stage, done, total, text).

    Returns:
        The folder, with what was found on the way.

    Raises:
        InputError: see `extract_frames`, `collect_photographs` and `prepare_panoramas`; or pictures
            of several sizes.
    """
    if count is not None:
        check_number(count, "count", 1, whole=True)
    paths = expand_folders(list(map(Path, inputs)))
    return prepare_panoramas(_take_pictures(paths, out, count, on_progress), nadir_cap)


def find_changed_inputs(
    inputs: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]
) -> str:
    """Names the videos and photographs that changed since `capture` made pictures of `inputs`.

    Returns:
        "" if none did, if `out` holds no pictures yet, or if an input is missing.
    """
    taken, paths = read_capture(Path(out)), expand_folders([Path(name) for name in inputs])
    if taken is None or not all(path.exists() for path in paths):
        return ""
    # Pictures of several videos are parts in folders of their own.
    folders = {Path(row["path"]).parts[0] for row in taken["frames"]}
    parts = [taken, *filter(None, (read_capture(Path(out) / name) for name in sorted(folders)))]
    before = {row[0]: row for part in parts for row in part["key"]["inputs"]}
    videos = [path for path in paths if is_video(path)]
    others = [path for path in paths if not is_video(path)]
    photographs = find_photograph_files(others).values() if others else ()
    return describe_changes(list(before.values()), [*videos, *photographs])


def needs_capture(images: str, camera: str | None, unknown_lens: bool) -> bool:
    """Returns whether a capture must choose frames, or read the pictures' lens, before poses.

    Args:
        images: a video, or a folder of photographs or a dataset.
        camera: a lens file, a lens name, or None.
        unknown_lens: a lens file beside the images does not count.
    """
    path = Path(images)
    if is_video(path):
        return True
    if not path.is_dir() or (path / "transforms.json").is_file():
        return False
    if camera is not None:
        return is_lens_name(camera)
    return unknown_lens or (not find_lens_files(path) and find_lens_file(path) is None)


def _take_pictures(
    inputs: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    count: int | None,
    on_progress: OnProgress | None,
) -> Capture:
    videos = [path for path in map(Path, inputs) if is_video(path)]
    others = [path for path in map(Path, inputs) if not is_video(path)]
    beside = find_other_lens(videos) if videos and not others else None
    if not others and (len(videos) == 1 or beside is not None):
        return extract_frames(videos[0], out, count=count, beside=beside, on_progress=on_progress)
    if not videos:
        return collect_photographs(others, out, on_progress=on_progress)
    folder = Path(out)
    parts = [
        extract_frames(
            video, folder / f"{number}-{video.stem}", count=count, on_progress=on_progress
        )
        for number, video in enumerate(videos, 1)
    ]
    if others:
        parts.append(collect_photographs(others, folder / "photographs", on_progress=on_progress))
    return _join_captures(parts, folder)


def _join_captures(parts: Sequence[Capture], folder: Path) -> Capture:
    """Joins several captures into one.

    Raises:
        InputError: they have different sizes.
    """
    sizes = {tuple(part.figures["size"]): part.figures["inputs"][0] for part in parts}
    if len(sizes) > 1:
        found = ", ".join(f"{name} {w} x {h}" for (w, h), name in sizes.items())
        raise InputError(
            f"the inputs have pictures of different sizes ({found}): give those of one camera and "
            "one setting at a time"
        )
    rows: list[dict[str, Any]] = []
    for part in parts:
        inner = os.path.relpath(part.path.resolve(), folder.resolve())
        for row in part.figures["frames"]:
            path = os.path.normpath(os.path.join(inner, row["path"]))
            # Times of several videos do not compare.
            rows.append({**row, "name": f"{inner}/{row['name']}", "path": path, "time": None})
    first = parts[0].figures
    counts = [
        f"{len(part.figures['frames'])} of {Path(part.figures['inputs'][0]).name}" for part in parts
    ]
    figures = {
        **first,
        "key": {
            **first["key"],
            "inputs": [row for part in parts for row in part.figures["key"]["inputs"]],
        },
        "inputs": [name for part in parts for name in part.figures["inputs"]],
        "notes": [
            f"pictures: {', '.join(counts)}",
            *(note for part in parts for note in part.figures["notes"]),
        ],
        "frames": rows,
    }
    write_strip(folder, rows)
    write_json(folder / CAPTURE, figures)
    return Capture(folder, figures)
