"""Collects photographs, and sorts them by camera, zoom and shape: a lens each.

Ordinary photographs stay where they are, with their pixels as stored: a phone held upright stores
what its sensor saw, so that all of its photographs share one lens. Only what cannot be used so is
written again: other formats, mirrored ones, and photographs of the same camera that were turned
or shrunk. What shows a photograph turns it upright by EXIF's orientation, which copies keep.
"""

from __future__ import annotations

import collections
import concurrent.futures
import dataclasses
import functools
import math
import os
from collections.abc import Callable, Collection, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from gsut import _core
from gsut._core import InputError, __version__
from gsut.capture.exif import read_facts
from gsut.capture.facts import PhotographFacts
from gsut.capture.focal import SAME_SHAPE
from gsut.capture.folders import explain_no_photographs, list_folder
from gsut.capture.frames import IMAGES, JPEG_QUALITY, Capture, OnProgress, read_finished_capture
from gsut.capture.photograph_formats import decode_stored, require_readers
from gsut.capture.strip import write_strip
from gsut.data import CAPTURE, list_some
from gsut.data.images import IMAGE_SUFFIXES, MaskLookup, find_common_mask, find_mask_folder
from gsut.data.layouts import require_pictures
from gsut.data.scene import capture_state
from gsut.files import (
    claim_name,
    find_kind,
    reading,
    to_file_name,
    write_json,
    write_picture,
)
from gsut.lens import FocalPrior
from gsut.orientation import ORIENTATIONS, UNMIRRORED, count_turns

# Pillow's pixel formats that are used without conversion.
_AS_STORED = ("RGB", "RGBA", "L", "LA", "P", "I;16", "I;16B", "1", "I")
# Most relative difference of focal lengths of one zoom setting: EXIF rounds them.
_SAME_FOCAL = 0.03


@dataclasses.dataclass(frozen=True)
class _Plan:
    """What is done to one photograph: mirroring, a quarter turn, resizing, or nothing."""

    facts: PhotographFacts
    name: str  # as in the dataset
    turned: bool = False
    size: tuple[int, int] | None = None  # None: as it is

    @property
    def is_written(self) -> bool:
        path = self.facts.path
        is_usual = path.suffix.lower() in IMAGE_SUFFIXES and find_kind(path) == "picture"
        strange = not is_usual or self.facts.mode not in _AS_STORED
        return strange or self.is_mirrored or self.turned or self.size is not None

    @property
    def is_mirrored(self) -> bool:
        """Returns whether EXIF says that the pixels are a mirror image of what the camera saw."""
        return self.facts.orientation in UNMIRRORED

    @property
    def turns(self) -> int:
        """Counts the quarter turns clockwise that show the photograph upright, once written."""
        orientation = UNMIRRORED.get(self.facts.orientation, self.facts.orientation)
        return (count_turns(orientation) + self.turned) % 4


