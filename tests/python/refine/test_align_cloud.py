"""Tests `gsut align CLOUD DATA`: photographs of a made room, scanned in another frame and unit."""

import json

import numpy as np
import pytest

import box_room
import gsut
from box_room import BoxRoom, plan_walk, write_box_room
from gsut.cli import main
from gsut.data.points import format_points_ply
from gsut.refine.captures import align_to_cloud
from gsut.refine.captures.cloud import _Surface

SCALE, SHIFT = 37.0, np.array([5e5, 6e6, -200.0])  # of the cloud's coordinates from the dataset's
ROTATION = gsut.exp_pose([0, 0, 0, 1.3, -0.8, 2.1])[:3, :3]
STATIONS = ((-2.5, 1.5, 1.6), (2.5, -1.2, 1.5), (1.8, 1.9, 1.7))
OTHER_THINGS = (
    ((-3.0, -0.5, 0.0), (-1.5, 2.0, 1.2)), ((1.0, -3.0, 0.0), (2.0, -1.5, 2.5)),
    ((2.5, 1.0, 0.0), (4.0, 1.6, 0.9)),
)  # fmt: skip


def scan(room: BoxRoom, count: int = 60_000) -> np.ndarray:
    """Scans the room from three places, to 4 mm, in the cloud's frame."""
    rng = np.random.default_rng(3)
    rays = rng.standard_normal((3, count // 3, 3))
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    points = [
        place + (room.trace(np.array(place), each)[0] + rng.normal(0, 0.004, len(each)))[:, None]
        * each for place, each in zip(STATIONS, rays, strict=True)
    ]  # fmt: skip
    return SCALE * np.concatenate(points) @ ROTATION.T + SHIFT


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    camera = gsut.Camera("pinhole", [96, 96, 80, 60], 160, 120)
    return write_box_room(tmp_path_factory.mktemp("room") / "data", camera, plan_walk(16))


def test_command_writes_the_dataset_in_the_frame_of_the_scan(data, tmp_path, capsys):
    cloud, out = tmp_path / "scan.ply", tmp_path / "out"
    points = scan(BoxRoom())
    cloud.write_bytes(format_points_ply(points, np.full(points.shape, 128, np.uint8)))
    assert main(["align", str(cloud), str(data), "-o", str(out), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    sigma = figures["scale_sigma_percent"]
    turn = np.array(figures["matrix"])[:3, :3] / figures["scale"]
    angle = np.degrees(np.arccos(min(1.0, (np.trace(turn.T @ ROTATION) - 1) / 2)))
    print(100 * (figures["scale"] / SCALE - 1), sigma, angle, figures["rotation_sigma_degrees"])
    assert abs(100 * (figures["scale"] / SCALE - 1)) < 3 * sigma < 2
    assert angle < 3 * figures["rotation_sigma_degrees"] < 1
    before, moved = (gsut.load_dataset(folder, test_every=0) for folder in (data, out))
    expected = SCALE * np.array([v.camera_center for v in before.views]) @ ROTATION.T + SHIFT
    centers = np.array([moved.world_offset + v.camera_center for v in moved.views])
    off = np.linalg.norm(centers - expected, axis=1).max() / SCALE
    print(off, figures["position_sigma"] / SCALE)
    assert off < 0.05  # metres
    assert np.abs(np.median(moved.points, axis=0) - np.median(points, axis=0)).max() < 0.1 * SCALE


@pytest.mark.slow
def test_scan_of_another_room_is_refused(data, monkeypatch):
    monkeypatch.setattr(box_room, "_THINGS", OTHER_THINGS)
    monkeypatch.setattr(box_room, "ROOM", ((-5.0, -2.5, 0.0), (5.0, 2.5, 3.0)))
    with pytest.raises(gsut.SolveError, match=r"several places|does not fit"):
        align_to_cloud(scan(BoxRoom()), gsut.load_dataset(data, test_every=0))


@pytest.mark.slow
def test_one_wall_is_refused(data, rng):
    wall = rng.uniform(-4, 4, (20_000, 3)) * [1, 1, 1e-3]
    with pytest.raises(gsut.SolveError, match=r"several places|does not fit|is known to"):
        align_to_cloud(wall, gsut.load_dataset(data, test_every=0))


def test_cloud_of_few_points_is_refused(data):
    with pytest.raises(gsut.SolveError, match="cloud of 9 points is too small: 1500"):
        align_to_cloud(np.zeros((9, 3)), gsut.load_dataset(data, test_every=0))


def test_strays_of_a_scan_do_not_count():
    points = scan(BoxRoom(), 6000)
    strays = np.concatenate([points, np.full((9, 3), np.nan), np.zeros((300, 3))])
    assert _Surface(strays).size == pytest.approx(_Surface(points).size, rel=0.02)
