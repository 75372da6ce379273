"""What the images determine of a refined rig: its turns and places, by motion and overlap."""

import numpy as np
import pytest

import gsut
import tolerances
from gsut.data.rigs import measure_changes
from gsut.sfm.photographs.options import PosesOptions
from gsut.sfm.rig.description import add_uncertainty, describe_open
from gsut.sfm.rig.fit import solve_rig
from gsut.sfm.rig.observability import estimate_mount_uncertainty
from gsut.sfm.solution import Adjustment, RigConstraint, adjust_poses, solver
from gsut.sfm.solution.result import FEATURE_VARIANCE
from synthetic_rig import SyntheticRig, pose_of

SIDEWAYS = pose_of([0.01, np.pi / 2, 0.02], [0.3, 0.05, -0.1])
FRAMES = 8
SEEDS = 6  # of scenes, where a spread is on trial


def move_straight(share):
    return pose_of([0, 0, 0], [2 * share - 1, 0, 0])


def move_in_a_plane(share):
    return pose_of([0, 3 * share, 0], [1.5 * np.cos(4 * share), 0, 1.5 * np.sin(4 * share)])


class MovingRig(SyntheticRig):
    """A rig on another path; its cameras' features are matched with each other's, or not."""

    def __init__(self, rng, move=None, overlap=True, **settings):
        self._path = move
        super().__init__(rng, SIDEWAYS, noise=0.2, frames=FRAMES, points=500, **settings)
        cameras = self.photographs.rig_cameras
        if not overlap:
            self.pairs = [p for p in self.pairs if cameras[p.first] == cameras[p.second]]

    def _move_body(self, frame, frames):
        if self._path is None:
            return super()._move_body(frame, frames)
        return self._path(frame / frames), np.zeros(6)


def refine(scene):
    """The adjusted solution from true poses, and how well the second camera's pose is known."""
    photographs = scene.photographs
    constraint = RigConstraint(
        photographs.frames, photographs.rig_cameras - 1, SIDEWAYS[None],
        np.ones(len(scene.poses), bool), True,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        # Longer tracks would join cameras whose features are not matched.
        patch.setattr(solver, "_EXTEND_ROUNDS", 0)
        solution = adjust_poses(
            scene.mapping().images, scene.pairs, list(scene.poses), PosesOptions(),
            adjustment=Adjustment(rig=constraint),
        )  # fmt: skip
    (mount,) = estimate_mount_uncertainty(solution, constraint)
    return solution, mount


def list_open(mount):
    return [(kind, np.round(axis, 2).tolist()) for kind, axis, _ in mount.list_open_directions()]


@pytest.mark.parametrize(
    ("move", "overlap"),
    [(None, True), (None, False), (move_straight, True), (move_in_a_plane, True)],
)
def test_mounts_are_determined_by_turns_every_way_or_by_points_that_both_cameras_see(
    rng, move, overlap
):
    _, mount = refine(MovingRig(rng, move, overlap=overlap))
    assert mount.list_open_directions() == []


def test_mounts_on_a_straight_path_without_overlap_have_no_places_and_no_turn_about_it(rng):
    _, mount = refine(MovingRig(rng, move_straight, overlap=False))
    *places, (kind, axis) = list_open(mount)
    assert [name for name, _ in places] == ["place", "place"]  # all that keeps the size
    assert kind == "turn"
    assert np.abs(SIDEWAYS[:3, :3].T @ axis) @ [1, 0, 0] > 0.99  # the path, in the first camera


def test_mounts_moved_in_a_plane_without_overlap_have_no_height(rng):
    scene = MovingRig(rng, move_in_a_plane, overlap=False)
    solution, mount = refine(scene)
    ((kind, axis),) = list_open(mount)
    assert kind == "place" and axis[1] > 0.95
    # Where the images say nothing the rig stays as given.
    found = np.stack([np.eye(4), *solution.camera_from_body])
    _, (_, shift) = measure_changes(scene.rig, found)
    assert shift < tolerances.RIG_OPEN_SHIFT * np.linalg.norm(SIDEWAYS[:3, 3])


@pytest.mark.slow
def test_standard_deviations_of_mounts_are_those_of_many_runs():
    ratios = []
    for seed in range(SEEDS):
        scene = MovingRig(np.random.default_rng(seed))
        solution, mount = refine(scene)
        found = np.concatenate([np.eye(4)[None], solution.camera_from_body])
        turn = found[1, :3, :3] @ SIDEWAYS[:3, :3].T
        vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                           turn[1, 0] - turn[0, 1]]) / 2  # fmt: skip
        told = mount.turn / FEATURE_VARIANCE  # noise is independent here
        ratios.append(vector @ np.linalg.solve(told, vector) / 3)
    ratio = np.mean(ratios)
    assert 1 / tolerances.RIG_TURN_CHI_SQUARE < ratio < tolerances.RIG_TURN_CHI_SQUARE


def test_notes_name_the_directions_that_are_open(rng):
    _, mount = refine(MovingRig(rng, move_in_a_plane, overlap=False))
    figures = {"cameras": [{"name": "left"}, {"name": "right"}]}
    add_uncertainty(figures, [mount])
    assert describe_open(figures["cameras"][0]) is None
    words = describe_open(figures["cameras"][1])
    assert "hardly determine where right is on the rig: its place along y (down)" in words
    assert "leave --refine-rig out" in words


# --- cameras that see nothing in common -----------------------------------------------------------


def test_solve_rig_without_common_views_says_what_cameras_must_see():
    scene = MovingRig(np.random.default_rng(4), move_straight, overlap=False)
    with pytest.raises(gsut.SolveError, match=r"sets no scale.* at the same frame or later"):
        solve_rig(scene.mapping(rig=scene.rig))
