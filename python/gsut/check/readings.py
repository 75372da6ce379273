"""Lists other readings of a dataset's poses: axes, direction, quaternions, mirrors, clock."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator

import numpy as np

from gsut._core import interpolate_pose
from gsut.check.matches import order_in_time
from gsut.data import Scene
from gsut.data.poses import OPENGL_FROM_OPENCV, invert_pose
from gsut.gaussians import quaternion_from_rotation, rotations_from_quaternions

_IN_USE = 3  # camera axes in use: OpenCV's, OpenGL's, a robot's body
_OPENGL_AXES = OPENGL_FROM_OPENCV[:3, :3]
# A robot's body axes (x forward, y left, z up) from OpenCV's camera axes.
_ROS_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_UPSIDE_DOWN = np.diag([-1.0, -1.0, 1.0])  # camera axes of a photograph turned by 180 degrees
# Frames by which poses may be late or early against the images.
_CLOCK_SHIFTS = (-3.0, -2.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)


@dataclasses.dataclass(frozen=True)
class Reading:
    """One way in which the poses may have been meant.

    Args:
        name: completes "the photographs fit these poses ...".
        advice: the edit that mends the data.
        poses: (V, B, 4, 4) world_from_camera as in the table, OpenCV axes.
    """

    name: str
    advice: str
    poses: np.ndarray


def list_readings(scene: Scene, table: np.ndarray) -> Iterator[Reading]:
    """Yields all other readings, the likelier first.

    Args:
        scene: in the dataset's coordinates.
        table: (V, B, 4, 4) its poses, see `PoseTable`.
    """
    file_axes, matrices = _undo_conversion(scene, table)
    for reading in itertools.chain(
        _read_whole_matrices(matrices, file_axes, _list_axes(file_axes)),
        _read_parts(matrices, file_axes),
        _shift_clock(scene, table), _change_shutter(table),
        _reorder_quaternions(matrices, file_axes), _mirror(matrices, file_axes),
    ):  # fmt: skip
        yield dataclasses.replace(reading, poses=reading.poses.reshape(table.shape))


def list_usual_readings(scene: Scene, table: np.ndarray) -> Iterator[Reading]:
    """Yields the few likeliest of `list_readings`: the other direction, and axes in use."""
    file_axes, matrices = _undo_conversion(scene, table)
    for reading in _read_whole_matrices(matrices, file_axes, _list_axes(file_axes)[:_IN_USE]):
        yield dataclasses.replace(reading, poses=reading.poses.reshape(table.shape))


def _undo_conversion(scene: Scene, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the file's camera axes (3, 3), and its matrices (V * B, 4, 4) before conversion."""
    is_opengl = (scene.path / "transforms.json").is_file() or scene.path.suffix == ".json"
    file_axes = _OPENGL_AXES if is_opengl else np.eye(3)
    matrices = table.reshape(-1, 4, 4).copy()
    matrices[:, :3, :3] = matrices[:, :3, :3] @ file_axes
    return file_axes, matrices


