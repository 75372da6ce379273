"""Rolling shutters in double: timing, a pose a line, gradients to both poses, gsplat's vectors."""

import numpy as np
import pytest
from test_oracle import SH0, Oracle

import gsut
import tolerances
from gsut import InputError, _core
from random_scenes import (
    fisheye,
    gaussians_in_view,
    hold_to_differences,
    open_rule,
    pinhole,
    random_pose,
    random_weights,
    relative_error,
)

DIRECTIONS = ("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left")
PARITIES = (None, "gsplat")
CASES = ("pinhole", "fisheye", "opencv12")


def moved(rng, pose, shift=0.3, turn=0.3):
    """The pose after a motion of about `shift` (world units) and `turn` (radians)."""
    v, w = rng.normal(size=(2, 3))
    xi = np.concatenate([v * shift / np.linalg.norm(v), w * turn / np.linalg.norm(w)])
    return gsut.exp_pose(xi) @ pose


def scene(rng, camera, count=30, **options):
    start = random_pose(rng)
    end = moved(rng, start)
    middle = _core.CameraMotion(start, end, gsut.Shutter("top_to_bottom")).at(0.5)
    g = gaussians_in_view(rng, camera, middle, count, **options)
    return g.to_dtype(np.float64), (start, end)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_line_times_run_from_the_first_edge_to_the_last(direction):
    lines = 6 if direction in DIRECTIONS[:2] else 8
    expected = (np.arange(lines) + 0.5) / lines
    if direction in ("bottom_to_top", "right_to_left"):
        expected = expected[::-1]
    assert np.array_equal(gsut.Shutter(direction).line_times(8, 6), expected)
    of_lines = gsut.Shutter(direction, "gsplat").line_times(8, 6)
    assert sorted(of_lines)[0] == 0 and sorted(of_lines)[-1] == 1
    assert np.argmin(of_lines) == np.argmin(expected)


def test_motion_moves_the_centre_on_a_straight_line_and_turns_evenly(rng):
    start = random_pose(rng)
    end = moved(rng, start)
    motion = gsut.CameraMotion(start, end, gsut.Shutter("top_to_bottom"))
    centers = [-motion.at(t)[:3, :3].T @ motion.at(t)[:3, 3] for t in (0, 0.25, 0.5, 1)]
    assert centers[1] == pytest.approx(0.75 * centers[0] + 0.25 * centers[3], abs=1e-14)
    assert centers[2] == pytest.approx((centers[0] + centers[3]) / 2, abs=1e-14)
    quarter = motion.at(0.25)[:3, :3] @ start[:3, :3].T
    whole = np.linalg.matrix_power(quarter, 4) @ start[:3, :3]
    assert np.abs(whole - end[:3, :3]).max() < 1e-13
    assert np.array_equal(motion.at(0), start) and np.array_equal(motion.at(1), end)


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_render_double_every_line_is_the_global_image_from_its_own_pose(rng, direction, parity):
    # Degree 0 and Gaussians in one order from everywhere: what a line sees but for shading and
    # order, which are those of the middle pose.
    camera = pinhole(12, 10)
    g, pair = scene(rng, camera, count=1, sh_degree=0, opacity=2.0)
    shutter = gsut.Shutter(direction, parity)
    found = gsut.render(g, camera, pair, shutter=shutter, dtype="float64")
    motion = gsut.CameraMotion(*pair, shutter)
    times = shutter.line_times(12, 10)
    seen = 0.0
    for line, t in enumerate(times):
        image = gsut.render(g, camera, motion.at(t), dtype="float64")
        at = np.s_[line] if direction in DIRECTIONS[:2] else np.s_[:, line]
        for name in ("image", "alpha", "depth"):
            difference = getattr(found, name)[at] - getattr(image, name)[at]
            assert np.abs(difference).max() < tolerances.RENDER_DOUBLE
        seen += image.alpha[at].sum()
    assert len(times) == (10 if direction in DIRECTIONS[:2] else 12) and seen > 1.0


def test_render_double_pair_of_equal_poses_is_the_global_image(rng):
    camera = fisheye(24)
    g, (start, _) = scene(rng, camera)
    rolling = gsut.render(g, camera, (start, start), shutter="left_to_right", dtype="float64")
    still = gsut.render(g, camera, start, dtype="float64")
    assert np.abs(rolling.image - still.image).max() < tolerances.RENDER_DOUBLE
    assert still.alpha.max() > 0.5


