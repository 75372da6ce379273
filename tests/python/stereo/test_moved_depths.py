"""Depths move to where photographs of a wall agree, through any lens and shutter."""

from __future__ import annotations

import numpy as np
import pytest

import gsut
import tolerances as tol
from gsut.surface import DepthMap, MeshOptions, render_depth_maps
from gsut.surface.stereo import DepthRefiner
from gsut.surface.stereo.photograph import Photograph
from wall_scenes import LENSES, WALL, wall_scene

TRIED = np.arange(-2, 3)
HALF = 3  # of a window
LONGER = 1.01  # times the distance: where the reference projects windows, too


def look_at_wall(scene, off):
    """Maps of a wall that is taken to be `off` times as far as it is, and its normals."""
    maps, rows = [], range(len(scene.views))
    with np.errstate(invalid="ignore", divide="ignore"):
        for row in rows:
            rays = scene.camera(row).rays()[0][..., 2]
            seen = scene.mask(row) & (rays > 0.3)
            depth = np.where(seen, off * WALL / rays, np.nan).astype(np.float32)
            maps.append(DepthMap(scene.camera(row), scene.views[row].motion, depth))
    normals = np.zeros((*maps[0].depth.shape, 3), np.float32)
    normals[..., 2] = -1
    return rows, maps, [normals for _ in rows]


def refine(scene, off):
    rows, maps, normals = look_at_wall(scene, off)
    return maps, DepthRefiner(scene, rows, maps).move(maps, normals, lambda *_: None)


@pytest.mark.parametrize("off", [0.98, 1.02])
@pytest.mark.parametrize(("lens", "rolling"), [("pinhole", True), ("kannala_brandt", False)])
def test_refined_depths_of_a_wall_are_nearer_to_it(lens, rolling, off):
    scene = wall_scene(LENSES[lens], rolling=rolling)
    exact = look_at_wall(scene, 1.0)[1]
    before, after = refine(scene, off)
    errors, count = [], 0
    for true, old, new in zip(exact, before, after, strict=True):
        sure = np.isfinite(old.depth) & (new.weight == 1)
        errors.append(np.abs(new.depth[sure] / true.depth[sure] - 1))
        count += np.count_nonzero(np.isfinite(old.depth))
        stays = ~sure
        np.testing.assert_array_equal(new.depth[stays], old.depth[stays])
        assert np.all(new.weight[stays & np.isfinite(old.depth)] == 0.25)
    errors = np.concatenate(errors)
    assert len(errors) > tol.REFINED_SHARE * count
    assert np.median(errors) < tol.REFINED_MEDIAN


def test_refined_depths_have_the_same_bits_on_any_threads():
    scene = wall_scene(LENSES["kannala_brandt"])
    found = []
    for threads in (1, 3):
        gsut.set_num_threads(threads)
        found.append(b"".join(m.depth.tobytes() for m in refine(scene, 1.01)[1]))
    gsut.set_num_threads(0)
    assert found[0] == found[1]


def test_depths_of_masked_or_plain_photographs_stay():
    scene = wall_scene(LENSES["pinhole"], plain=True)
    for old, new in zip(*refine(scene, 1.01), strict=True):
        np.testing.assert_array_equal(new.depth, old.depth)


def interpolate(grey, places):
    """Grey values between pixels' centres; NaN beside the photograph and at masked pixels."""
    height, width = grey.shape
    x, y = places[..., 0] - 0.5, places[..., 1] - 0.5
    inside = (x >= 0.5) & (y >= 0.5) & (x <= width - 1.5) & (y <= height - 1.5)
    left, top = (np.where(inside, each, 0).astype(int) for each in (x, y))
    s, t = x - left, y - top
    upper = grey[top, left] * (1 - s) + grey[top, left + 1] * s
    lower = grey[top + 1, left] * (1 - s) + grey[top + 1, left + 1] * s
    return np.where(inside, upper * (1 - t) + lower * t, np.nan)


def correlate(one, other):
    one, other = (each - each.mean(axis=(-2, -1), keepdims=True) for each in (one, other))
    mine, theirs = ((each**2).mean(axis=(-2, -1)) + 1e-5 for each in (one, other))
    return (one * other).mean(axis=(-2, -1)) / np.sqrt(mine * theirs)


