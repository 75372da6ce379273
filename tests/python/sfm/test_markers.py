"""Markers of a known size in the pictures give metres, by features like all others."""

import dataclasses
import json
import math

import cv2
import numpy as np
import pytest

import gsut
import tolerances
from box_room import ROOM, BoxRoom
from gsut.data import Frame, write_transforms
from gsut.data.poses import find_centers
from gsut.sfm import PosesOptions, find_poses, run_mapping, start_mapping
from gsut.sfm.photographs import Features
from gsut.sfm.pipeline import _map
from gsut.sfm.world import add_markers
from gsut.sfm.world.markers import find_markers

EDGE = 0.9  # metres
AT = {7: (-1.2, 1.7), 11: (0.9, 2.85)}  # x and z of the markers' centres on the wall y = 3
ON_FLOOR = {7: (-1.0, 1.6), 11: (0.9, 2.0)}  # x and y of those on the floor z = 0
DICTIONARY = "DICT_APRILTAG_36h11"
CAMERA = gsut.Camera("pinhole", [250.0, 250.0, 200.0, 150.0], 400, 300)
_CELLS = 8  # of a marker's side, with its black border


class MarkerRoom(BoxRoom):
    """The room with two markers on a wall, or on the floor."""

    def __init__(self, is_floor=False):
        super().__init__()
        self.is_floor = is_floor

    def trace(self, origins, rays):
        """Finds distances (N,) and colours (N, 3) along unit rays (N, 3)."""
        distance, colors = super().trace(origins, rays)
        points = np.broadcast_to(origins, rays.shape) + distance[:, None] * rays
        codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))
        off = points[:, 2] - ROOM[0][2] if self.is_floor else points[:, 1] - ROOM[1][1]
        along = points[:, [0, 1] if self.is_floor else [0, 2]]
        for number, at in (ON_FLOOR if self.is_floor else AT).items():
            marker = cv2.aruco.generateImageMarker(codes, number, _CELLS) / 255.0
            cell = (along - at) * [-1, -1] * _CELLS / EDGE + _CELLS / 2
            white = (np.abs(off) < 1e-9) & (np.abs(cell - _CELLS / 2) < _CELLS / 2 + 1).all(axis=1)
            colors[white] = 1.0
            inside = white & (np.abs(cell - _CELLS / 2) < _CELLS / 2).all(axis=1)
            u, v = cell[inside].astype(int).T
            colors[inside] = marker[v, _CELLS - 1 - u][:, None]
        return distance, colors


def look_at_the_wall(number):
    """World-from-camera pose of a picture: in a row before the wall, looking at it."""
    at = -1.4 + 0.35 * number, -1.6 + 0.2 * math.cos(number), 1.4 + 0.15 * (number % 3)
    return look(at, yaw=0.12 * math.sin(2.0 * number))


def look_at_the_floor(number):
    """The same on an arc about the markers of the floor, from above."""
    angle = math.radians(-150 + 17 * number)
    at = 1.9 * math.cos(angle), 1.8 + 1.9 * math.sin(angle), 2.1 + 0.15 * (number % 3)
    return look(at, yaw=math.atan2(-math.cos(angle), -math.sin(angle)), pitch=-0.8)


