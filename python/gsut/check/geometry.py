"""Checks lenses, poses and points by their geometry alone, without the photographs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gsut._core import CameraMotion
from gsut.check.findings import Finding, make_reporters
from gsut.check.samples import SIDE, pair_equal
from gsut.data import Scene, list_some
from gsut.data.points import UNCOLORED, has_colors
from gsut.data.poses import invert_pose
from gsut.data.scene import project_points
from gsut.gaussians import measure_rotation_angles
from gsut.render import compute_field_angles
from gsut.sampling import ENOUGH_SAMPLES, FEWEST_SAMPLES

_NARROWEST = 1.0  # degrees off the axis, which the longest photographic lenses see
_SAME_PLACE = 1e-6  # of the extent: cameras this near are at one place
_POSSIBLE_EXTENTS = (1e-4, 1e5)  # units; others come of a mistake
_POINT_SPREAD_RANGE = (0.05, 100.0)  # median distance of the points over the extent


def check_lenses(scene: Scene) -> Iterator[Finding]:
    """Checks the share of pixels without a ray, principal point and focal lengths."""
    for number, camera in enumerate(scene.cameras):
        where = f"camera {number} ({camera.model}, {camera.width} x {camera.height})"
        inform, warn = make_reporters(where)
        longer = max(camera.width, camera.height)
        sizes = [max(1, side * SIDE // longer) for side in (camera.width, camera.height)]
        small = camera if longer <= SIDE else camera.resize(*sizes)
        angles = np.degrees(compute_field_angles(small))
        blind = float(np.isnan(angles).mean())
        limit = np.degrees(camera.max_angle)
        if blind == 1:
            yield Finding(
                "error", where, "no pixel has a ray", "the distortion is wrong: calibrate again"
            )
            continue
        most = np.nanmax(angles)
        widest = f"the widest pixel sees {most:.1f} degrees off the axis"
        if most < _NARROWEST:
            yield warn(
                f"the lens sees {2 * most:.2g} degrees from corner to corner",
                "no photographic lens sees so little: check focal length, distortion, width and "
                "height",
            )
        if blind > 0:
            yield inform(
                f"{blind:.1%} of the pixels have no ray (the lens model ends at {limit:.1f}"
                f" degrees) and are masked; {widest}",
                "if these pixels show the scene, calibrate with a model for this field of view",
            )
        else:
            yield inform(f"every pixel has a ray; {widest}")
        axis = camera.project(np.array([[0.0, 0.0, 1.0]]))[0][0]
        size = np.array([camera.width, camera.height])
        if not np.all((axis > 0.2 * size) & (axis < 0.8 * size)):
            yield warn(
                f"the optical axis meets the image at ({axis[0]:.1f}, {axis[1]:.1f}), far from its"
                " middle",
                "check cx and cy, and that the images are not cropped",
            )
        around = camera.project(np.array([[0.01, 0.0, 1.0], [0.0, 0.01, 1.0]]))[0] - axis
        ratio = np.linalg.norm(around[0]) / np.linalg.norm(around[1])
        if not 0.9 < ratio < 1.1:
            yield warn(
                f"the focal lengths differ by a factor of {ratio:.3f}",
                "real lenses have nearly equal ones: check width, height and focal lengths",
            )


def check_poses(scene: Scene) -> Iterator[Finding]:
    """Checks for repeated cameras, a far origin, up direction and shutter."""
    (inform, warn), views = make_reporters(str(scene.path)), scene.views
    centers = np.array([view.camera_center for view in views])
    spread = np.linalg.svd(centers - centers.mean(axis=0), compute_uv=False)
    if len(views) > 1 and spread[0] <= _SAME_PLACE * scene.extent * np.sqrt(len(views)):
        yield warn(
            "all cameras stand at one place",
            "depth cannot be found from a turning camera: move it, or check the translations",
        )
    elif pairs := pair_equal({k: view.camera_from_world.tobytes() for k, view in enumerate(views)}):
        names = list_some([f"{views[one].name} = {views[two].name}" for one, two in pairs])
        yield warn(
            f"{len(pairs)} pairs of views have the same pose: {names}",
            "check how poses are matched to images; for a rig, give each camera its own pose",
        )
    if not _POSSIBLE_EXTENTS[0] < scene.extent < _POSSIBLE_EXTENTS[1]:
        yield warn(
            f"the cameras' extent is {scene.extent:.3g} units: an unusual scale",
            "check the unit of the poses, and that no camera stands far away",
        )
    up = -np.mean([view.camera_from_world[1, :3] for view in views], axis=0)
    axis = int(np.argmax(np.abs(up)))
    if up[axis] < -0.5:
        yield inform(
            f"the cameras' up is the world's -{'xyz'[axis]}: a viewer with +{'xyz'[axis]} up shows"
            " the scene upside down (usual for COLMAP, whose y points down)"
        )
    rolling = [view.motion for view in views if isinstance(view.motion, CameraMotion)]
    if rolling:
        ends = [(np.asarray(motion.at(0.0)), np.asarray(motion.at(1.0))) for motion in rolling]
        steps = np.array([start @ invert_pose(end) for start, end in ends])
        moved = np.median(np.linalg.norm(steps[:, :3, 3], axis=1))
        turned = np.degrees(np.median(measure_rotation_angles(steps[:, :3, :3])))
        yield inform(
            f"{len(rolling)} views have rolling-shutter poses (median motion in one frame"
            f" {moved:.3g} units, {turned:.2g} degrees)",
            "training sees each line from its own pose; --shutter global would blur the scene",
        )


def check_points(scene: Scene) -> Iterator[Finding]:
    """Checks number and spread of the points, and how many of them the cameras see."""
    where, count = str(scene.path), len(scene.points)
    inform, warn = make_reporters(where)
    if count == 0:
        yield warn(
            "there are no points",
            "training starts by stereo, or from random ones; `gsut depth` gives a cloud with these"
            " poses",
        )
        return
    if count < FEWEST_SAMPLES:
        yield warn(f"only {count} points", "`gsut depth` gives a denser cloud")
    if not has_colors(scene):
        yield inform(UNCOLORED)
    seen = _find_seen_points(scene)
    per_view, unseen = seen.mean(axis=1), float(np.mean(~seen.any(axis=0)))
    yield inform(
        f"{count} points; a view sees {np.median(per_view):.0%} of them in the median,"
        f" {per_view.min():.0%} at least; {unseen:.1%} are in no view"
    )
    if not seen.any():
        # A single view may look elsewhere than the others of its capture did.
        yield Finding(
            "error" if len(scene) > 1 else "warning",
            where,
            "no view sees any of the points",
            "the poses may be world-to-camera or use other axes: compare with the format's"
            " description; or points and poses are of different models or scales",
        )
    center = np.mean([view.camera_center for view in scene.views], axis=0)
    spread = float(np.median(np.linalg.norm(scene.points - center, axis=1))) / scene.extent
    if not _POINT_SPREAD_RANGE[0] < spread < _POINT_SPREAD_RANGE[1]:
        yield inform(
            f"the points' median distance is {spread:.3g} x the cameras' extent",
            "usual for cameras that turn on the spot; otherwise points and poses may have "
            "different units",
        )


def _find_seen_points(scene: Scene) -> np.ndarray:
    """Returns (V, P) bool: which of some evenly chosen points lie in each view's image."""
    points = scene.points[:: -(-len(scene.points) // ENOUGH_SAMPLES)]
    seen = np.zeros((len(scene), len(points)), bool)
    for index, view in enumerate(scene.views):
        camera = scene.camera(index)
        _, pixels, valid = project_points(camera, view.camera_from_world, points)
        with np.errstate(invalid="ignore"):
            inside = (pixels >= 0) & (pixels < [camera.width, camera.height])
        seen[index] = np.asarray(valid, bool) & inside.all(axis=1)
    return seen