def refine_slowly(photographs, pixel, depth):
    """Moves one distance, in double: its logarithm's change, or NaN."""
    own, step = photographs[0], np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1]
    x, y = pixel
    window = own.grey[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1].astype(float)
    starts, rays = own.trace_rays(np.array([[x, y], [x + HALF, y], [x, y + HALF]]) + 0.5)
    paths = []
    for other in photographs[1:]:
        ends = []
        for longer in (1.0, LONGER):
            plane = starts[0, 2] + rays[0, 2] * depth * longer  # the wall's normal is along z
            on_plane = starts + rays * ((plane - starts[:, 2]) / rays[:, 2])[:, None]
            middle, right, down = other.project(on_plane)[0]
            ends.append(np.array([middle, (right - middle) / HALF, (down - middle) / HALF]))
        paths.append((ends[0], (ends[1] - ends[0]) / np.log(LONGER)))
    by = 0.5 / max(10.0, *(np.linalg.norm(slope[0]) for _, slope in paths))
    total = np.zeros(len(TRIED))
    for other, (at, slope) in zip(photographs[1:], paths, strict=True):
        middle, right, down = np.moveaxis(at + (TRIED * by)[:, None, None] * slope, 1, 0)
        places = middle[:, None, None] + step[1][..., None] * right[:, None, None]
        places = places + step[0][..., None] * down[:, None, None]
        scores = correlate(window, interpolate(other.grey.astype(float), places))
        if np.isfinite(scores).all() and scores.max() > 0.6:
            total += scores
    best = total.argmax()
    if best in (0, len(TRIED) - 1) or window.std() < 0.008:
        return np.nan
    before, most, after = total[best - 1 : best + 2]
    return by * (TRIED[best] + 0.5 * (before - after) / (before - 2 * most + after))


@pytest.mark.parametrize("rolling", [False, True])
def test_refined_depths_are_those_of_a_reference_in_double(rolling):
    scene = wall_scene(LENSES["pinhole"], rolling=rolling)
    most = tol.REFINED_ROLLING if rolling else tol.REFINED_ROUNDING
    rows, maps, normals = look_at_wall(scene, 1.004)
    photographs = [Photograph(scene, row) for row in rows]
    views = gsut._core.DepthViews([0.0, 0.0, 0.0])
    for m in maps:
        views.add(m.camera, m.motion, m.depth, None, None)
    greys = [each.grey for each in photographs]
    depth, moved = views.refine(0, [1, 2, 3], greys, normals[0], maps[0].depth)
    compared = 0
    for x, y in np.random.default_rng(1).integers((8, 8), (88, 56), (60, 2)):
        change = refine_slowly(photographs[:4], (x, y), float(maps[0].depth[y, x]))
        if np.isnan(change) or not moved[y, x]:
            continue
        compared += 1
        assert abs(np.log(depth[y, x] / maps[0].depth[y, x]) - change) < most
    assert compared > 20


def make_rough_wall():
    """Gaussians on the wall, each tilted and off by another amount."""
    rng = np.random.default_rng(2)
    side = np.linspace(-3.5, 3.5, 71)
    means = np.stack(np.meshgrid(side, side, WALL), -1).reshape(-1, 3)
    means[:, 2] *= rng.normal(1, 0.008, len(means))
    turned = np.concatenate([np.ones((len(means), 1)), rng.normal(0, 0.3, (len(means), 3))], 1)
    return gsut.Gaussians(
        means.astype(np.float32),
        turned.astype(np.float32),
        np.tile(np.log([0.1, 0.1, 1e-3]).astype(np.float32), (len(means), 1)),
        np.full(len(means), 5, np.float32),
        np.zeros((len(means), 1, 3), np.float32),
    )


@pytest.mark.parametrize(("lens", "rolling"), [("pinhole", True), ("kannala_brandt", False)])
def test_depths_that_start_from_a_mesh_of_moved_ones_are_nearer(lens, rolling):
    scene, wall = wall_scene(LENSES[lens], rolling=rolling), make_rough_wall()
    rendered = render_depth_maps(wall, scene)
    normals = [gsut.render_surface(gsut.render(wall, m.camera, m.motion)).normals for m in rendered]
    rows = range(len(scene.views))
    once = DepthRefiner(scene, rows, rendered).move(rendered, normals, lambda *_: None)
    twice = render_depth_maps(wall, scene, MeshOptions(refine=True))
    exact = look_at_wall(scene, 1.0)[1]
    errors = []
    for maps in (once, twice):
        off = [np.abs(m.depth / true.depth - 1) for m, true in zip(maps, exact, strict=True)]
        off = np.concatenate([each[np.isfinite(each)] for each in off])
        errors.append(np.median(off))
    assert errors[1] < tol.REFINED_AGAIN * errors[0]


def test_depths_of_windows_with_an_edge_stay():
    scene = wall_scene(LENSES["pinhole"])
    rows, maps, normals = look_at_wall(scene, 1.02)
    for m in maps:
        m.depth[:, 40:] *= 2  # the wall stands farther back from there on
    after = DepthRefiner(scene, rows, maps).move(maps, normals, lambda *_: None)
    for old, new in zip(maps, after, strict=True):
        beside = np.isfinite(old.depth) & (np.abs(np.arange(96) - 39.5) < HALF)
        assert beside.sum() > 200
        np.testing.assert_array_equal(new.depth[beside], old.depth[beside])
        assert np.all(new.weight[beside] == 1)
        assert np.any(new.depth[:, :36] != old.depth[:, :36])