def collect_photographs(
    inputs: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    *,
    on_progress: OnProgress | None = None,
) -> Capture:
    """Finds photographs, reads their metadata, and fits those of one lens to one size.

    Args:
        inputs: folders, or photographs.
        out: folder that gets capture.json, strip.jpg and, in images/, copies of photographs that
            need conversion.
        on_progress: called with (stage, done, total, text).

    Returns:
        The folder. "frames" has a row for each photograph: name, path, and if the file has them
        time (seconds since the first), orientation, place, accuracy (metres), heading (degrees) and
        up (in the camera's axes); "focal_px" is the focal length in the metadata, "focal_sigma" the
        standard deviation of its logarithm, "camera" the camera's name; of several lenses these are
        of the most frequent one, "cameras" has them of all, and a row's "camera" is its number.

    Raises:
        InputError: no photographs, or a format that needs a library which is not installed.
    """
    report = on_progress or (lambda *_: None)
    found = _find_photographs(inputs)
    files, folder = found.files, Path(out)
    key = {"version": __version__, "inputs": capture_state(list(files.values()))}
    done = read_finished_capture(folder, key)
    if done is not None:
        return done
    require_readers(list(files.values()))
    notes = [*found.notes]
    facts = _read_all_facts(files, notes, report)
    if not facts:
        raise InputError(f"none of the {len(files)} photographs can be read: {notes[0]}")
    lenses = _plan_folders(facts)
    order = list(facts)
    plans = sorted((p for own in lenses for p in own), key=lambda plan: order.index(plan.name))
    (folder / IMAGES).mkdir(parents=True, exist_ok=True)
    plans, rows = _write(plans, folder, notes, report)
    first = min((p.facts.time for p in plans if p.facts.time is not None), default=0.0)
    masks_in = functools.cache(lambda root: MaskLookup(find_mask_folder(root)))
    for row, plan in zip(rows, plans, strict=True):
        f = plan.facts
        row["time"] = None if f.time is None else f.time - first
        row["orientation"] = ORIENTATIONS[plan.turns]
        row["place"] = None if f.place is None else f.place.to_values()
        row["accuracy"] = None if f.place is None else f.place.accuracy
        row["heading"] = f.heading
        row["up"] = None if plan.turned else f.up
        mask = found.masks.get(f.path) or _find_mask(f.path, plan.name, masks_in)
        mask = None if plan.is_written else mask
        row["mask"] = None if mask is None else os.path.relpath(mask, folder.resolve())
    figures: dict[str, Any] = {
        "kind": "photographs", "key": key, "inputs": [str(i) for i in inputs], "notes": notes,
        **_describe_lens(max(lenses, key=len)), "frames": rows,
    }  # fmt: skip
    if len(lenses) > 1:
        figures["cameras"] = [_describe_lens(own) for own in lenses]
        number_of = {plan.name: number for number, own in enumerate(lenses) for plan in own}
        for row, plan in zip(rows, plans, strict=True):
            row["camera"] = number_of[plan.name]
        notes += _describe_lenses(lenses)
    write_strip(folder, rows)
    write_json(folder / CAPTURE, figures)
    return Capture(folder, figures)


@dataclasses.dataclass
class _Photographs:
    """Photographs by name, the masks beside them, and what was passed over."""

    files: dict[str, Path] = dataclasses.field(default_factory=dict)
    masks: dict[Path, Path] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)


def find_photograph_files(inputs: Sequence[str | os.PathLike[str]]) -> dict[str, Path]:
    """Finds the photographs in each folder, see `list_folder`, by name.

    Raises:
        InputError: an input does not exist, or there is no photograph at all.
    """
    return _find_photographs(inputs).files


def _find_photographs(inputs: Sequence[str | os.PathLike[str]]) -> _Photographs:
    found, seen = _Photographs(), set[Path]()
    for given in map(Path, inputs):
        if given.is_dir():
            listed = list_folder(given)
            home, root, paths = given, listed.root, listed.photographs
            found.masks |= listed.masks
            found.notes += filter(None, [listed.describe_rest()])
        elif given.is_file():
            home = root = given.parent
            paths = [given] if find_kind(given) not in ("", "video") else []
        else:
            raise InputError(f"{given}: no such file or folder; give a video or photographs")
        # Folders in images are cameras; those of a memory card are not.
        between = "/" if root != home else "-"
        for path in paths:
            real = path.resolve()
            if real not in seen:
                seen.add(real)
                name = between.join(path.relative_to(root).parts)
                found.files[_name_uniquely(name, home, found.files)] = path
    if not found.files:
        for path in map(Path, inputs):
            require_pictures(path)
        raise explain_no_photographs(list(map(Path, inputs)))
    return found


def _name_uniquely(name: str, folder: Path, taken: Collection[str]) -> str:
    """Puts as much of a folder's path before a name as makes it differ from those taken."""
    above = folder.resolve().parts[1:]
    depth = 0
    longer = name
    while longer in taken and depth < len(above):
        depth += 1
        longer = "/".join((*above[-depth:], name))
    return longer


