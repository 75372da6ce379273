"""Extracts frames of a video into a folder."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gsut._core import InputError, __version__
from gsut.capture.ahead import WorkAhead, make_pool
from gsut.capture.choose import (
    FEWEST_CANDIDATES,
    Candidate,
    CandidateSearch,
    Look,
    add_candidates,
    choose_frames,
    find_blurred,
    look_at,
)
from gsut.capture.flow import FRAMES_BESIDE, FlowFrame, FlowSearch, shrink_frame
from gsut.capture.strip import write_strip
from gsut.capture.track import average_ups, interpolate_places, read_film_facts
from gsut.capture.turns import write_turns
from gsut.capture.video import Decode, Video
from gsut.data import CAPTURE, list_some, read_capture
from gsut.data.scene import capture_state, describe_changes
from gsut.files import write_json, write_picture
from gsut.judge.checks import MANY

OnProgress = Callable[[str, int, int, str], None]
# Folder of the frames, beside capture.json.
IMAGES = "images"
# Fewest frames of a video from which a scene can be made.
FEWEST_FRAMES = 8
# Motion of the view, x the diagonal, below which the video is one still picture.
_STILL = 0.01
# Share of the frames that the file announces below which it was cut off.
_CUT_OFF = 0.98
# Digits of the numbers in names.
_FEWEST_DIGITS = 5
# Quality of written JPEG files: compression then changes features less than noise does.
JPEG_QUALITY = 97
# Seconds between frames that are looked at: faster videos show nothing new. By their time stamps,
# since the frame rate that a file names need not be that of its frames.
_LEAST_APART = 0.0199


@dataclasses.dataclass(frozen=True)
class Capture:
    """A folder of pictures that poses can be found for.

    Attributes:
        path: holds images/, capture.json and strip.jpg.
        figures: the content of capture.json: kind, inputs, notes, size, and "frames", one row a
            picture with its name and, of a video, number, time (seconds), sharpness, flow (see
            FlowSearch), place (latitude, longitude, altitude) and up (in the camera's axes, or
            sensor_up in the gyroscope's);
            "name_rate" is how many numbers of the names a second has; "turns" what the camera
        recorded of its turns, see `write_turns`.
    """

    path: Path
    figures: dict[str, Any]

    @property
    def notes(self) -> list[str]:
        """What the user should know, one sentence each."""
        return self.figures["notes"]

    def __repr__(self) -> str:
        return f"Capture({str(self.path)!r}, {len(self.figures['frames'])} pictures)"


def extract_frames(
    video: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    count: int | None = None,
    beside: str | os.PathLike[str] | None = None,
    on_progress: OnProgress | None = None,
) -> Capture:
    """Chooses frames of a video by sharpness and by how far the view moved, and writes them.

    The video is read twice: first small, to choose; then to write. A finished folder of the same
    video and count is returned unchanged.

    Args:
        video: any that FFmpeg decodes (H.264, HEVC, VP9, AV1, ...), of any frame rate; rotated
            upright according to the file.
        out: folder that gets images/f00123.jpg (the number counts frames at the video's frame rate
            and so gives the time), capture.json and strip.jpg.
        count: frames to choose; None: 60 to 300 by how far the view moved.
        beside: video of the other lens of a 360-degree camera, taken at the same time; its frames
            are put to the right of the first. The video itself: its second stream.
        on_progress: called with (stage, done, total, text).

    Returns:
        The folder, with the frames' names, time stamps and sharpness.

    Raises:
        InputError: no video, a codec that cannot be decoded, fewer than 8 frames, a view that never
            moves, or a count below 2.
    """
    if count is not None and count < 2:
        raise InputError(f"--frames takes 2 or more, found {count}; 60 or more make a good scene")
    path, folder = Path(video), Path(out)
    files = [path] if beside is None else [path, Path(beside)]
    report = on_progress or (lambda *_: None)
    with Video(*files) as source:
        announced, rate, lasts = source.frame_count, source.frame_rate, source.duration
        size = source.width, source.height
    key = {"version": __version__, "inputs": capture_state(files), "count": count}
    done = read_finished_capture(folder, key)
    if done is not None:
        return done
    search, seen, found = _search_candidates(files, report)
    notes = _judge(path, search.candidates, seen, (announced, lasts), rate) + found
    candidates = add_candidates(search.candidates, search.frames, count)
    chosen = [candidates[index] for index in choose_frames(candidates, count)]
    if count is not None and len(chosen) < count:
        notes.append(
            f"{path.name} has only {len(chosen)} frames to choose from, not the {count} of --frames"
        )
    elif len(chosen) < FEWEST_CANDIDATES:
        notes.append(
            f"{len(chosen)} frames of {path.name} are used, which is few: film for ten seconds or "
            "more, walking around what you want to see"
        )
    names, name_rate = _name_frames(chosen, rate)
    (folder / IMAGES).mkdir(parents=True, exist_ok=True)
    flows = _write(files, chosen, names, folder / IMAGES, report)
    facts, times = read_film_facts(path), np.array([c.time for c in chosen])
    notes += facts.notes
    places = interpolate_places(facts.track, times)
    # The circles of two lenses have axes of their own.
    ups = average_ups(facts.forces if beside is None else facts.forces[:0], times)
    up_key = "sensor_up" if facts.is_askew else "up"
    unsharp = find_blurred(chosen)
    if unsharp.mean() > MANY:
        notes.append(
            f"{unsharp.sum()} of the {len(chosen)} frames chosen are blurred: move more slowly, or "
            "film with more light or a shorter shutter time"
        )
    figures: dict[str, Any] = {
        "kind": "video", "key": key, "inputs": [str(file) for file in files], "size": size,
        "frame_rate": rate, "name_rate": name_rate, "camera": facts.camera,
        "frames_seen": seen, "seconds": candidates[-1].time, "notes": notes,
        "frames": [
            {"name": name, "path": f"{IMAGES}/{name}", "number": c.number, "time": c.time,
             "sharpness": c.sharpness, "blurred": bool(b), "flow": flows.get(c.number),
             "place": place, up_key: up}
            for name, c, b, place, up in zip(names, chosen, unsharp, places, ups, strict=True)
        ],
    }  # fmt: skip
    if facts.turns:
        figures["turns"] = write_turns(folder, facts.turns)
    write_strip(folder, figures["frames"])
    write_json(folder / CAPTURE, figures)
    return Capture(folder, figures)


def read_finished_capture(folder: Path, key: dict[str, Any]) -> Capture | None:
    """Reads the capture in a folder if it is complete and of the same inputs and settings."""
    figures = read_capture(folder)
    if figures is None or figures["key"] | {"inputs": None} != key | {"inputs": None}:
        return None
    if describe_changes(figures["key"]["inputs"], [Path(row[0]) for row in key["inputs"]]):
        return None
    whole = all((folder / row["path"]).is_file() for row in figures["frames"])
    return Capture(folder, figures) if whole else None


def _search_candidates(
    files: Sequence[Path], report: OnProgress
) -> tuple[CandidateSearch, int, list[str]]:
    """Returns a search that has seen the frames looked at, their number, and notes on the film."""
    import cv2

    def look(number: int, time: float, picture: Decode) -> Look | None:
        pixels = picture()
        if pixels is None:
            return None
        return look_at(number, time, cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))

    seen, last = 0, -math.inf
    with Video(*files) as source, make_pool() as pool:
        search, ahead = CandidateSearch(pool), WorkAhead[Look | None](pool)
        for number, time, picture in source.read_frames():
            seen = number + 1
            is_damaged = source.damaged[-1:] == [time]
            if time - last >= _LEAST_APART and not is_damaged:
                last = time
                ahead.submit(look, number, time, picture)
            for found in ahead.take_due():
                search.add(found)
            text = f"{len(search.candidates)} candidates"
            report("looking", seen, max(seen, source.frame_count), text)
        for found in ahead.take_all():
            search.add(found)
        search.finish()
        return search, seen, [*source.list_notes(seen), *_note_cuts(source.path, search.cuts)]


def _note_cuts(path: Path, cuts: Sequence[float]) -> list[str]:
    if not cuts:
        return []
    return [
        f"{path.name} is cut at {list_some([f'{time:.1f} s' for time in cuts])}: it may show "
        "several places, of which the largest that connects becomes the scene; to choose one, give "
        "a film of it alone"
    ]


def _judge(
    path: Path,
    candidates: Sequence[Candidate],
    seen: int,
    stated: tuple[int, float],
    rate: float,
) -> list[str]:
    """Returns notes on the video.

    Args:
        stated: number of frames and seconds according to the file.

    Raises:
        InputError: no scene can be made of it.
    """
    if not candidates:
        raise InputError(
            f"{path}: no frame of the video can be decoded: it is damaged, or its codec is not "
            "known here; convert it: ffmpeg -i IN -c:v libx264 -crf 16 OUT.mp4"
        )
    if seen < FEWEST_FRAMES:
        raise InputError(
            f"{path}: the video has {seen} frames; film for ten seconds or more, walking around "
            "or past what you want to see"
        )
    way = sum(c.moved for c in candidates)
    if way < _STILL:
        raise InputError(
            f"{path}: the video shows one still picture: in {seen / rate:.0f} s the view moves by "
            f"{100 * way:.1f} % of its diagonal; walk with the camera, so that things are seen "
            "from several sides"
        )
    announced, seconds = stated
    end = candidates[-1].time
    if seen < _CUT_OFF * announced and end > _CUT_OFF * announced / rate:
        return [
            f"the time stamps of {path.name} jump: {seen} frames in {end:.1f} s at {rate:.3g} a "
            "second; it may be pasted from several recordings"
        ]
    # An index may list frames that are not shown: they are missing if their time is, too.
    if seen < _CUT_OFF * announced and seen < _CUT_OFF * seconds * rate:
        return [
            f"{path.name} ends after {seen} of {announced} frames ({end:.1f} s): "
            "it was cut off or is damaged; the frames before are used"
        ]
    return []


def _name_frames(chosen: Sequence[Candidate], rate: float) -> tuple[list[str], float]:
    """Names frames by numbers that give the time: at a constant frame rate, their own numbers.

    Returns:
        The names, and the numbers per second.
    """
    times = np.array([c.time for c in chosen])
    steady = max((abs(c.time * rate - c.number) for c in chosen), default=0) < 0.5
    numbers = [c.number for c in chosen] if steady else [round(t) for t in times * rate]
    while len(set(numbers)) < len(numbers):  # frames nearer than the mean: count in finer steps
        rate *= 2
        numbers = [round(t) for t in times * rate]
    digits = max(_FEWEST_DIGITS, len(str(max(numbers))))  # names are sorted as text
    return [f"f{number:0{digits}d}.jpg" for number in numbers], rate


def _write(
    files: Sequence[Path],
    chosen: Sequence[Candidate],
    names: Sequence[str],
    folder: Path,
    report: OnProgress,
) -> dict[int, list[list[float]]]:
    """Writes the frames; returns the flow at each, by its number."""
    import cv2

    wanted = dict(zip((c.number for c in chosen), names, strict=True))
    reach = range(-FRAMES_BESIDE, FRAMES_BESIDE + 1)
    beside = {number + step for number in wanted for step in reach}
    for stale in set(folder.glob("f*.jpg")) - {folder / name for name in names}:
        stale.unlink()

    def write(number: int, time: float, picture: Decode) -> FlowFrame | None:
        """Writes a frame if it is chosen; returns it small unless it is damaged."""
        pixels = picture()
        if pixels is None and number in wanted:
            raise InputError(f"{files[0]}: frame {number} cannot be decoded twice; copy it again")
        if pixels is None:
            return None
        if number in wanted:
            write_picture(folder / wanted[number], pixels, JPEG_QUALITY)
        return shrink_frame(number, time, cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))

    with Video(*files) as source, make_pool() as pool:
        search, ahead = FlowSearch(wanted, pool), WorkAhead[FlowFrame | None](pool)

        def add(frame: FlowFrame | None) -> None:
            if frame is None:
                return
            search.add(frame)
            if frame.number in wanted:
                name = wanted[frame.number]
                report("frames", names.index(name) + 1, len(names), name)

        for number, time, picture in source.read_frames():
            if number > chosen[-1].number + FRAMES_BESIDE:
                break
            if number in beside:
                ahead.submit(write, number, time, picture)
            for frame in ahead.take_due():
                add(frame)
        for frame in ahead.take_all():
            add(frame)
        return search.finish()
