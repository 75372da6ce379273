"""Surveyed points place poses in their world; check points show the error that is left."""

import json
import math

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from box_room import BoxRoom
from gsut.data import Frame, write_transforms
from gsut.data.poses import find_centers
from gsut.sfm import PosesOptions, find_poses
from gsut.sfm.mapping import PosesLog
from gsut.sfm.world import find_control, place_by_control

CAMERA = gsut.Camera("pinhole", [250.0, 250.0, 200.0, 150.0], 400, 300)
GRID = np.array([432000.0, 5412000.0, 300.0])  # the room's corner in the grid of a country
SURVEYED = {  # in the room
    "A": (-2.6, 3.0, 0.9), "B": (2.2, 3.0, 2.9), "C": (-1.5, 3.0, 2.9), "D": (0.3, 2.6, 0.4),
    "E": (-2.4, 3.0, 2.1), "F": (1.6, 3.0, 1.0), "G": (0.2, 2.6, 1.9),
}  # fmt: skip
CHECKS = ("C", "F", "G")
PICTURES = 10
SIGMA = 0.002


def look_at_the_wall(number):
    """World-from-camera pose of a picture: in a row before the wall, looking at it."""
    pose, yaw = np.eye(4), 0.25 * math.sin(2.0 * number)
    forward = np.array([math.sin(yaw), math.cos(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
    pose[:3, 3] = -1.8 + 0.35 * number, -1.6 + 0.4 * math.cos(number), 1.4 + 0.25 * (number % 3)
    return pose


def list_rows(noise=0.05):  # half a pixel of a picture ten times as large
    """Lists the lines of a control file, one a pixel."""
    room, rng, rows = BoxRoom(), np.random.default_rng(3), []
    for name, place in SURVEYED.items():
        use = "check" if name in CHECKS else "control"
        stated = ",".join(map(repr, (np.array(place) + GRID).tolist()))
        for number in range(PICTURES):
            pose = look_at_the_wall(number)
            pixel, valid = CAMERA.project((np.array([place]) - pose[:3, 3]) @ pose[:3, :3])
            ray = np.array(place) - pose[:3, 3]
            away = np.linalg.norm(ray)
            is_seen = room.trace(pose[:3, 3], ray[None] / away)[0][0] > away - 1e-6
            u, v = pixel[0] + noise * rng.standard_normal(2)
            if valid[0] and is_seen and 3 < u < 397 and 3 < v < 297:
                rows.append(f"{name},{use},{stated},{SIGMA},{number}.png,{u:.6f},{v:.6f}")
    return rows


def write_control(file, rows):
    file.write_text("\n".join(["name,use,x,y,z,sigma,picture,u,v", *rows]) + "\n")
    return str(file)


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """Ten pictures of a wall of the room, and their true centres in the grid."""
    folder = tmp_path_factory.mktemp("wall")
    (folder / "images").mkdir()
    room, frames = BoxRoom(), []
    for number in range(PICTURES):
        pose = look_at_the_wall(number)
        name = f"images/{number}.png"
        cv2.imwrite(str(folder / name), room.render(CAMERA, pose)[..., ::-1])
        frames.append(Frame(name, folder / name, CAMERA, pose))
    write_transforms(folder / "transforms.json", frames)
    return folder


@pytest.fixture(scope="module")
def placed(wall, tmp_path_factory):
    """Poses in the world of the control points, and the run before it was placed there."""
    folder, before = tmp_path_factory.mktemp("placed"), []
    options = PosesOptions(
        control=write_control(folder / "control.csv", list_rows()), max_features=1500
    )
    with pytest.MonkeyPatch.context() as patch:
        place = lambda mapping: before.append(mapping) or place_by_control(mapping)  # noqa: E731
        patch.setattr("gsut.sfm.pipeline.place_by_control", place)
        return find_poses(wall, folder / "out", options=options), before[0]


def place_by(mapping, file, rows):
    """Places a run by other rows; returns its figures of control points, and its notes."""
    notes = []
    options = PosesOptions(control=write_control(file, rows))
    mapping = mapping.replace(options=options, log=PosesLog(on_note=notes.append))
    return place_by_control(mapping).found.figures["control"], notes


def test_poses_with_control_points_are_in_their_world(placed):
    result, _ = placed
    figures = json.loads((result.path / "poses.json").read_text())["control"]
    rows = {row["name"]: row for row in figures["points"]}
    assert sorted(rows) == sorted(SURVEYED) and figures["in_adjustment"]
    assert [name for name in rows if rows[name]["use"] == "check"] == list(CHECKS)
    found = find_centers(result.solution.camera_from_world)
    east_north_up = found[:, [0, 2, 1]] * [1, 1, -1] + figures["origin"]
    true = np.array([look_at_the_wall(n)[:3, 3] for n in range(PICTURES)]) + GRID
    lengths = [np.linalg.norm(each[-1] - each[0]) for each in (east_north_up, true)]
    off = np.linalg.norm(east_north_up - true, axis=1)
    print(off.max(), lengths[0] / lengths[1] - 1, figures)
    assert off.max() < tolerances.CONTROL_CENTER
    assert abs(lengths[0] / lengths[1] - 1) < tolerances.CONTROL_LENGTH
    checks = np.array([rows[name]["residual"] for name in CHECKS])
    assert np.linalg.norm(checks, axis=1).max() < tolerances.CONTROL_CHECK


def test_control_points_take_part_in_the_adjustment(placed, tmp_path):
    # One point's stated place is moved by more than its sigma: the adjustment distributes what a
    # similarity alone leaves.
    exact, _ = place_by(placed[1], tmp_path / "control.csv", list_rows(noise=0.0))
    rows = [row.replace(",302.9,", ",302.93,") for row in list_rows(0.0)]
    moved, notes = place_by(placed[1], tmp_path / "moved.csv", rows)
    by_name = {row["name"]: row for row in moved["points"]}
    worst = max(np.linalg.norm(row["residual"]) for row in exact["points"])
    assert worst < tolerances.CONTROL_CHECK
    assert abs(by_name["B"]["residual"][2]) > 3 * SIGMA
    assert any("standard deviations off" in note for note in notes)


BAD = {
    "lacks a column": (["name,use,x,y,z,picture,u,v"], "lacks sigma"),
    "unknown picture": ([*list_rows(), "A,,,,,,other.png,1,2"], "0 photographs are named other"),
    "one observation": ([*list_rows(), "H,check,1,2,3,0.1,0.png,5,5"], "in 0.png alone"),
    "two control points": (
        [row for row in list_rows() if row[0] in "ABC"], "2 of 3 points are control points"
    ),
    "all on a line": (
        [f"{n},control,{i},{i},{i},0.1,{k}.png,5,5" for i, n in enumerate("ABC") for k in (0, 1)],
        "lie on a line",
    ),
    "stated twice": ([*list_rows(), "A,control,1,2,3,0.1,9.png,5,5"], "differs from its first"),
    "no number": (["A,control,1,2,x,0.1,0.png,5,5"], "must be numbers"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_control_file_that_is_wrong_is_refused_in_one_sentence(case, tmp_path):
    rows, words = BAD[case]
    file = write_control(tmp_path / "control.csv", rows)
    if case == "lacks a column":
        (tmp_path / "control.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(gsut.InputError, match=words) as caught:
        find_control(file, [f"images/{n}.png" for n in range(PICTURES)])
    assert str(caught.value).startswith(file) and "\n" not in str(caught.value)


def test_control_points_with_swapped_axes_are_refused(placed, tmp_path):
    swapped = []
    for row in list_rows():
        cells = row.split(",")
        cells[2], cells[3] = cells[3], cells[2]
        swapped.append(",".join(cells))
    with pytest.raises(gsut.InputError, match="x and y are exchanged"):
        place_by(placed[1], tmp_path / "control.csv", swapped)