def _read_all_facts(
    files: dict[str, Path], notes: list[str], report: OnProgress
) -> dict[str, PhotographFacts]:
    facts: dict[str, PhotographFacts] = {}
    doubted: dict[str, list[str]] = {}
    for done, (name, path) in enumerate(files.items(), 1):
        try:
            facts[name] = read_facts(path)
        except InputError as error:
            notes.append(f"left out: {error}")
        else:
            for note in facts[name].notes:
                doubted.setdefault(note, []).append(name)
        report("photographs", done, 2 * len(files), name)
    notes += [f"{list_some(names)}: {note}" for note, names in doubted.items()]
    return facts


def _plan_folders(facts: dict[str, PhotographFacts]) -> list[list[_Plan]]:
    """Plans the photographs of each lens; those of different folders are of different cameras."""
    folders: dict[str, dict[str, PhotographFacts]] = {}
    for name, f in facts.items():
        folders.setdefault(name.rpartition("/")[0].partition("/")[0], {})[name] = f
    return [plans for own in folders.values() for plans in _plan_lenses(own)]


def _plan_lenses(facts: dict[str, PhotographFacts]) -> list[list[_Plan]]:
    """Plans the photographs of each camera, zoom and shape; those of the most frequent come first.

    Photographs that do not name their camera are of the most frequent one, if their size fits.
    """
    groups: dict[tuple[str, float], list[str]] = {}
    for name, f in facts.items():
        focal = 0.0 if f.focal is None else f.focal.px / math.hypot(f.width, f.height)
        key = next(
            (k for k in groups if k[0] == f.camera and abs(k[1] - focal) <= _SAME_FOCAL * focal),
            (f.camera, focal),
        )
        groups.setdefault(key, []).append(name)
    left = sorted(groups.values(), key=len, reverse=True)
    found = []
    while left:
        sizes = collections.Counter((facts[n].width, facts[n].height) for n in left[0])
        size = sizes.most_common(1)[0][0]
        plans = []
        for number, names in enumerate(left):
            for name in names.copy():
                f = facts[name]
                is_nameless = not f.camera and sorted((f.width, f.height)) == sorted(size)
                is_nameless = is_nameless and (not number or f.focal is None)
                plan = _fit_photograph(f, name, size) if not number or is_nameless else None
                # A crop has a lens of its own, and so has what was resized nobody knows how.
                if plan is not None and (f.camera or is_nameless):
                    plans.append(plan)
                    names.remove(name)
        found.append(plans)
        left = [names for names in left if names]
    return found


def _fit_photograph(f: PhotographFacts, name: str, size: tuple[int, int]) -> _Plan | None:
    """Plans how a photograph gets this size; None if it has another shape."""
    if (f.width, f.height) == size:
        return _Plan(f, name)
    turned = (f.width < f.height) != (size[0] < size[1])
    width, height = (f.height, f.width) if turned else (f.width, f.height)
    if abs(width / height * size[1] / size[0] - 1) > SAME_SHAPE:
        return None
    return _Plan(f, name, turned, None if (width, height) == size else size)


def _find_size(plan: _Plan) -> tuple[int, int]:
    f = plan.facts
    return plan.size or ((f.height, f.width) if plan.turned else (f.width, f.height))


