"""A made rig on a walk among points: tracks known exactly, so that only the rig is on trial."""

from pathlib import Path

import cv2
import numpy as np

import gsut
from gsut import _core
from gsut.data.poses import invert_pose
from gsut.data.rigs import Rig
from gsut.sfm.mapping import Mapping, PosesLog
from gsut.sfm.matches.matching import PairMatches
from gsut.sfm.photographs import PosesOptions
from gsut.sfm.photographs.listing import Photographs
from gsut.sfm.rig import find_image_lines
from synthetic_walk import observe

_FEWEST_SHARED = 25  # points of a pair of images worth a match


def pose_of(turn, center):
    """(4, 4) of a rotation vector and the camera's centre."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array(turn, float))[0]
    pose[:3, 3] = -pose[:3, :3] @ np.array(center, float)
    return pose


# Right of the first, turned out; or looking backwards from behind it. Units: metres, say.
STEREO = pose_of([0.02, 0.1, -0.01], [0.3, 0.01, 0.02])
BACKWARD = pose_of([0.03, np.pi - 0.05, 0.02], [0.05, -0.1, -0.4])


class SyntheticRig:
    """Cameras of different lenses on a body that walks a round and turns.

    Args:
        rng: source of points and noise.
        mounts: (4, 4) second, third camera from the first [STEREO].
        elsewhere: (4, 4) first camera from the reference [the same].
        lenses: of the cameras [a fisheye, a distorted lens, a pinhole].
        readings: of cameras with a rolling shutter.
        readout: the longest, over the time between frames.
        frames, points: how many. noise: of the features, pixels.
        absent: (frame, camera) without an image.
        blind: (frame, camera) that sees few points; few: how many.
    """

    def __init__(
        self, rng, *mounts, frames=10, points=700, noise=0.0, absent=(), blind=(), few=6,
        elsewhere=None, lenses=None, readings=(), readout=0.06,
    ):  # fmt: skip
        first = np.eye(4) if elsewhere is None else elsewhere
        poses = np.stack([np.eye(4), *(mounts or [STEREO])]) @ first
        count = len(poses)
        lenses = lenses or (
            gsut.Camera(
                "kannala_brandt", [300, 301, 400, 402, 0.02, -0.01, 0.002, 0], 800, 800,
                valid_field_angle=np.radians(65),
            ),
            gsut.Camera("opencv4", [350, 351, 320, 241, -0.02, 0.003, 1e-4, -2e-4], 640, 480),
            gsut.Camera("pinhole", [330, 331, 322, 238], 640, 480),
        )  # fmt: skip
        names = ("left", "right", "third")[:count]
        files = tuple((Path(f"{name}.yaml"), None) for name in names)
        self.rig = Rig(Path("rig.json"), names, lenses[:count], poses, files, readings)
        self._readout, self.velocities = readout, []
        directions = rng.standard_normal((points, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self.points = directions * rng.uniform(3, 7, (points, 1))
        identity = rng.random((points, 128)) ** 4
        self.poses, names, frames_of, cameras_of = [], [], [], []
        self.features, self._seen = [], []
        for frame in range(frames):
            body, velocity = self._move_body(frame, frames)
            self.velocities.append(velocity)
            for camera, name in enumerate(self.rig.names):
                if (frame, camera) in absent:
                    continue
                names.append(f"{name}/{frame:03d}.png")
                frames_of.append(frame)
                cameras_of.append(camera)
                self.poses.append(self.rig.camera_from_reference[camera] @ body)
                most = few if (frame, camera) in blind else points
                pixels, valid = self._project(camera, body, velocity)
                self._add_features(rng, self.rig.cameras[camera], pixels, valid, noise, identity,
                                   most)  # fmt: skip
        self.poses = np.array(self.poses)
        self.photographs = Photographs(
            Path("."), names, [Path(n) for n in names], [None] * len(names),
            [self.rig.cameras[c] for c in cameras_of], frames=np.array(frames_of),
            rig_cameras=np.array(cameras_of), paired_by="name",
        )  # fmt: skip
        self.pairs = self._pairs()

    def _move_body(self, frame, frames):
        """The body in the middle of a frame's readout, and how far it moves during the longest."""

        def place(time):
            angle = 2 * np.pi * time / frames
            center = [np.cos(angle), 0.2 * np.sin(2 * angle), np.sin(angle)]
            return pose_of([0.1 * np.sin(angle), angle, 0.1 * np.cos(angle)], center)

        ends = [place(frame + share * self._readout) for share in (-0.5, 0.5)]
        return place(frame), _core.velocity_between(*ends)

    def _project(self, camera, body, velocity):
        """Pixels of all points in a camera, each at the time of its line, and which have one."""
        lens, times = self.rig.cameras[camera], np.zeros(len(self.points))
        mount = self.rig.camera_from_reference[camera]
        reading = self.rig.readings[camera] if self.rig.readings else None
        longest = max((r.seconds for r in self.rig.readings if r), default=1.0)
        for _ in range(12 if reading else 1):  # the line that sees a point: a fixed point
            moved = np.array([mount @ _core.moved_pose(body, velocity, time) for time in times])
            p = np.einsum("nij,nj->ni", moved[:, :3, :3], self.points) + moved[:, :3, 3]
            pixels, valid = lens.project(p)
            if reading:
                direction = reading.shutter.direction
                axis = int("top" in direction)
                share = pixels[:, axis] / (lens.width, lens.height)[axis] - 0.5
                sign = 1 if direction in ("top_to_bottom", "left_to_right") else -1
                times = np.where(valid, sign * share * reading.seconds / longest, 0.0)
        return pixels, valid

    def _add_features(self, rng, lens, pixels, valid, noise, identity, most):
        seen, features = observe(rng, lens, pixels, valid, noise, identity, most)
        self._seen.append(seen)
        self.features.append(features)

    def _pairs(self):
        pairs = []
        for i, mine in enumerate(self._seen):
            for j in range(i + 1, len(self._seen)):
                _, first, second = np.intersect1d(mine, self._seen[j], return_indices=True)
                few = min(len(mine), len(self._seen[j])) < _FEWEST_SHARED
                if len(first) < (3 if few else _FEWEST_SHARED):
                    continue
                relative = self.poses[j] @ invert_pose(self.poses[i])
                distance = np.linalg.norm(relative[:3, 3])
                relative[:3, 3] /= distance
                matches = np.stack([first, second], axis=1).astype(np.int32)
                pairs.append(PairMatches(i, j, matches, relative, 0, float(distance / 5)))
        return pairs

    def worst(self, solution):
        """Largest distance of a centre and largest turn in degrees, the first pose laid on truth.

        No scale is taken out: the rig's is on trial.
        """
        first = int(np.argmax(solution.registered))
        onto = invert_pose(solution.camera_from_world[first]) @ self.poses[first]
        apart, turned = [], []
        for found, truth in zip(
            solution.camera_from_world[solution.registered],
            self.poses[solution.registered],
            strict=True,
        ):
            step = found @ onto @ invert_pose(truth)
            apart.append(
                np.linalg.norm(invert_pose(found @ onto)[:3, 3] - invert_pose(truth)[:3, 3])
            )
            turned.append(np.degrees(np.linalg.norm(cv2.Rodrigues(step[:3, :3])[0])))
        return max(apart), max(turned)

    def mapping(self, refine_rig=False, **known):
        """The state of a run that has verified the matches of the rig's images."""
        if "shutter" not in known:
            lines = find_image_lines(self.rig, self.photographs.rig_cameras)
            known |= dict(zip(("shutter", "lines"), lines, strict=True))
        return Mapping(
            self.photographs, PosesOptions(refine_rig=refine_rig), PosesLog(),
            features=self.features, pairs=self.pairs, **known,
        )  # fmt: skip