@pytest.mark.parametrize(
    ("direction", "parity", "turn"),
    [*((direction, parity, 0.3) for direction in DIRECTIONS for parity in PARITIES),
     *(("top_to_bottom", None, turn) for turn in (0.0, 1e-9, 1e-4, 1.0, 3.0))],
)  # fmt: skip
def test_render_backward_both_poses_and_parameters_match_central_differences(
    rng, direction, parity, turn
):
    camera = fisheye(20)
    g, (start, _) = scene(rng, camera, count=10, sizes=(0.02, 0.05), aspect=0.3, sh_degree=2)
    checked = hold_to_differences(
        g, camera, (start, moved(rng, start, 0.2, turn)), random_weights(rng, camera),
        tolerances.RENDER_DIFFERENCES, entries=rng, blend=open_rule(),
        shutter=gsut.Shutter(direction, parity),
    )  # fmt: skip
    assert checked == 30 + 32 + 30 + 10 + 32


class RollingOracle(Oracle):
    """gsplat's vectors of a rolling shutter, top to bottom."""

    def __init__(self, path):
        super().__init__(path.with_name(path.stem.removesuffix("_rs_ttb") + ".npz"))
        self.vectors = dict(np.load(path))
        v = self.vectors
        self.pair = (v["viewmat"], v["viewmat_end"])
        self.shutter = gsut.Shutter("top_to_bottom", "gsplat")
        self.lines = v["rays"].reshape(int(v["height"]), int(v["width"]), 6)
        self.middle = gsut.CameraMotion(*self.pair, self.shutter).at(0.5)


@pytest.fixture(scope="module", params=CASES)
def oracle(request, shared):
    return RollingOracle(shared / "oracle" / f"{request.param}_rs_ttb.npz")


def expected_gradients(oracle):
    opacities = oracle["opacities"]
    return {
        "means": oracle["all_grad_means"],
        "quats": oracle["all_grad_quats"],
        "log_scales": oracle["all_grad_scales"] * oracle["scales"],
        "opacity_logits": oracle["all_grad_opacities"] * opacities * (1 - opacities),
        "sh": (oracle["all_grad_colors"] * SH0)[:, None],
    }


def test_oracle_rays_match_within_its_own_slerp(oracle):
    rays, valid = oracle.camera.rays()
    assert valid.all()
    motion = gsut.CameraMotion(*oracle.pair, oracle.shutter)
    for row, t in enumerate(oracle.shutter.line_times(oracle.camera.width, oracle.camera.height)):
        pose = motion.at(t)
        world = rays[row] @ pose[:3, :3]
        assert np.abs(world - oracle.lines[row, :, 3:]).max() < tolerances.ORACLE_SLERP
        center = -pose[:3, :3].T @ pose[:3, 3]
        assert np.abs(center - oracle.lines[row, :, :3]).max() < tolerances.ORACLE_SLERP


def test_oracle_image_of_its_own_rays_matches(oracle):
    baseline = pytest.importorskip("gsut_scalar_baseline")
    image, alpha, depth, samples, _ = baseline.render_lines_reference(
        oracle.gaussians, oracle.lines, oracle.middle, oracle.rule
    )
    assert np.array_equal(samples, oracle["all_nsamples"]) and (samples > 0).sum() > 1000
    assert np.abs(image - oracle["all_rgb"]).max() < tolerances.ORACLE_IMAGE
    assert np.abs(alpha - oracle["all_alpha"]).max() < tolerances.ORACLE_IMAGE
    assert np.abs(depth - oracle["all_depth"]).max() < tolerances.ORACLE_IMAGE


def test_oracle_rolling_shutter_image_and_gradients_match(oracle):
    result = gsut.render(
        oracle.gaussians, oracle.camera, oracle.pair, shutter=oracle.shutter, blend=oracle.rule,
        dtype="float64",
    )  # fmt: skip
    # Poses are exact here and gsplat's are not: see ORACLE_SLERP.
    assert np.abs(result.image - oracle["all_rgb"]).max() < tolerances.ORACLE_SLERP_IMAGE
    assert np.abs(result.alpha - oracle["all_alpha"]).max() < tolerances.ORACLE_SLERP_IMAGE
    assert np.abs(result.depth - oracle["all_depth"]).max() < tolerances.ORACLE_SLERP_IMAGE
    found = gsut.render_backward(result, oracle["w_rgb"], oracle["w_alpha"], oracle["w_depth"])
    expected = expected_gradients(oracle)
    errors = {
        name: relative_error(getattr(found.gaussians, name), expected[name]) for name in expected
    }
    errors["start"] = relative_error(found.pose[0], oracle["all_grad_xi"])
    errors["end"] = relative_error(found.pose[1], oracle["all_grad_xi_end"])
    print(errors)
    assert len(errors) == 7
    assert max(errors.values()) < tolerances.ORACLE_SLERP_GRADIENT, errors


