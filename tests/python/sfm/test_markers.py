"""Markers of a known size in the pictures give metres, by features like all others."""

import json
import math

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from box_room import ROOM, BoxRoom
from gsut.data import Frame, write_transforms
from gsut.sfm import PosesOptions, find_poses
from gsut.sfm.world.markers import find_markers

EDGE = 0.9  # metres
AT = {7: (-1.2, 1.7), 11: (0.9, 2.85)}  # x and z of the markers' centres on the wall y = 3
DICTIONARY = "DICT_APRILTAG_36h11"
_CELLS = 8  # of a marker's side, with its black border


class MarkerRoom(BoxRoom):
    """The room with two markers on a wall."""

    def trace(self, origins, rays):
        """Finds distances (N,) and colours (N, 3) along unit rays (N, 3)."""
        distance, colors = super().trace(origins, rays)
        points = np.broadcast_to(origins, rays.shape) + distance[:, None] * rays
        codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
        for number, (x, z) in AT.items():
            marker = cv2.aruco.generateImageMarker(codes, number, _CELLS) / 255.0
            cell = (points[:, [0, 2]] - [x, z]) * [-1, -1] * _CELLS / EDGE + _CELLS / 2
            on_wall = np.abs(points[:, 1] - ROOM[1][1]) < 1e-9
            white = on_wall & (np.abs(cell - _CELLS / 2) < _CELLS / 2 + 1).all(axis=1)
            colors[white] = 1.0
            inside = white & (np.abs(cell - _CELLS / 2) < _CELLS / 2).all(axis=1)
            u, v = cell[inside].astype(int).T
            colors[inside] = marker[v, _CELLS - 1 - u][:, None]
        return distance, colors


def look_at_the_wall(number):
    """World-from-camera pose of a picture: in a row before the wall, looking at it."""
    pose, yaw = np.eye(4), 0.12 * math.sin(2.0 * number)
    forward = np.array([math.sin(yaw), math.cos(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    pose[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
    pose[:3, 3] = -1.4 + 0.35 * number, -1.6 + 0.2 * math.cos(number), 1.4 + 0.15 * (number % 3)
    return pose


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """Eight pictures of a wall with two markers, and their true centres."""
    folder = tmp_path_factory.mktemp("wall")
    (folder / "images").mkdir()
    camera = gsut.Camera("pinhole", [250.0, 250.0, 200.0, 150.0], 400, 300)
    room, frames = MarkerRoom(), []
    for number in range(8):
        pose = look_at_the_wall(number)
        name = f"images/{number}.png"
        cv2.imwrite(str(folder / name), room.render(camera, pose)[..., ::-1])
        frames.append(Frame(name, folder / name, camera, pose))
    write_transforms(folder / "transforms.json", frames)
    return folder, np.array([look_at_the_wall(number)[:3, 3] for number in range(8)])


def test_markers_of_a_picture_are_found_with_their_corners_in_order(wall):
    folder, _ = wall
    ((ids, corners),) = find_markers(folder / "images" / "0.png", [DICTIONARY])
    assert ids.tolist() == sorted(AT)
    pose = np.linalg.inv(look_at_the_wall(0))
    camera = gsut.Camera("pinhole", [250.0, 250.0, 200.0, 150.0], 400, 300)
    for number, found in zip(ids, corners, strict=True):
        x, z = AT[int(number)]
        h = EDGE / 2
        at = np.array([(x - h, 3, z + h), (x + h, 3, z + h), (x + h, 3, z - h), (x - h, 3, z - h)])
        expected = camera.project(at @ pose[:3, :3].T + pose[:3, 3])[0]
        assert np.abs(found - expected).max() < tolerances.MARKER_CORNER_PX


def test_poses_with_markers_are_in_metres(wall, tmp_path):
    folder, centers = wall
    result = find_poses(folder, tmp_path / "out", options=PosesOptions(marker=EDGE))
    poses = result.solution.camera_from_world
    found = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    length = np.linalg.norm(found[-1] - found[0])
    true = np.linalg.norm(centers[-1] - centers[0])
    figures = json.loads((tmp_path / "out" / "poses.json").read_text())["markers"]
    print(length / true, figures)
    assert figures["applied"] and [row["id"] for row in figures["found"]] == sorted(AT)
    assert abs(length / true - 1) < tolerances.MARKER_LENGTH


def test_option_for_markers_without_any_says_what_was_sought(wall, tmp_path):
    folder, _ = wall
    plain = tmp_path / "plain"
    (plain / "images").mkdir(parents=True)
    for file in sorted((folder / "images").glob("*.png")):
        image = cv2.imread(str(file))
        cv2.imwrite(str(plain / "images" / file.name), image[:40])
    with pytest.raises(gsut.InputError, match="no marker is seen in two of 8 photographs"):
        find_poses(plain, tmp_path / "out", options=PosesOptions(marker=EDGE))