def _describe_lens(plans: Sequence[_Plan]) -> dict[str, Any]:
    """Returns size, name and focal length of the photographs of one lens."""
    priors = [prior for prior in map(_scale_focal, plans) if prior is not None]
    middle = sorted(priors, key=lambda prior: prior.px)[len(priors) // 2] if priors else None
    return {
        "size": _find_size(plans[0]),
        "camera": collections.Counter(p.facts.camera for p in plans).most_common(1)[0][0],
        "focal_px": None if middle is None else middle.px,
        "focal_sigma": None if middle is None else middle.sigma,
    }


def _describe_lenses(lenses: Sequence[Sequence[_Plan]]) -> list[str]:
    """Describes in a sentence why photographs of one folder have several lenses, if so."""
    if len(lenses) == len({own[0].name.rpartition("/")[0].partition("/")[0] for own in lenses}):
        return []  # folders are cameras
    parts = [
        f"{len(own)} of {values['camera'] or 'unknown camera'}, {width} x {height}"
        + (f", {values['focal_px']:.0f} px" if values["focal_px"] else "")
        for own in lenses
        for values in [_describe_lens(own)]
        for width, height in [values["size"]]
    ]
    return [
        f"the photographs are of {len(lenses)} cameras, zooms or shapes, each with a lens of its "
        f"own: {list_some(parts, '; ')}"
    ]


def _scale_focal(plan: _Plan) -> FocalPrior | None:
    f = plan.facts
    factor = math.hypot(*_find_size(plan)) / math.hypot(f.width, f.height)
    return None if f.focal is None else f.focal.scale(factor)


def _write(
    plans: Sequence[_Plan], folder: Path, notes: list[str], report: OnProgress
) -> tuple[list[_Plan], list[dict[str, Any]]]:
    """Writes copies of photographs that need conversion; returns the plans and rows of all but
    those that cannot be decoded, which it notes.

    Raises:
        InputError: none can.
    """
    kept, rows = [], list[dict[str, Any]]()
    taken: set[str] = set()
    targets = [
        folder / IMAGES / claim_name(_name_copy(plan), taken) if plan.is_written else None
        for plan in plans
    ]
    with concurrent.futures.ThreadPoolExecutor(_core.num_threads()) as pool:
        written = pool.map(_copy, plans, targets)
        for done, (plan, copy) in enumerate(zip(plans, written, strict=True), 1):
            report("photographs", len(plans) + done, 2 * len(plans), plan.name)
            if isinstance(copy, InputError):
                notes.append(f"left out: {copy}")
                continue
            kept.append(plan)
            target = plan.facts.path.resolve() if copy is None else copy
            path = os.path.relpath(target, folder.resolve())
            # A copy stays in its folder by name: folders are cameras.
            name = plan.name if copy is None else str(PurePosixPath(plan.name).with_name(copy.name))
            rows.append({"name": name, "path": path})
    if not rows:
        raise InputError(f"none of the {len(plans)} photographs can be decoded: {notes[-1]}")
    return kept, rows


def _find_mask(path: Path, name: str, masks_in: Callable[[Path], MaskLookup]) -> Path | None:
    """Finds the mask of a photograph, as `gsut train` does: masks/NAME.png or mask.png."""
    roots = tuple(dict.fromkeys((path.parent, path.parent.parent)))
    found = (masks_in(root).find(each) for root in roots for each in (name, path.name))
    mask = next((each for each in found if each is not None), None) or find_common_mask(*roots)
    return None if mask is None else mask.resolve()


def _name_copy(plan: _Plan) -> str:
    """Names the JPEG of a photograph that is written again."""
    stem, _, suffix = plan.name.rpartition(".")
    return f"{to_file_name(stem.replace('/', '-'))}-{suffix.lower()}.jpg"


def _copy(plan: _Plan, target: Path | None) -> Path | InputError | None:
    """Writes a photograph again as JPEG, unless there is no target; returns the file, or why it
    cannot be decoded."""
    import cv2

    if target is None:
        return None
    try:
        with reading(InputError):
            pixels = decode_stored(plan.facts.path)
    except (InputError, OSError) as error:
        return InputError(f"{plan.facts.path}: the photograph is damaged ({error}); copy it again")
    if plan.is_mirrored:
        pixels = pixels[:, ::-1]
    if plan.turned:
        pixels = np.rot90(pixels)
    if plan.size is not None:
        pixels = cv2.resize(pixels, plan.size, interpolation=cv2.INTER_AREA)
    write_picture(target, np.ascontiguousarray(pixels[:, :, ::-1]), JPEG_QUALITY, plan.turns)
    return target
