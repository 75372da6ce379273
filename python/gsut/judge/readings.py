"""Hypotheses of poses that were misread: direction, axes, quaternions, mirrors, bodies."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator

import numpy as np

from gsut._core import exp_pose
from gsut.data.poses import OPENGL_FROM_OPENCV
from gsut.gaussians import quaternion_from_rotation, rotations_from_quaternions
from gsut.judge.hypotheses import Dataset, Hypothesis, Rate, Variant, Variants, climb

_OPENGL = OPENGL_FROM_OPENCV[:3, :3]
# A robot's body axes (x forward, y left, z up) from OpenCV's camera axes.
_ROS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# Quaternions w, x, y, z by the numbers of those that were read, and in words.
_ORDERS = {
    (3, 0, 1, 2): "x y z w in the file, where w x y z was read",
    (1, 2, 3, 0): "w x y z in the file, where x y z w was read",
}
_UPSIDE_DOWN = np.diag([-1.0, -1.0, 1.0])  # camera axes of a photograph turned by 180 degrees


def list_signed_permutations() -> Iterator[np.ndarray]:
    """Yields the 48 (3, 3) matrices that permute axes and change signs."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            yield np.eye(3)[list(order)] * np.array(signs)[:, None]


@functools.cache
def _name_axes() -> dict[str, np.ndarray]:
    """Names all 24 camera axes, those in use first."""
    known = {"OpenCV": np.eye(3), "OpenGL": _OPENGL, "ROS body": _ROS}
    words = (("right", "left"), ("down", "up"), ("forward", "backward"))
    for axes in list_signed_permutations():
        if np.linalg.det(axes) > 0 and not any(np.array_equal(axes, a) for a in known.values()):
            places = np.argmax(np.abs(axes), axis=1)
            named = [words[k][int(row[k] < 0)] for k, row in zip(places, axes, strict=True)]
            known[f"x, y, z = {', '.join(named)}"] = axes
    return known


def _list_axes(data: Dataset) -> list[tuple[str, str, np.ndarray]]:
    """Lists camera axes, the file's own first: words, the factor on its matrices, (3, 3)."""
    rows = []
    for name, axes in _name_axes().items():
        change = axes @ data.file_axes.T
        own = np.array_equal(change, np.eye(3))
        rows.append(("", "", axes) if own else (f" with {name} camera axes",
                                                f" @ {_format_axes(change)}", axes))  # fmt: skip
    return sorted(rows, key=lambda row: bool(row[0]))


def _format_axes(axes: np.ndarray) -> str:
    """Formats a signed permutation as a factor, in numpy's words."""
    if np.array_equal(axes, np.diag(np.diag(axes))):
        return f"diag({', '.join(f'{int(value)}' for value in np.diag(axes))}, 1)"
    rows = "; ".join(" ".join(f"{int(value)}" for value in row) for row in axes)
    return f"[{rows}] (3 x 3, of the rotation)"


