"""Depth maps of photographs, compared with exact geometry, through any lens and shutter."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import gsut
import tolerances as tol
from demo_hall import write_hall
from gsut import _core
from gsut.cli import main
from gsut.data.scene import read_depth
from gsut.surface.stereo.normals import fit_normals
from gsut.surface.stereo.photograph import Photograph
from wall_scenes import LENSES, WALL, wall_scene

VIEW = 2  # in the middle of the others


def measure_errors(scene: gsut.Scene, found: gsut.surface.DepthMap) -> np.ndarray:
    """Relative errors of a wall's known distances."""
    rays, valid = scene.camera(VIEW).rays()
    with np.errstate(invalid="ignore", divide="ignore"):
        truth = WALL / rays[..., 2]
    known = valid & (rays[..., 2] > 0.3) & np.isfinite(found.depth)
    return np.abs(found.depth[known] / truth[known] - 1)


def measure_turns(normals: np.ndarray) -> np.ndarray:
    """Degrees between a wall's known normals, where there are any, and its own."""
    there = normals[normals.any(axis=2)]
    return np.degrees(np.arccos(np.clip(-there[:, 2], -1, 1)))


@pytest.mark.parametrize(("lens", "rolling"), [("pinhole", True), ("kannala_brandt", False)])
def test_normals_of_exact_distances_are_exact(lens: str, rolling: bool) -> None:
    scene = wall_scene(LENSES[lens], rolling=rolling)
    rays = scene.camera(VIEW).rays()[0][..., 2]
    inverse = np.where(scene.mask(VIEW) & (rays > 0.3), rays / WALL, 0).astype(np.float32)
    inverse[:20, :20] = 0
    normals = fit_normals(Photograph(scene, VIEW), inverse)
    off = measure_turns(normals)
    assert len(off) > 0.9 * np.count_nonzero(inverse) and not normals[:10, :10].any()
    assert off.max() < tol.NORMALS_ROUNDING
    np.testing.assert_allclose(
        np.linalg.norm(normals[normals.any(axis=2)], axis=1), 1, atol=tol.NORMALS_ROUNDING
    )


@pytest.mark.parametrize(("lens", "rolling"), [("pinhole", True), ("kannala_brandt", False)])
def test_depth_map_of_a_wall_has_its_distances(lens: str, rolling: bool) -> None:
    scene = wall_scene(LENSES[lens], rolling=rolling)
    (found,) = gsut.poses.find_depth_maps(scene, [VIEW, *range(VIEW), 3])[:1]
    errors = measure_errors(scene, found)
    assert len(errors) > tol.STEREO_SHARE * found.depth.size
    assert np.median(errors) < tol.STEREO_MEDIAN
    assert found.weight is not None and found.weight.max() == 1 and found.weight.min() == 0
    assert found.normals is not None
    off = measure_turns(found.normals)
    assert len(off) > tol.STEREO_SHARE * found.depth.size
    assert np.median(off) < tol.STEREO_NORMALS


def test_depth_maps_that_cannot_be_are_refused() -> None:
    scene = wall_scene(LENSES["pinhole"])
    plain = wall_scene(LENSES["pinhole"], plain=True)
    for of, given, words in (
        (scene.replace(views=scene.views[:1], train_indices=[0]), {}, "at least two"),
        (scene, {"views": [7]}, "7 is none of 0 ... 5"),
        (scene, {"agree": -1}, "at least 0"),
        (plain, {}, "gsut doctor"),
    ):
        with pytest.raises(gsut.InputError, match=words):
            gsut.poses.find_depth_maps(of, **given)


