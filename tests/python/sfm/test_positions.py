"""Positions of photographs: read, and what they make of a scene."""

import numpy as np
import pytest

from gsut import InputError
from gsut.sfm import fit_positions, read_positions
from random_scenes import random_pose
from tolerances import GEODETIC_METRES, POSITIONS_FIT


@pytest.fixture
def poses(rng):
    return {f"images/{i}.jpg": random_pose(rng) for i in range(6)}


def centers(poses):
    return np.array([-pose[:3, :3].T @ pose[:3, 3] for pose in poses.values()])


def test_positions_give_scale_up_and_north(poses, rng, tmp_path):
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    places = 2.5 * centers(poses) @ rotation.T + [3e5, 5e6, 400]
    lines = ["name, x, y, z"] + [
        f"{name.rsplit('/')[-1]}, {x!r}, {y!r}, {z!r}"
        for name, (x, y, z) in zip(poses, places.tolist(), strict=True)
    ]
    (tmp_path / "p.csv").write_text("\n".join(lines))
    fit = fit_positions(poses, read_positions(tmp_path / "p.csv"), "p.csv")
    assert fit.count == 6 and fit.rms < POSITIONS_FIT
    assert fit.scale == pytest.approx(2.5)
    found = fit.scale * centers(poses) @ fit.rotation.T + fit.translation
    x, down, north = found.T
    np.testing.assert_allclose(np.stack([x, north, -down], axis=1), places, atol=POSITIONS_FIT)


def as_positions(poses, places):
    return dict(zip(poses, places, strict=True))


def test_positions_in_another_order_are_refused(rng):
    for count in (5, 8, 20):
        poses = {f"{i}.jpg": random_pose(rng) for i in range(count)}
        noisy = centers(poses) + rng.normal(scale=0.1, size=(count, 3))
        fit_positions(poses, as_positions(poses, noisy), "p.csv")
        with pytest.raises(InputError, match="do not follow the cameras"):
            fit_positions(poses, as_positions(poses, noisy[np.roll(np.arange(count), 2)]), "p.csv")


def test_east_and_north_swapped_over_flat_land_are_upside_down(rng):
    around = rng.uniform(-20, 20, (8, 3)) * [1, 0.1, 1]  # right, down, ahead of cameras held level
    poses = {f"{i}.jpg": np.eye(4) for i in range(8)}
    for pose, center in zip(poses.values(), around, strict=True):
        pose[:3, 3] = -center
    east_north_up = around[:, [0, 2, 1]] * [1, 1, -1]
    right = fit_positions(poses, as_positions(poses, east_north_up), "p.csv")
    swapped = fit_positions(poses, as_positions(poses, east_north_up[:, [1, 0, 2]]), "p.csv")
    assert not right.is_upside_down and swapped.is_upside_down
    assert swapped.rms < 5


def test_a_name_of_two_photographs_is_refused(poses):
    several = {f"{camera}/0.jpg": pose for camera, pose in zip("ab", poses.values(), strict=False)}
    with pytest.raises(InputError, match=r"0\.jpg may be a/0\.jpg or b/0\.jpg"):
        fit_positions(several, {"0.jpg": np.zeros(3)}, "p.csv")


def test_latitudes_are_metres_about_the_first(tmp_path):
    (tmp_path / "p.csv").write_text(
        "altitude,name,latitude,longitude\n400,a,45,7\n400,b,45.001,7\n400,c,45,7.001\n412.5,d,45,7\n"
    )
    found = read_positions(tmp_path / "p.csv")
    # Radii of curvature of WGS 84 at 45 degrees: 6 367 382 m along, 6 388 838 m across a meridian.
    step = np.radians(0.001)
    expected = {
        "a": [0, 0, 0], "b": [0, (6367381.8 + 400) * step, 0],
        "c": [(6388838.3 + 400) * np.cos(np.radians(45)) * step, 0, 0], "d": [0, 0, 12.5],
    }  # fmt: skip
    for name, place in expected.items():
        np.testing.assert_allclose(found[name], place, atol=GEODETIC_METRES)


METRIC = "name,x,y,z\na.jpg,0,0,0\nb.jpg,1,2,3.5\n"


@pytest.mark.parametrize(
    "text",
    [
        METRIC,
        METRIC.replace(",", ";"),
        METRIC.replace(",", ";").replace(".5", ",5"),
        METRIC.replace(",", "\t"),
        METRIC.replace(",", " "),
        METRIC.replace("name,x,y,z", "# of a tape\n#Label,X/Easting,Y/Northing,Z/Altitude"),
        METRIC.replace("name,x,y,z", "Filename,East [m],North [m],Elevation (m),Yaw"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_positions_of_other_programs_are_read(tmp_path, text, encoding):
    (tmp_path / "p.csv").write_bytes(text.encode(encoding))
    found = read_positions(tmp_path / "p.csv")
    assert list(found) == ["a.jpg", "b.jpg"]
    np.testing.assert_array_equal(found["b.jpg"], [1, 2, 3.5])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "found nothing"),
        ("name,x,y\n", "found name,x,y"),
        ("name,x,y,z\na.jpg,1,2\n", "p.csv:2: a name and three numbers"),
        ("name,x,y,z\na.jpg,1,2,nan\n", "p.csv:2: a name and three numbers"),
        ("name,x,y,z\nb.jpg,1,2,3\n", "0 of its 1 names .* like images/0.jpg"),
        ("name,x,y,z\n0.jpg,1,2,3\n1.jpg,2,3,4\n2.jpg,3,4,5\n", "on a line"),
        ("name,x,y,z\n0.jpg,1,2,3\n0.jpg,2,3,4\n", "p.csv:3: 0.jpg is there twice"),
        ("name,lat,lon,alt\n0.jpg,100,47,3\n", "p.csv:2: latitude 100 .* exchanged"),
    ],
)
def test_wrong_positions_are_refused(poses, tmp_path, monkeypatch, text, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        fit_positions(poses, read_positions("p.csv"), "p.csv")