def _split(data: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Returns rotations (V, B, 3, 3) and translations (V, B, 3) as in the file."""
    return data.poses[..., :3, :3] @ data.file_axes, data.poses[..., :3, 3]


def _rotate(rotation: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.einsum("...ij,...j->...i", rotation, t)


def _transpose(rotation: np.ndarray) -> np.ndarray:
    return np.swapaxes(rotation, -1, -2)


def _suppose_inverses(data: Dataset, _: Rate) -> Variants:
    r, t = _split(data)
    for words, edit, axes in _list_axes(data):
        center = -_rotate(_transpose(r), t)
        yield Variant(words, edit, data.move(_transpose(r) @ axes, center))


def _suppose_axes(data: Dataset, _: Rate) -> Variants:
    r, t = _split(data)
    for words, edit, axes in _list_axes(data)[1:]:
        if np.array_equal(axes @ data.file_axes.T, _UPSIDE_DOWN):
            words += " (or the photographs are upside down: turn them by 180 degrees)"
        yield Variant(words, edit, data.move(r @ axes, t))


def _suppose_parts(data: Dataset, _: Rate) -> Variants:
    r, t = _split(data)
    translations = (
        ("", "", lambda _: t),
        (" and the translation as world-to-camera's", " and t by -R @ t", lambda r: -_rotate(r, t)),
        (" and the translation as minus the position in camera axes", " and t by -R.T @ t",
         lambda r: -_rotate(_transpose(r), t)),
    )  # fmt: skip
    for which, rotation in (("as it is", r), ("transposed", _transpose(r))):
        for words, edit, find in translations:
            for name, _factor, axes in _list_axes(data)[:3]:
                if rotation is not r or words:
                    text = f"{which}{words}{name}"
                    edits = f"R by {'R' if rotation is r else 'R.T'}{edit}"
                    yield Variant(text, edits, data.move(rotation @ axes, find(rotation)))


def _suppose_quaternions(data: Dataset, _: Rate) -> Variants:
    r, t = _split(data)
    kinds = itertools.product((False, True), _ORDERS, (np.eye(3), _OPENGL))
    for inverse, order, before in kinds:
        old = r @ before
        q = quaternion_from_rotation(_transpose(old) if inverse else old)
        new = rotations_from_quaternions(q[..., list(order)].reshape(-1, 4)).reshape(r.shape)
        new = _transpose(new) if inverse else new
        in_camera = -_rotate(_transpose(old), t)  # the file's tvec, if it was one
        for center, after in itertools.product(
            (t, -_rotate(new, in_camera)), (data.file_axes, np.eye(3), _OPENGL)
        ):
            name = f"{'world-to-camera' if inverse else 'camera-to-world'}, {_ORDERS[order]}"
            yield Variant(name, "", data.move(new @ before.T @ after, center))


def _suppose_mirrors(data: Dataset, _: Rate) -> Variants:
    r, t = _split(data)
    for axes in list_signed_permutations():
        if not np.array_equal(axes, np.eye(3)):
            words = "mirrored" if np.linalg.det(axes) < 0 else "turned"
            yield Variant(words, _format_axes(axes), data.move(r @ data.file_axes, t @ axes.T))


def _suppose_left_hands(data: Dataset, _: Rate) -> Variants:
    r, t = _split(data)
    for axis, (name, _factor, axes) in itertools.product(range(3), _list_axes(data)):
        mirror = np.eye(3) - 2 * np.diag(np.eye(3)[axis])
        words = f"in {'xyz'[axis]} (left-handed axes, as of a game engine; or the photographs are "
        yield Variant(f"{words}mirrored){name}", _format_axes(mirror),
                      data.move(mirror @ r @ mirror @ axes, t @ mirror))  # fmt: skip


def _suppose_bodies(data: Dataset, rate: Rate) -> Variants:
    def turn(axes: np.ndarray, x: np.ndarray) -> Dataset:
        rotation = data.poses[..., :3, :3] @ axes @ exp_pose([0.0, 0.0, 0.0, *x])[:3, :3]
        return data.move(rotation, data.poses[..., :3, 3])

    tilts = [np.array(x) for x in itertools.product((-0.3, 0.0, 0.3), repeat=3)]
    found = []
    for axes in _name_axes().values():
        best = max((float(np.mean(rate(turn(axes, x)))), number) for number, x in enumerate(tilts))
        found.append((*best, axes))
    for _, number, axes in sorted(found, key=lambda each: -each[0])[:6]:
        suppose = functools.partial(turn, axes)
        x = climb(suppose, rate, [tilts[number]], np.full(3, 0.15))
        rotation = axes @ exp_pose([0.0, 0.0, 0.0, *x])[:3, :3]
        rows = "; ".join(" ".join(f"{v:.4f}" for v in row) for row in rotation)
        yield Variant("", rows, suppose(x))


READINGS: tuple[Hypothesis, ...] = (
    Hypothesis("these poses read as world-to-camera{}",
               "replace each matrix M of the poses by inv(M){}", "poses", _suppose_inverses,
               is_gross=True),
    Hypothesis("these poses read{}", "replace each matrix M of the poses by M{}", "poses",
               _suppose_axes, is_gross=True),
    Hypothesis("these poses with the rotation read {}", "replace {}", "poses", _suppose_parts,
               is_gross=True),
    Hypothesis("these poses with their quaternions read in another order ({})",
               "reorder the quaternions in the file of poses (or begin a trajectory with its "
               "columns' names: # name tx ty tz qw qx qy qz), or where matrices were made of them",
               "poses", _suppose_quaternions, is_gross=True),
    Hypothesis("these poses with their positions {} against their rotations",
               "replace each position t by {} @ t", "poses", _suppose_mirrors, is_gross=True),
    Hypothesis("these poses in a world mirrored {}",
               "replace each matrix M by S @ M @ S, S = {}", "poses", _suppose_left_hands,
               is_gross=True),
    Hypothesis("these poses as a body's on which the camera is turned",
               "multiply each camera-to-world matrix by the camera's place on the body (inverse "
               "of Kalibr's T_cam_imu); its rotation is about [{}]", "poses", _suppose_bodies,
               is_gross=True, free=3),
)  # fmt: skip
