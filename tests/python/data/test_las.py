"""Clouds of laser scanners: LAS of several versions, and what is said of LAZ."""

import builtins

import numpy as np
import pytest

import gsut
import small_datasets as small
from gsut.data.points import load_points
from raising import raises_saying
from small_scans import format_las


@pytest.mark.parametrize(
    ("version", "kind", "deep"), [(2, 2, 257), (4, 7, 257), (2, 2, 1), (2, 0, 0)]
)
def test_las_gives_its_points_and_colours(version, kind, deep, tmp_path, rng):
    points = rng.uniform(-30, 30, (200, 3)) + np.array([4.4e5, 5.3e6, 300])
    colors = rng.integers(0, 256, (200, 3))
    colors[0] = 255
    file = tmp_path / "cloud.las"
    file.write_bytes(format_las(points, colors * deep if deep else None, version, kind))
    found, shown = load_points(file)
    assert np.abs(found - points).max() < 6e-4
    assert np.array_equal(shown, colors) if deep else np.all(shown == 128)


@pytest.mark.parametrize("write", [small.write_folder, small.write_colmap_text])
def test_dataset_takes_points_from_las(write, tmp_path):
    write(tmp_path)
    for name in ("points3D.ply", "points.ply", "sparse/0/points3D.txt"):
        (tmp_path / name).unlink(missing_ok=True)
    points, colors = small.points()
    (tmp_path / "points.las").write_bytes(format_las(points, colors.astype(int) * 257))
    scene = gsut.load_dataset(tmp_path)
    assert np.abs(scene.points - points).max() < 6e-4
    assert np.array_equal(scene.point_colors, colors)


def test_clouds_and_depths_that_nothing_names_are_noted(tmp_path):
    small.write_colmap_text(tmp_path)
    (tmp_path / "scan.las").touch()
    (tmp_path / "depths").mkdir()
    notes = gsut.load_dataset(tmp_path).notes
    for name in ("scan.las", "depths"):
        assert any(f"{name} is not used" in note for note in notes)


def test_laz_without_its_reader_names_the_command(tmp_path, rng, monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **more):
        if name == "laspy":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    file = tmp_path / "cloud.laz"
    file.write_bytes(format_las(rng.uniform(0, 1, (9, 3)), kind=0x82))
    with raises_saying(["cloud.laz", "compressed", 'pip install "gsut[lidar]"', "LAS or PLY"]):
        load_points(file)
