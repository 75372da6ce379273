"""The usual mistakes with poses, lenses and points, each made on a copy of a good dataset."""

from __future__ import annotations

import copy
import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gsut
from changed_copy import Values, copy_of, write
from gsut.check import check_scene
from gsut.check.matches import match_neighbours
from gsut.data.poses import OPENGL_FROM_OPENCV

_GL = OPENGL_FROM_OPENCV
_ROS = np.eye(4)
_ROS[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]  # body axes from OpenCV's camera axes
_KEYS = ("transform_matrix", "transform_matrix_start", "transform_matrix_end")


@dataclasses.dataclass(frozen=True)
class Mistake:
    """One mistake.

    Args:
        name: for the table.
        says: words of which one must be in the findings for the mistake to count as named.
        make: changes the values of a transforms.json, and what else is in the folder; returns
            False where the dataset cannot hold the mistake.
        images: it changes the photographs.
        path: it changes the path, by whose longest steps images are chosen.
        needs_points: without points it is none.
    """

    name: str
    says: tuple[str, ...]
    make: Callable[[Values, Path], bool | None]
    images: bool = False
    path: bool = False
    needs_points: bool = False


def _each_pose(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Values, Path], None]:
    def make(values: Values, _: Path) -> None:
        for frame in values["frames"]:
            _change(frame, change)

    return make


def _change(frame: Values, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Changes the pose of a frame, or both of a rolling shutter's."""
    for key in _KEYS:
        if key in frame:
            frame[key] = change(np.array(frame[key], np.float64)).tolist()


def _sort_frames(values: Values) -> tuple[list[Values], np.ndarray]:
    """Returns the frames in the order of their names, and their positions (N, 3)."""
    frames = sorted(values["frames"], key=lambda frame: Path(frame["file_path"]).name)
    return frames, np.array([np.array(f["transform_matrix"])[:3, 3] for f in frames])


def _parts(m: np.ndarray, rotation: np.ndarray | None = None, t: np.ndarray | None = None):
    out = m.copy()
    out[:3, :3] = m[:3, :3] if rotation is None else rotation
    out[:3, 3] = m[:3, 3] if t is None else t
    return out


def _reordered(order: list[int]) -> Callable[[np.ndarray], np.ndarray]:
    def change(m: np.ndarray) -> np.ndarray:
        vector = cv2.Rodrigues(m[:3, :3])[0].ravel()
        angle = np.linalg.norm(vector)
        axis = vector / max(angle, 1e-12)
        q = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])[order]
        turn = 2 * np.arctan2(np.linalg.norm(q[1:]), q[0])
        axis = q[1:] / max(np.linalg.norm(q[1:]), 1e-12)
        return _parts(m, cv2.Rodrigues(turn * axis)[0])

    return change


def _degrees(m: np.ndarray) -> np.ndarray:
    return _parts(m, cv2.Rodrigues(np.degrees(cv2.Rodrigues(m[:3, :3])[0]))[0])


def _mirror(m: np.ndarray) -> np.ndarray:
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    return flip @ m @ flip


def _by_frames(shift: float) -> Callable[[Values, Path], None]:
    def make(values: Values, _: Path) -> None:
        groups: dict[str, list[dict]] = {}
        for frame in sorted(values["frames"], key=lambda frame: frame["file_path"]):
            groups.setdefault(frame["file_path"].rstrip("0123456789.jpgn"), []).append(frame)
        for group in groups.values():
            old = copy.deepcopy(group)
            for place, frame in enumerate(group):
                at = float(np.clip(place + shift, 0, len(group) - 1))
                low = min(int(at), len(group) - 2)
                for key in _KEYS:
                    if key in frame:
                        frame[key] = _between(old[low][key], old[low + 1][key], at - low)

    return make


def _between(one: Any, two: Any, share: float) -> list:
    one, two = np.array(one, np.float64), np.array(two, np.float64)
    turn = cv2.Rodrigues(two[:3, :3] @ one[:3, :3].T)[0]
    t = (1 - share) * one[:3, 3] + share * two[:3, 3]
    return _parts(one, cv2.Rodrigues(share * turn)[0] @ one[:3, :3], t).tolist()