def test_depth_command_writes_a_dataset_that_training_reads(tmp_path: Path, capsys) -> None:
    data, out = tmp_path / "data", tmp_path / "depth"
    write_hall(data, views=4, test_views=1, size=48)
    assert main(["depth", str(data), "-o", str(out), "--force", "--quiet", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    scene = gsut.load_dataset(out)
    assert figures["photographs"] == len(scene.views) == 5
    assert len(scene.points) == figures["points"] > 0 and len(scene.test_indices) == 1
    depth = read_depth(scene, 0)
    assert depth is not None and depth.shape == scene.mask(0).shape
    assert np.isfinite(depth[scene.mask(0)]).any() and np.isnan(depth[~scene.mask(0)]).all()
    stem = scene.views[0].depth_path.stem
    normals = cv2.imread(str(out / "normals" / f"{stem}.png")) / 127.5 - 1  # blue first
    assert normals.shape == (*depth.shape, 3)
    fitted = np.abs(normals).max(axis=2) > 0.01
    assert fitted.any() and not fitted[np.isnan(depth)].any()
    assert np.abs(np.linalg.norm(normals[fitted], axis=1) - 1).max() < 0.02
    assert main(["depth", str(data), "-o", str(out)]) == 2  # nothing is overwritten
    assert "give another name with -o" in capsys.readouterr().err


def test_depth_command_writes_nothing_beside_its_folder(tmp_path: Path) -> None:
    data, out = tmp_path / "in" / "data", tmp_path / "out" / "depth"
    out.parent.mkdir()
    write_hall(data, views=4, test_views=0, size=48)
    (data / "images").rename(tmp_path / "in" / "pictures")
    text = (data / "transforms.json").read_text()
    (data / "transforms.json").write_text(text.replace('"images/', '"../pictures/'))
    assert main(["depth", str(data), "-o", str(out), "--force", "--quiet"]) == 0
    assert [path.name for path in out.parent.iterdir()] == ["depth"]
    assert len(list((out / "depth").iterdir())) == 4


def choose_slowly(scores: np.ndarray, near: float, far: float) -> np.ndarray:
    """Sums the least costs of paths in eight directions, in double: the best distance's number."""
    height, width, depths = scores.shape
    total = np.zeros(scores.shape)
    change = np.abs(np.subtract.outer(np.arange(depths), np.arange(depths)))
    step = np.where(change == 0, 0.0, np.where(change == 1, near, far))
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dx == dy == 0:
                continue
            paths = np.zeros(scores.shape)
            for y in range(height)[:: -1 if dy < 0 else 1]:
                for x in range(width)[:: -1 if dx < 0 else 1]:
                    paths[y, x] = 1 - scores[y, x]
                    if 0 <= y - dy < height and 0 <= x - dx < width:
                        before = paths[y - dy, x - dx]
                        paths[y, x] += (before + step).min(axis=1) - before.min()
            total += paths
    return total.argmin(axis=2)


def test_sweep_chooses_what_paths_in_double_choose() -> None:
    rng = np.random.default_rng(3)
    height, width, depths, contrast = 14, 18, 7, 0.05
    grey = rng.uniform(0.1, 0.9, (height, width + depths)).astype(np.float32)
    own = np.ascontiguousarray(grey[:, 3 : 3 + width])
    y, x = np.mgrid[0:height, 0:width] + 0.5
    shifts = np.arange(depths)  # the right one is 3
    places = np.stack([np.stack([x + shift, y], -1) for shift in shifts]).astype(np.float32)
    sweep = _core.Sweep(own, depths, 1)
    sweep.add(grey, places)
    best, score = sweep.solve(
        np.ones(own.shape, bool), contrast=contrast, step=1.0, agreement=0.0, near_step=0.1,
        far_step=0.4, edge=1e9,
    )  # fmt: skip
    scores = np.zeros((height, width, depths))
    for k in shifts:
        for row in range(height):
            for column in range(width):
                part = np.s_[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3]
                a, b = own[part].astype(float), grey[:, k : k + width][part].astype(float)
                deviations = [np.hypot(each.std(), contrast) for each in (a, b)]
                scores[row, column, k] = np.mean((a - a.mean()) * (b - b.mean())) / np.prod(
                    deviations
                )
    chosen = choose_slowly(scores, 0.1, 0.4)
    assert np.array_equal(np.rint(best), chosen) and (chosen == 3).mean() == 1
    there = np.take_along_axis(scores, chosen[..., None], 2)[..., 0]
    np.testing.assert_allclose(score, there, atol=tol.STEREO_ROUNDING)


def test_sweep_refuses_what_does_not_fit() -> None:
    grey = np.zeros((8, 8), np.float32)
    sweep = _core.Sweep(grey, 3, 4)
    with pytest.raises(gsut.InputError, match="places must have shape"):
        sweep.add(grey, np.zeros((3, 2, 1, 2), np.float32))
    with pytest.raises(gsut.InputError, match="give all or none"):
        sweep.add(grey, np.zeros((3, 2, 2, 2), np.float32), None, grey)
    with pytest.raises(gsut.InputError, match="at least 3"):
        _core.Sweep(grey, 1, 4)