def look(at, yaw, pitch=0.0):
    pose = np.eye(4)
    forward = np.array(
        [math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    )
    right = np.array([math.cos(yaw), -math.sin(yaw), 0.0])
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = at
    return pose


def write_pictures(folder, room, place):
    """Writes eight pictures; returns their true centres."""
    (folder / "images").mkdir()
    frames = []
    for number in range(8):
        name, pose = f"images/{number}.png", place(number)
        cv2.imwrite(str(folder / name), room.render(CAMERA, pose)[..., ::-1])
        frames.append(Frame(name, folder / name, CAMERA, pose))
    write_transforms(folder / "transforms.json", frames)
    return np.array([place(number)[:3, 3] for number in range(8)])


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """Eight pictures of a wall with two markers, and their true centres."""
    folder = tmp_path_factory.mktemp("wall")
    return folder, write_pictures(folder, MarkerRoom(), look_at_the_wall)


def test_markers_of_a_picture_are_found_with_their_corners_in_order(wall):
    folder, _ = wall
    ((ids, corners),) = find_markers(folder / "images" / "0.png", [DICTIONARY], is_exact=True)
    assert ids.tolist() == sorted(AT)
    pose = np.linalg.inv(look_at_the_wall(0))
    for number, found in zip(ids, corners, strict=True):
        x, z = AT[int(number)]
        h = EDGE / 2
        at = np.array([(x - h, 3, z + h), (x + h, 3, z + h), (x + h, 3, z - h), (x - h, 3, z - h)])
        expected = CAMERA.project(at @ pose[:3, :3].T + pose[:3, 3])[0]
        assert np.abs(found - expected).max() < tolerances.MARKER_CORNER_PX


def test_poses_with_markers_are_in_metres(wall, tmp_path):
    folder, centers = wall
    result = find_poses(
        folder, tmp_path / "out", options=PosesOptions(marker=EDGE, max_features=800)
    )
    poses = result.solution.camera_from_world
    found = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    length = np.linalg.norm(found[-1] - found[0])
    true = np.linalg.norm(centers[-1] - centers[0])
    figures = json.loads((tmp_path / "out" / "poses.json").read_text())["markers"]
    print(length / true, figures)
    assert figures["applied"] and [row["id"] for row in figures["found"]] == sorted(AT)
    assert figures["frame"] is None  # a wall is no ground
    assert abs(length / true - 1) < tolerances.MARKER_LENGTH


def test_markers_on_the_ground_are_its_frame(tmp_path):
    true = write_pictures(tmp_path, MarkerRoom(is_floor=True), look_at_the_floor)
    mapping = start_mapping(tmp_path, None, PosesOptions(marker=EDGE, max_features=800), None)
    held = dict.fromkeys(mapping.photographs.names, 1)  # as of a capture: upright
    photographs = dataclasses.replace(mapping.photographs, orientations=held)
    photographs = mapping.replace(photographs=photographs)
    result = run_mapping(tmp_path, tmp_path / "out", photographs, _map)
    figures = result.figures["markers"]
    assert figures["applied"] and figures["frame"] == 7
    off = find_centers(result.solution.camera_from_world) - (true - [*ON_FLOOR[7], 0])[
        :, [0, 2, 1]
    ] * [1, -1, 1]
    print(np.linalg.norm(off, axis=1), figures)
    assert np.linalg.norm(off, axis=1).max() < tolerances.MARKER_FRAME
    corners = np.array([row["corners"] for row in figures["found"]])
    assert np.abs(corners[..., 1]).max() < tolerances.MARKER_FRAME


def test_markers_that_few_photographs_show_are_found(wall, tmp_path):
    folder, _ = wall
    (tmp_path / "images").mkdir()
    for number in range(36):  # every third is tried first: none of these shows a marker
        image = cv2.imread(str(folder / "images" / f"{number % 8}.png"))
        image = image if number in (7, 8) else image[:40]
        cv2.imwrite(str(tmp_path / "images" / f"{number:02}.png"), image)
    mapping = start_mapping(tmp_path, None, PosesOptions(marker=EDGE, max_features=800), None)
    nothing = Features(*(np.zeros((1, n), np.uint8) for n in (2, 1, 128, 3)))
    nothing = dataclasses.replace(nothing, sizes=np.zeros(1, np.float32))
    found = add_markers(mapping.replace(features=[nothing] * 36))
    ids = found.photographs.markers
    assert [number for number in range(36) if len(ids[number])] == [7, 8]
    assert ids[7].tolist() == sorted(AT)


def test_option_for_markers_without_any_says_what_was_sought(wall, tmp_path):
    folder, _ = wall
    plain = tmp_path / "plain"
    (plain / "images").mkdir(parents=True)
    for file in sorted((folder / "images").glob("*.png")):
        image = cv2.imread(str(file))
        cv2.imwrite(str(plain / "images" / file.name), image[:40])
    with pytest.raises(gsut.InputError, match="no marker is seen in two of 8 photographs"):
        find_poses(plain, tmp_path / "out", options=PosesOptions(marker=EDGE, max_features=800))