def _list_axes(file_axes: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Lists all 24 ways to name a camera's axes, the file's own first, then those in use."""
    known = _name_all_axes()
    own = next(name for name, axes in known.items() if np.array_equal(axes, file_axes))
    return [(own, file_axes)] + [(name, axes) for name, axes in known.items() if name != own]


@functools.cache
def _name_all_axes() -> dict[str, np.ndarray]:
    known = {"OpenCV": np.eye(3), "OpenGL": _OPENGL_AXES, "ROS body": _ROS_AXES}
    assert len(known) == _IN_USE
    for axes in list_signed_permutations():
        if np.linalg.det(axes) > 0 and not any(np.array_equal(axes, a) for a in known.values()):
            known[f"x, y, z = {_describe_axes(axes)}"] = axes
    return known


def list_signed_permutations() -> Iterator[np.ndarray]:
    """Yields the 48 (3, 3) matrices that permute axes and change signs."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            yield np.eye(3)[list(order)] * np.array(signs)[:, None]


def _describe_axes(axes: np.ndarray) -> str:
    """Says where each axis of the file's camera points, such as "right, up, backward"."""
    words = (("right", "left"), ("down", "up"), ("forward", "backward"))
    found = []
    for row in axes:
        axis = int(np.argmax(np.abs(row)))
        found.append(words[axis][int(row[axis] < 0)])
    return ", ".join(found)


def _make_poses(rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    result = np.tile(np.eye(4), (len(rotation), 1, 1))
    result[:, :3, :3], result[:, :3, 3] = rotation, center
    return result


def _list_centers(rotation: np.ndarray, t: np.ndarray) -> list[tuple[str, str, np.ndarray]]:
    """Lists the positions that `t` may mean beside a rotation world_from_camera.

    Returns:
        Words for the reading's name, the edit that mends the data, (N, 3) positions.
    """
    return [
        ("", "", t),
        (
            ", their translation as world-to-camera's",
            " and t by -R @ t", -np.einsum("nij,nj->ni", rotation, t),
        ),
        (
            ", their translation as minus the position in camera axes",
            " and t by -R.T @ t", -np.einsum("nji,nj->ni", rotation, t),
        ),
    ]  # fmt: skip


def _read_whole_matrices(
    matrices: np.ndarray, file_axes: np.ndarray, all_axes: list[tuple[str, np.ndarray]]
) -> Iterator[Reading]:
    """Reads each matrix as it is or inverted, with each of these camera axes."""
    r, t = matrices[:, :3, :3], matrices[:, :3, 3]
    transposed = np.swapaxes(r, 1, 2)
    minus = -np.einsum("nij,nj->ni", transposed, t)
    wholes = [
        ("", "M", r, t),
        ("as world-to-camera", "inv(M)", transposed, minus),
    ]
    for (name, text, rotation, center), (number, (axes_name, axes)) in itertools.product(
        wholes, enumerate(all_axes)
    ):
        if not name and number == 0:
            continue
        with_axes = f"with {axes_name} camera axes" if number else ""
        if not name and np.array_equal(axes @ file_axes.T, _UPSIDE_DOWN):
            with_axes += " (or the photographs are upside down: turn them by 180 degrees)"
        product = f"{text} @ {_format_axes(axes @ file_axes.T)}" if number else text
        yield Reading(
            " ".join(["read", *filter(None, (name, with_axes))]),
            f"replace each matrix M of the poses by {product}",
            _make_poses(rotation @ axes, center),
        )


def _read_parts(matrices: np.ndarray, file_axes: np.ndarray) -> Iterator[Reading]:
    """Reads the rotation and the translation of each matrix by different conventions."""
    r, t = matrices[:, :3, :3], matrices[:, :3, 3]
    for name, rotation in (
        ("", r),
        ("with the rotation transposed", np.swapaxes(r, 1, 2)),
    ):
        for words, edit, center in _list_centers(rotation, t):
            if not name and not words:
                continue
            for number, (axes_name, axes) in enumerate(_list_axes(file_axes)[:_IN_USE]):
                with_axes = f" and {axes_name} camera axes" if number else ""
                yield Reading(
                    f"read {name}{words}{with_axes}".replace("read ,", "read with"),
                    f"replace R by {'R.T' if name else 'R'}{edit}",
                    _make_poses(rotation @ axes, center),
                )


def _format_axes(axes: np.ndarray) -> str:
    """Formats a signed permutation as the factor on a camera-to-world matrix, in numpy's words."""
    if np.array_equal(axes, np.diag(np.diag(axes))):
        signs = ", ".join(f"{int(value)}" for value in np.diag(axes))
        return f"diag({signs}, 1)"
    rows = "; ".join(" ".join(f"{int(value)}" for value in row) for row in axes)
    return f"[{rows}] (3 x 3, of the rotation)"


def _reorder_quaternions(matrices: np.ndarray, file_axes: np.ndarray) -> Iterator[Reading]:
    """Reads each rotation's quaternion as w x y z instead of x y z w, and the reverse."""
    for kind, (name, order) in itertools.product(
        ("camera-to-world", "world-to-camera"),
        (("x y z w where w x y z is read", (3, 0, 1, 2)),
         ("w x y z where x y z w is read", (1, 2, 3, 0))),
    ):  # fmt: skip
        for before in (np.eye(3), _OPENGL_AXES):
            r = matrices[:, :3, :3] @ before
            r = np.swapaxes(r, 1, 2) if kind == "world-to-camera" else r
            rotation = rotations_from_quaternions(quaternion_from_rotation(r)[:, order])
            if kind == "world-to-camera":
                rotation = np.swapaxes(rotation, 1, 2)
            old = np.swapaxes(r, 1, 2) if kind == "world-to-camera" else r
            t = matrices[:, :3, 3]
            in_camera = -np.einsum("nji,nj->ni", old, t)  # the file's tvec, if it was one
            centers = [t, -np.einsum("nij,nj->ni", rotation, in_camera)]
            for center, after in itertools.product(centers, (file_axes, np.eye(3), _OPENGL_AXES)):
                yield Reading(
                    f"with their quaternions read in another order ({name})",
                    "reorder the quaternion's four numbers in the poses' file, or where the "
                    "matrices were made from them",
                    _make_poses(rotation @ before.T @ after, center),
                )


def _mirror(matrices: np.ndarray, file_axes: np.ndarray) -> Iterator[Reading]:
    """Turns or mirrors positions against rotations, and mirrors the whole world."""
    r, t = matrices[:, :3, :3], matrices[:, :3, 3]
    for axes in list_signed_permutations():
        if np.array_equal(axes, np.eye(3)):
            continue
        words = "mirrored" if np.linalg.det(axes) < 0 else "turned"
        yield Reading(
            f"with their positions {words} against their rotations",
            f"replace each position t by {_format_axes(axes)} @ t",
            _make_poses(r @ file_axes, t @ axes.T),
        )
    for axis, flip in enumerate(np.eye(3)):
        mirror = np.eye(3) - 2 * np.diag(flip)
        for number, (axes_name, axes) in enumerate(_list_axes(file_axes)):
            with_axes = f" and {axes_name} camera axes" if number else ""
            yield Reading(
                f"in a world mirrored in {'xyz'[axis]} (left-handed axes, as of a game engine; or "
                "the photographs are mirrored)" + with_axes,
                f"replace each matrix M by S @ M @ S, S = {_format_axes(mirror)}",
                _make_poses(mirror @ r @ mirror @ axes, t @ mirror),
            )


def _change_shutter(table: np.ndarray) -> Iterator[Reading]:
    """Replaces a rolling shutter by a global one, and by one of the other direction."""
    moments = table.shape[1]
    if moments == 1:
        return
    middle = np.repeat(table[:, moments // 2 : moments // 2 + 1], moments, axis=1)
    yield Reading("of a global shutter", "train with --shutter global", middle)
    yield Reading(
        "with the shutter's direction reversed",
        "write the other direction into 'rolling_shutter', or swap start and end poses",
        table[:, ::-1],
    )


def _shift_clock(scene: Scene, table: np.ndarray) -> Iterator[Reading]:
    """Moves each image's pose by some frames along the camera's path."""
    groups = [group for group in order_in_time(scene) if len(group) > 3]
    for shift in _CLOCK_SHIFTS if groups else ():
        poses = table.copy()
        for group in groups:
            last = len(group) - 1
            for place, index in enumerate(group):
                at = min(max(place + shift, 0.0), float(last))
                low = min(int(at), last - 1)
                poses[index] = _interpolate_poses(
                    table[group[low]], table[group[low + 1]], at - low
                )
        frames = f"{abs(shift):g} frame{'' if abs(shift) == 1 else 's'}"
        yield Reading(
            f"when each image takes the pose of {frames} {'later' if shift > 0 else 'earlier'}",
            "shift the poses' clock against the images' by as much, or pair names and poses again",
            poses,
        )


def _interpolate_poses(one: np.ndarray, two: np.ndarray, share: float) -> np.ndarray:
    """Returns the poses (B, 4, 4) at a share of the way from one view's to the next one's."""
    if share in (0.0, 1.0):
        return two if share else one
    pairs = zip(one, two, strict=True)
    return np.stack(
        [
            invert_pose(np.asarray(interpolate_pose(invert_pose(a), invert_pose(b), share)))
            for a, b in pairs
        ]
    )