def _shuffled(values: Values, _: Path) -> None:
    rng = np.random.default_rng(0)
    frames = values["frames"]
    chosen = rng.permutation(len(frames))[: len(frames) // 3]
    old = {int(i): {k: frames[i][k] for k in _KEYS if k in frames[i]} for i in chosen}
    for index, other in zip(chosen, np.roll(chosen, 1), strict=True):
        frames[index].update(old[int(other)])


def _lens(**factors: float | Callable[[Values], float]) -> Callable[[Values, Path], bool]:
    """fl_x=0.5 multiplies; a function gives the new value."""

    def make(values: Values, _: Path) -> bool:
        new = {
            key: factor(values) if callable(factor) else values[key] * factor
            for key, factor in factors.items()
            if key in values
        }
        changed = any(abs(new[key] - values[key]) > 1e-9 for key in new)
        values.update(new)
        for key in ("camera_angle_x", "camera_angle_y"):
            values.pop(key, None)
        return changed

    return make


def _other_model(values: Values, _: Path) -> None:
    fisheye = values.get("camera_model") == "OPENCV_FISHEYE"
    values["camera_model"] = "OPENCV" if fisheye else "OPENCV_FISHEYE"
    values.setdefault("k3", 0.0)
    values.setdefault("k4", 0.0)
    values.pop("max_theta_rad", None)
    if fisheye:
        values["p1"], values["p2"] = values.get("k3", 0.0), values.get("k4", 0.0)
        values["k3"] = values["k4"] = 0.0


def _no_distortion(values: Values, _: Path) -> None:
    values["camera_model"] = "PINHOLE"
    for key in ("k1", "k2", "k3", "k4", "p1", "p2"):
        values.pop(key, None)


def _negated(values: Values, _: Path) -> None:
    for key in ("k1", "k2", "k3", "k4", "p1", "p2"):
        if key in values:
            values[key] = -values[key]


def _swapped_size(values: Values, _: Path) -> bool:
    values["w"], values["h"] = values["h"], values["w"]
    return values["w"] != values["h"]


def _swapped_center(values: Values, _: Path) -> bool:
    values["cx"], values["cy"] = values["cy"], values["cx"]
    return abs(values["cx"] - values["cy"]) > 0.01 * values["w"]


def _new_images(values: Values, folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    linked = folder / "images"
    source = linked.resolve()
    linked.unlink()
    linked.mkdir()
    for frame in values["frames"]:
        name = Path(frame["file_path"]).name
        if not (source / name).is_file():  # listed, not there: left out on loading
            continue
        found = cv2.imread(str(source / name))
        cv2.imwrite(str(linked / name), change(found))


def _undistorted(values: Values, folder: Path) -> None:
    camera = gsut.load_dataset(write(values, folder, False)).cameras[0]
    plain = gsut.Camera("pinhole", camera.params[:4], camera.width, camera.height)
    rays = np.array(plain.rays()[0], np.float64).reshape(-1, 3)
    pixels, valid = camera.project(rays)
    where = np.where(np.asarray(valid)[:, None], pixels - 0.5, -1).astype(np.float32)
    where = where.reshape(camera.height, camera.width, 2)
    _new_images(values, folder, lambda image: cv2.remap(image, where, None, cv2.INTER_LINEAR))


def _flipped(values: Values, folder: Path) -> None:
    _new_images(values, folder, lambda image: image[:, ::-1])


def _turned_around(values: Values, folder: Path) -> None:
    _new_images(values, folder, lambda image: image[::-1, ::-1])


def _in_bgr(values: Values, folder: Path) -> None:
    _new_images(values, folder, lambda image: image[..., ::-1])


def _cropped(values: Values, folder: Path) -> bool:
    """A tenth is cut off at the left and the top; the size follows, cx and cy do not."""
    if "mask_path" in values or any("mask_path" in frame for frame in values["frames"]):
        return False
    left, top = values["w"] // 10, values["h"] // 10
    _new_images(values, folder, lambda image: image[top:, left:])
    values["w"], values["h"] = values["w"] - left, values["h"] - top
    return True


def _k3_first(values: Values, _: Path) -> bool:
    """OpenCV's k1 k2 p1 p2 k3 read from a file that has k3 before p1."""
    if values.get("camera_model") != "OPENCV":
        return False
    p1, p2, k3 = (values.get(key, 0.0) for key in ("p1", "p2", "k3"))
    values["p1"], values["p2"], values["k3"] = k3, p1, p2
    return max(abs(p1), abs(p2), abs(k3)) > _DISTORTED


def _global(values: Values, _: Path) -> bool:
    rolling = False
    for frame in values["frames"]:
        rolling |= frame.pop("transform_matrix_start", None) is not None
        frame.pop("transform_matrix_end", None)
    return rolling


def _reversed_readout(values: Values, _: Path) -> bool:
    for frame in values["frames"]:
        if "transform_matrix_start" not in frame:
            return False
        start, end = frame["transform_matrix_start"], frame["transform_matrix_end"]
        frame["transform_matrix_start"], frame["transform_matrix_end"] = end, start
    return True


def _points(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Values, Path], None]:
    def make(values: Values, folder: Path) -> None:
        from gsut.data.points import format_points_ply, load_points_ply

        path = folder / values["ply_file_path"]
        xyz, rgb = load_points_ply(path.resolve())
        path.unlink()
        path.write_bytes(format_points_ply(change(xyz), rgb))

    return make


def _scaled_positions(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda m: _parts(m, t=factor * m[:3, 3])


def _along_path(
    change: Callable[[np.ndarray, float, np.ndarray, float], np.ndarray],
) -> Callable[[Values, Path], None]:
    """`change` gets a pose, its share of the way along the path, the path's centre and size."""

    def make(values: Values, _: Path) -> None:
        groups: dict[str, list[dict]] = {}
        for frame in sorted(values["frames"], key=lambda frame: frame["file_path"]):
            groups.setdefault(frame["file_path"].rstrip("0123456789.jpgn"), []).append(frame)
        at = np.array([np.array(f["transform_matrix"])[:3, 3] for f in values["frames"]])
        center, size = at.mean(axis=0), float(np.linalg.norm(np.ptp(at, axis=0)))
        for group in groups.values():
            for place, frame in enumerate(group):
                share = place / max(len(group) - 1, 1)
                _change(frame, lambda old, share=share: change(old, share, center, size))

    return make


def _in_another_world(m: np.ndarray, share: float, _: np.ndarray, size: float) -> np.ndarray:
    world = np.eye(4)
    world[:3, :3] = cv2.Rodrigues(np.array([0.1, 0.5, 0.7]))[0]
    world[:3, 3] = np.array([0.3, -0.5, 0.2]) * size
    return world @ m if share > 0.5 else m


def _scale_steps(values: Values, _: Path) -> None:
    """Positions are summed from steps that grow to 1.5 times their length."""
    frames, at = _sort_frames(values)
    factors = np.linspace(1.0, 1.5, len(at))
    steps = np.cumsum(factors[1:, None] * np.diff(at, axis=0), axis=0)
    new = at[0] + np.concatenate([np.zeros((1, 3)), steps])
    for frame, factor, old, to in zip(frames, factors, at, new, strict=True):
        _change(frame, lambda m, f=factor, o=old, to=to: _parts(m, t=to + f * (m[:3, 3] - o)))


def _scale_half(values: Values, _: Path) -> None:
    """Positions of the second half of the path are scaled about its first one."""
    frames, places = _sort_frames(values)
    at = places[len(frames) // 2]
    for frame in frames[len(frames) // 2 :]:
        _change(frame, lambda m: _parts(m, t=at + 1.5 * (m[:3, 3] - at)))


def _turn_steps(values: Values, _: Path) -> None:
    """Poses are summed from steps that each turn a little too far, as odometry's do."""
    frames, _places = _sort_frames(values)
    turn, change = np.eye(4), np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.radians([0.0, 15.0 / max(1, len(frames) - 1), 0.0]))[0]
    before = None
    for frame in frames:
        m = np.array(frame["transform_matrix"], np.float64)
        if before is not None:  # what was added so far goes on from the last pose
            change = change @ before @ turn @ np.linalg.inv(before)
        before = m
        _change(frame, lambda m, change=change: change @ m)


def _another_run(values: Values, _: Path) -> None:
    """Poses of a path through another scene: they fit each other, not the photographs."""
    frames, at = _sort_frames(values)
    size = float(np.linalg.norm(np.ptp(at, axis=0)))
    for place, frame in enumerate(frames):
        angle = 2 * np.pi * place / len(frames)
        m, old = np.eye(4), np.array(frame["transform_matrix"], np.float64)
        m[:3, :3] = cv2.Rodrigues(np.array([0.3 * np.sin(2 * angle), -angle, 0.2]))[0]
        m[:3, 3] = size * np.array([np.cos(angle), 0.2 * np.sin(3 * angle), np.sin(angle)])
        turn = m @ np.linalg.inv(old)
        _change(frame, lambda given, turn=turn: turn @ given)


def _one_far_away(values: Values, _: Path) -> None:
    frames, at = _sort_frames(values)
    away = 3 * np.ptp(at, axis=0).max()
    _change(frames[len(frames) // 2], lambda m: _parts(m, t=m[:3, 3] + away))


def _one_turned(values: Values, _: Path) -> bool:
    """The pose in the middle is turned by 30 degrees about the camera's vertical axis."""
    frames, _places = _sort_frames(values)
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.radians([0.0, 30.0, 0.0]))[0]
    _change(frames[len(frames) // 2], lambda m: m @ turn)
    return len(frames) > _FEWEST_OF_A_TURN


def _depths(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable:
    """Writes true depths, changed; `change` gets distances and cosines to the axis."""

    def make(values: Values, folder: Path) -> bool:
        depths = (folder / "images").resolve().parent / "depth"
        if not any(depths.glob("*.txt")):
            return False
        camera = gsut.load_dataset(write(values, folder, True)).cameras[0]
        rays = np.array(camera.rays()[0], np.float64)
        cosine = rays[..., 2] / np.linalg.norm(rays, axis=-1)
        for frame in values["frames"]:
            stem = Path(frame["file_path"]).stem
            levels = cv2.imread(str(depths / f"{stem}.png"), cv2.IMREAD_UNCHANGED)
            farthest = float((depths / f"{stem}.txt").read_text("utf-8"))
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = np.where(levels > 0, levels * (farthest / 60_000), np.nan)
                np.save(folder / f"{stem}.npy", change(distance, cosine))
            frame["depth_file_path"] = f"{stem}.npy"
        return True

    return make


_FEWEST_OF_A_TURN = 8  # views: with fewer the neighbours of one are not neighbours
_SWAP = np.eye(3)[[0, 2, 1]]
_DISTORTED = 1e-3  # coefficient from which its place matters
_TILT = np.eye(4)
_TILT[:3, :3] = _ROS[:3, :3] @ cv2.Rodrigues(np.radians([0.0, 15.0, 0.0]))[0]

MISTAKES: tuple[Mistake, ...] = (
    Mistake("OpenCV axes where OpenGL's are due", ("OpenCV camera axes",),
            _each_pose(lambda m: m @ _GL)),
    Mistake("world-to-camera", ("world-to-camera",), _each_pose(np.linalg.inv)),
    Mistake("world-to-camera, OpenCV axes", ("world-to-camera",),
            _each_pose(lambda m: np.linalg.inv(m @ _GL))),
    Mistake("ROS body axes", ("ROS body",), _each_pose(lambda m: m @ _GL @ np.linalg.inv(_ROS))),
    Mistake("camera x left, y down, z backward", ("left, down, backward", "right, up, backward"),
            _each_pose(lambda m: m @ np.diag([-1.0, -1, 1, 1]))),
    Mistake("quaternions x y z w read as w x y z", ("quaternion",),
            _each_pose(_reordered([1, 2, 3, 0]))),
    Mistake("quaternions w x y z read as x y z w", ("quaternion",),
            _each_pose(_reordered([3, 0, 1, 2]))),
    Mistake("rotation vectors in degrees", ("read in degrees",), _each_pose(_degrees)),
    Mistake("rotation transposed", ("transposed", "R.T"),
            _each_pose(lambda m: _parts(m, m[:3, :3].T))),
    Mistake("tvec as position", ("translation", "-R"),
            _each_pose(lambda m: _parts(m, t=-m[:3, :3].T @ m[:3, 3]))),
    Mistake("positions mirrored in x", ("mirrored",),
            _each_pose(lambda m: _parts(m, t=m[:3, 3] * [-1, 1, 1]))),
    Mistake("positions with y and z swapped", ("positions",),
            _each_pose(lambda m: _parts(m, t=_SWAP @ m[:3, 3]))),
    Mistake("left-handed world (game engine)", ("left-handed",), _each_pose(_mirror)),
    Mistake("body poses, camera tilted on it", ("body's on which",),
            _each_pose(lambda m: m @ _GL @ np.linalg.inv(_TILT) @ _GL)),
    Mistake("clock a frame late", ("frame",), _by_frames(1.0)),
    Mistake("clock half a frame late", ("frame",), _by_frames(0.5)),
    Mistake("a third of the poses under other names", ("names",), _shuffled),
    Mistake("photographs of another scene", ("photographs of another scene",), _another_run,
            path=True),
    Mistake("half of the poses in another world", ("another world frame",),
            _along_path(_in_another_world), path=True),
    Mistake("scale of the poses drifts to 1.5", ("whose scale does not drift",),
            _scale_steps, path=True),
    Mistake("scale of half of the poses times 1.5",
            ("whose scale does not change", "another world frame"), _scale_half, path=True),
    Mistake("heading of the poses drifts by 15 degrees", ("accumulate",),
            _turn_steps, path=True),
    Mistake("one pose far away", ("stands farther from", "contradict all"), _one_far_away,
            path=True),
    Mistake("one pose turned by 30 degrees", ("contradict all", "disagree with the points"),
            _one_turned, path=True),
    Mistake("positions times 10,000", ("multiplied by 1e+04", "multiply the points by"),
            _each_pose(_scaled_positions(1e4)), needs_points=True),
    Mistake("depths in millimetres", ("along the rays times 1e+03",),
            _depths(lambda d, _: 1e3 * d), needs_points=True),
    Mistake("depths as z", ("as z along",), _depths(lambda d, c: d * c), needs_points=True),
    Mistake("depths inverse", ("the inverse of",), _depths(lambda d, _: 1 / d), needs_points=True),
    Mistake("positions in millimetres", ("millimetres",),
            _each_pose(_scaled_positions(1e3)),
            needs_points=True),
    Mistake("focal length 10 % too long", ("focal length times",), _lens(fl_x=1.1, fl_y=1.1)),
    Mistake("focal length 20 % too short", ("focal length times",), _lens(fl_x=0.8, fl_y=0.8)),
    Mistake("focal length 3 % too long", ("focal length times",), _lens(fl_x=1.03, fl_y=1.03)),
    Mistake("lens of images of half the size", ("images of another size",),
            _lens(fl_x=0.5, fl_y=0.5, cx=0.5, cy=0.5)),
    Mistake("lens of images of twice the size", ("images of another size",),
            _lens(fl_x=2.0, fl_y=2.0, cx=2.0, cy=2.0)),
    Mistake("principal point of half the size", ("principal point", "cx"), _lens(cx=0.5, cy=0.5)),
    Mistake("principal point half a pixel off", ("0.5 to cx and cy",),
            _lens(cx=lambda v: v["cx"] - 0.5, cy=lambda v: v["cy"] - 0.5)),
    Mistake("cx and cy swapped", ("cx and cy swapped", "cx"), _swapped_center),
    Mistake("width and height swapped", ("expects",), _swapped_size),
    Mistake("fisheye for radial-tangential, or reverse", ("name the model",),
            _other_model),
    Mistake("distortion left out", ("not undistorted",), _no_distortion),
    Mistake("distortion of the other sign", ("other sign", "distortion of"), _negated),
    Mistake("photographs undistorted, lens not", ("undistorted",), _undistorted, images=True),
    Mistake("photographs mirrored", ("mirrored",), _flipped, images=True),
    Mistake("photographs upside down", ("upside down",), _turned_around, images=True),
    Mistake("photographs cropped, lens not", ("crop",), _cropped, images=True),
    Mistake("coefficients k1 k2 k3 p1 p2", ("in the order k1 k2 k3 p1 p2",), _k3_first),
    Mistake("photographs in BGR", ("red and blue swapped",), _in_bgr, images=True,
            needs_points=True),
    Mistake("rolling shutter taken for a global one", ("shutter",), _global),
    Mistake("rolling shutter read out the other way", ("shutter",), _reversed_readout),
    Mistake("points in millimetres", ("millimetres",), _points(lambda p: 1e3 * p),
            needs_points=True),
    Mistake("points with y and z swapped", ("x, z, y",), _points(lambda p: p @ _SWAP.T),
            needs_points=True),
    Mistake("points with y and z flipped", ("x, -y, -z",), _points(lambda p: p * [1, -1, -1]),
            needs_points=True),
)  # fmt: skip


# --- judging --------------------------------------------------------------------------------------

NAMED, SAID, MISSED = "named", "said", "missed"
_SAID_OF_GOOD_DATA = ("there are no points;", "have no ray", "have the same pose")


def judge(
    data: Path, work: Path, only: str = "", points: Sequence[bool] = (True, False)
) -> list[dict[str, Any]]:
    """One row a mistake, with and without points; and one of the dataset as it is.

    Args:
        data: a good nerfstudio dataset. work: a folder for copies. only: of the mistakes' names.
        points: whether those that need no points are made with points, or without, or both.
    """
    rows = []
    good = gsut.load_dataset(data)
    started = time.process_time()
    findings = check_scene(good)
    seconds = time.process_time() - started
    bad = [str(finding) for finding in findings if finding.severity != "info"]
    alarms = [text for text in bad if "photographs" in text or text.startswith("error")]
    rows.append({
        "data": data.name, "mistake": "none", "with_points": True, "said": alarms,
        "verdict": "false alarm" if alarms else "good", "cpu_seconds": seconds,
    })  # fmt: skip
    matches = match_neighbours(good)
    for number, mistake in enumerate(MISTAKES):
        if only not in mistake.name:
            continue
        for with_points in (len(good.points) > 0,) if mistake.needs_points else points:
            if mistake.needs_points and not with_points:
                continue
            folder = work / f"{number}{with_points}"
            values = copy_of(data, folder)
            if mistake.make(values, folder) is False:
                continue
            said = _findings(mistake, write(values, folder, with_points), matches)
            rows.append({
                "data": data.name, "mistake": mistake.name, "with_points": with_points,
                "said": said, "verdict": _verdict(mistake, said),
            })  # fmt: skip
    return rows


def _findings(mistake: Mistake, folder: Path, matches: list) -> list[str]:
    try:
        scene = gsut.load_dataset(folder)
    except gsut.InputError as error:
        return [f"error: {error}"]
    findings = check_scene(scene, None if mistake.images or mistake.path else matches)
    texts = [str(finding) for finding in findings if finding.severity != "info"]
    return [text for text in texts if not any(words in text for words in _SAID_OF_GOOD_DATA)]


def _verdict(mistake: Mistake, said: list[str]) -> str:
    if any(word in text for text in said for word in mistake.says):
        return NAMED
    return SAID if said else MISSED