@pytest.mark.parametrize(
    ("poses", "shutter", "says"),
    [
        ((np.eye(4), np.eye(4)), None, "pair of poses"),
        ((np.eye(4), np.eye(4)), "global", "pair of poses"),
        (np.eye(4), "top_to_bottom", "one pose"),
        ((np.eye(4), np.eye(4)), "sideways", "left_to_right"),
        ((np.eye(4), 2 * np.eye(4)), "top_to_bottom", "last row"),
    ],
)
def test_render_wrong_poses_or_shutter_says_what_to_do(rng, poses, shutter, says):
    camera = pinhole(8)
    g = gaussians_in_view(rng, camera, np.eye(4), 3)
    with pytest.raises(InputError, match=says):
        gsut.render(g, camera, poses, shutter=shutter)


def test_shutter_unknown_parity_lists_the_known():
    with pytest.raises(InputError, match="gsplat"):
        gsut.Shutter("top_to_bottom", "colmap")


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_project_rolling_centre_of_a_point_is_where_its_own_line_sees_it(rng, direction):
    camera = fisheye(60)
    g, pair = scene(rng, camera, count=200, sizes=(1e-5, 2e-5), aspect=0.1)
    shutter = gsut.Shutter(direction)
    found = gsut.project(g, camera, pair, shutter=shutter, dtype="float64")
    motion = gsut.CameraMotion(*pair, shutter)
    checked = 0
    for mean, (u, v), valid in zip(g.means, found.centers, found.valid, strict=True):
        if not valid or not (0 < u < 60 and 0 < v < 60):
            continue
        t = (v if direction in DIRECTIONS[:2] else u) / 60
        pose = motion.at(t if direction in ("top_to_bottom", "left_to_right") else 1 - t)
        pixel, seen = camera.project((pose[:3, :3] @ mean + pose[:3, 3])[None])
        # Second order: the curvature over a Gaussian of 2e-5 of its distance.
        assert seen[0] and np.abs(pixel[0] - (u, v)).max() < 1e-5
        checked += 1
    assert checked > 100 and found.converged.sum() > 150


def test_project_pair_of_equal_poses_is_the_still_projection(rng):
    camera = fisheye(40)
    g, (start, _) = scene(rng, camera, count=100)
    rolling = gsut.project(g, camera, (start, start), shutter="top_to_bottom", dtype="float64")
    still = gsut.project(g, camera, start, dtype="float64")
    assert still.converged.all() and rolling.converged.all()
    assert np.array_equal(rolling.valid, still.valid) and still.valid.sum() > 50
    inside = still.valid
    assert np.abs(rolling.centers - still.centers)[inside].max() < tolerances.PROJECTION_DOUBLE


def test_oracle_projection_of_the_rolling_shutter_matches(oracle):
    # gsplat takes floor(row) / (H - 1) as a point's time, steps of one line, and does not say
    # whether its ten iterations settled; gsut's time is continuous: half a line's motion apart.
    found = gsut.project(
        oracle.gaussians, oracle.camera, oracle.pair, shutter=oracle.shutter, dtype="float64"
    )
    ends = [
        gsut.project(oracle.gaussians, oracle.camera, pose, dtype="float64") for pose in oracle.pair
    ]
    motion = np.abs(ends[1].centers - ends[0].centers).max(axis=1)
    compared = found.valid & oracle["proj_a1_ut_valid"] & np.isfinite(motion)
    inside = (found.centers > 0) & (found.centers < (oracle.camera.width, oracle.camera.height))
    compared &= inside.all(axis=1)
    off = np.abs(found.centers - oracle["proj_a1_raw_means2d"]).max(axis=1)
    assert compared.sum() > 80
    lines = 1.5 * motion[compared] / (oracle.camera.height - 1)
    assert np.mean(off[compared] <= lines + 1e-3) > 0.9
    assert np.median(off[compared]) < 0.1
