"""Makes the first Gaussians of a scene, from a point cloud or at random in the cameras' view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut import _core
from gsut._core import InputError
from gsut.bounds import name_wrong_kinds
from gsut.gaussians.arrays import Gaussians

# Highest degree of harmonics that a scene may have.
_MAX_SH_DEGREE = 3
# Half a level of 8 bits, of [0, 1]: how far rounding and interpolation move a colour.
COLOR_ROUNDING = 0.5 / 255


@name_wrong_kinds
def seed_from_points(
    points: np.ndarray,
    colors: np.ndarray | None = None,
    *,
    sh_degree: int = 1,
    scale_factor: float = 0.7,
    opacity: float = 0.5,
    max_gaussians: int | None = None,
    seed: int = 0,
) -> Gaussians:
    """Places a Gaussian at each point, in the plane of its neighbours and sized by their distance.

    Args:
        points: (N, 3) world coordinates.
        colors: (N, 3) uint8, or floating-point numbers in [0, 1]; mid-grey if None.
        sh_degree: 0 to 3; coefficients above the constant one are 0.
        scale_factor: standard deviation along the surface / mean distance to the three nearest
            other points (exact). 3DGS uses 1, MCMC 0.1; this default trains best in few steps.
        opacity: in (0, 1). 3DGS uses 0.1; this default trains best in few steps.
        max_gaussians: if there are more points, this number of them is chosen at random.
        seed: of that choice.

    Returns:
        float32 Gaussians. The third axis is the normal of the plane through the point and its nine
        nearest others. Across it they are as thin as these points' spread, at least 0.2 of the
        other axes; with fewer points they are round. Distances are at least 1 % of their median
        (for points with duplicates), and 1 world unit if no two points differ.

    Raises:
        InputError: shapes disagree, a value is not finite, or an option is out of range.
    """
    points = _core.read_array(points, "points").astype(np.float64, copy=False)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points must have shape (N, 3), found {points.shape}")
    if not 0 <= sh_degree <= _MAX_SH_DEGREE:
        raise InputError(f"sh_degree is {sh_degree}; give 0 to {_MAX_SH_DEGREE}")
    if colors is None:
        colors = np.full_like(points, 0.5)
    colors = _core.read_array(colors, "colors")
    if colors.shape != points.shape:
        raise InputError(f"colors must have shape {points.shape} as points, found {colors.shape}")
    if colors.dtype == np.uint8:
        colors = colors / 255.0
    elif not np.issubdtype(colors.dtype, np.floating):
        raise InputError(f"colors must be uint8 or floating point, found {colors.dtype}")
    elif colors.size and np.abs(colors - 0.5).max() > 0.5 + COLOR_ROUNDING:
        raise InputError(
            f"floating-point colors must be in [0, 1], found {colors.min():g} to {colors.max():g}; "
            "give those of 0 to 255 as uint8"
        )
    if max_gaussians is not None and max_gaussians < 0:
        raise InputError(f"max_gaussians is {max_gaussians}; give 0 or more, or None")
    if max_gaussians is not None and len(points) > max_gaussians:
        rows = choose_points(len(points), max_gaussians, seed)
        points, colors = points[rows], colors[rows]
    n = len(points)
    gaussians = Gaussians(
        np.empty((n, 3), np.float32),
        np.empty((n, 4), np.float32),
        np.empty((n, 3), np.float32),
        np.empty(n, np.float32),
        np.empty((n, (sh_degree + 1) ** 2, 3), np.float32),
    )
    _core.seed_from_points(points, colors, gaussians, scale_factor, opacity)
    return gaussians


def choose_points(count: int, most: int, seed: int) -> np.ndarray:
    """Chooses at most `most` of `count` rows at random; returns them in rising order."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(seed).choice(count, most, replace=False))


def sample_points_in_view(
    cameras: _core.Camera | Sequence[_core.Camera],
    poses: np.ndarray,
    count: int,
    *,
    near: float,
    far: float,
    seed: int = 0,
) -> np.ndarray:
    """Samples (count, 3) float64 points that the cameras see, as `seed_in_view` describes."""
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or len(poses) == 0:
        raise InputError(f"poses must have shape (M, 4, 4) with M > 0, found {poses.shape}")
    if not 0 < near < far < np.inf:
        raise InputError(f"near {near} and far {far} must be finite with 0 < near < far")
    one_a_pose = list(cameras) if isinstance(cameras, Sequence) else [cameras] * len(poses)
    if len(one_a_pose) != len(poses):
        raise InputError(
            f"{len(one_a_pose)} cameras for {len(poses)} poses; give one, or one a pose"
        )
    rng = np.random.default_rng(seed)
    chosen = rng.integers(len(poses), size=count)
    distance = near * (far / near) ** rng.random(count)
    pixel = rng.random(count)
    points = np.empty((count, 3))
    of_camera: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # valid rays and where they begin
    for index in np.unique(chosen):
        camera = one_a_pose[index]
        if id(camera) not in of_camera:
            rays, valid = camera.rays()
            starts = np.zeros_like(rays) if camera.is_central else camera.origins()
            of_camera[id(camera)] = rays[valid], starts[valid]
        rays, starts = of_camera[id(camera)]
        if len(rays) == 0:
            raise InputError(f"camera {index} has no valid pixel")
        rows = np.flatnonzero(chosen == index)
        drawn = (pixel[rows] * len(rays)).astype(np.int64)
        in_camera = rays[drawn] * distance[rows, None] + starts[drawn]
        rotation, translation = poses[index, :3, :3], poses[index, :3, 3]
        points[rows] = (in_camera - translation) @ rotation
    return points


@name_wrong_kinds
def seed_in_view(
    cameras: _core.Camera | Sequence[_core.Camera],
    poses: np.ndarray,
    count: int,
    *,
    near: float,
    far: float,
    sh_degree: int = 1,
    scale_factor: float = 0.7,
    opacity: float = 0.5,
    seed: int = 0,
) -> Gaussians:
    """Places Gaussians at random where the cameras see them, for scenes without points.

    Args:
        cameras: one camera for all poses, or one a pose.
        poses: (M, 4, 4) camera_from_world.
        count: number of Gaussians.
        near, far: world units; the range of the distance from the camera, 0 < near < far, with
            equal numbers in each octave.
        sh_degree: 0 to 3; coefficients above the constant one are 0.
        scale_factor: standard deviation / mean distance to the three nearest other points.
        opacity: in (0, 1).
        seed: of the random numbers.

    Returns:
        `count` grey float32 Gaussians, each on the ray of a random valid pixel of a random pose, so
        that wide lenses fill their whole field.

    Raises:
        InputError: shapes disagree, a value is out of range, or a camera has no valid pixel.
    """
    points = sample_points_in_view(cameras, poses, count, near=near, far=far, seed=seed)
    return seed_from_points(points, sh_degree=sh_degree, scale_factor=scale_factor, opacity=opacity)
