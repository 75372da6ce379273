"""Numbers of the Python API have the bounds of the command line: no NaN, nothing of no sense."""

import math

import numpy as np
import pytest

import gsut
import gsut.edit
import gsut.lens
import gsut.loop
import gsut.rendering
import gsut.surface
from gsut.bounds import check_direction, check_number
from gsut.cli._flags import Number
from random_scenes import fisheye, gaussians_in_view, rng_of

POSES = np.stack([np.eye(4)] * 3)
LENS = gsut.Camera("pinhole", [30, 30, 16, 16], 32, 32)
POINTS = rng_of("bounds").normal(size=(60, 3))
FRAMES = [np.zeros((16, 16, 3), np.uint8)] * 3
NAN, INF = math.nan, math.inf
DIRECTIONS = ([NAN] * 3, [INF] * 3, [0] * 3, [1e300] * 3, [1e-300] * 3, [1, 2], "up", None)


@pytest.fixture(scope="module")
def gaussians():
    return gaussians_in_view(rng_of("bounds"), fisheye(), np.eye(4), 50)


CASES = {
    "scale": (lambda g, x: gsut.edit.transform_gaussians(g, np.eye(3), x),
              (NAN, INF, 0, -1, 1e300, 1e-300)),
    "translation": (lambda g, x: gsut.edit.transform_gaussians(g, np.eye(3), 1, x),
                    ([NAN] * 3, [INF] * 3, [1e300] * 3, [1, 2], "x")),
    "moved": (lambda g, x: g.translate(x), ([0, NAN, 0], [1, 2], "x", 1e30)),
    "count": (lambda g, x: gsut.compact(g, count=x), (NAN, INF, 1.5, "x", [1], 0)),
    "seed": (lambda g, x: gsut.compact(g, 0.5, seed=x), (NAN, INF, 1.5, "x", [1])),
    "rotation": (lambda g, x: gsut.edit.transform_gaussians(g, np.eye(3) * x),
                 (NAN, 0, -1, 1e300, 1e-300)),
    "upright": (lambda g, x: gsut.edit.rotate_upright(x), DIRECTIONS),
    "ground": (gsut.edit.find_ground, DIRECTIONS),
    "field": (lambda g, x: gsut.lens.with_field_of_view(LENS, x), (NAN, INF, 0, -1, 361, 1e300)),
    "focal": (lambda g, x: gsut.lens.with_scaled_focal(LENS, x), (NAN, INF, 0, -1, 1e300, 1e-300)),
    "size": (lambda g, x: LENS.resize(x, x), (0, -1, 2**31)),
    "orbit": (lambda g, x: gsut.rendering.make_orbit_path(POSES, x), (0, -1, NAN, 1e300, 2.5)),
    "orbit up": (lambda g, x: gsut.rendering.make_orbit_path(POSES, 4, up=x), DIRECTIONS[:-1]),
    "path": (lambda g, x: gsut.rendering.smooth_path(POSES, x), (0, -1, NAN, 1e300, 2.5)),
    "path up": (lambda g, x: gsut.rendering.smooth_path(POSES, 4, up=x), DIRECTIONS[:-1]),
    "tour": (lambda g, x: gsut.rendering.make_tour_path(POSES, x), (0, -1, NAN, 1e300, 2.5)),
    "film": (lambda g, x: gsut.write_video("film.mp4", FRAMES, x), (NAN, INF, 0, -1, 1e300, 1e-9)),
    "background": (lambda g, x: gsut.render(g, fisheye(), np.eye(4), background=[x] * 3),
                   (NAN, INF, 1e300, -1e300)),
    "points": (lambda g, x: gsut.seed_from_points(POINTS * x), (NAN, 1e200, 1e13)),
    "far": (lambda g, x: gsut.loop.seed_in_view(LENS, POSES, 20, near=1, far=x),
            (NAN, INF, 0, 1, 1e300)),
    "voxel": (lambda g, x: gsut.surface.MeshOptions(voxel=x), (NAN, INF, 0, -1, "x")),
    "support": (lambda g, x: gsut.surface.MeshOptions(support=x), (NAN, -1, 9, 0.5)),
    "side": (lambda g, x: gsut.surface.MeshOptions(max_side=x), (0, -1, 0.5, 2**31)),
    "frames": (lambda g, x: gsut.capture(["film.mp4"], "out", count=x), (0, -1, NAN, 2.5, 2**31)),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_number_out_of_bounds_is_refused(gaussians, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    call, values = CASES[name]
    for value in values:
        with pytest.raises(gsut.InputError) as caught:
            call(gaussians, value)
        assert "\n" not in str(caught.value), value
    assert len(values) >= 3 and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "bounds", "value"),
    [("3", {"whole": True}, 3), ("1e-3", {"low": 0, "above": True}, 1e-3), ("-1e100", {}, -1e100)],
)
def test_flag_and_argument_take_the_same_numbers(text, bounds, value):
    assert Number(**bounds)(text) == check_number(value, "x", **bounds) == value


@pytest.mark.parametrize("text", ["nan", "inf", "1e101", "x", "", "0x1"])
def test_flag_and_argument_refuse_the_same_numbers(text):
    with pytest.raises(Exception, match=r"^takes a (finite )?number.*found"):
        Number()(text)
    with pytest.raises(gsut.InputError, match=r"^x takes a (finite )?number.*found"):
        check_number(text, "x")


def test_direction_has_length_one():
    np.testing.assert_array_equal(check_direction([0, 0, -1e9], "up"), [0, 0, -1])
