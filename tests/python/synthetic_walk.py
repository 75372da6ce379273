"""A made walk among points: features through a lens of 200 degrees, with their descriptors."""

import numpy as np

import gsut
from gsut import _core
from gsut.sfm.correspondences import match_images
from gsut.sfm.features import Features
from gsut.sfm.matching import verify
from gsut.sfm.options import PosesOptions


def quiet(*_: object) -> None:
    """Progress that nobody looks at."""


class Synthetic:
    """Points around a walk, seen by features with noise and with descriptors that match."""

    def __init__(self, rng, images=8, points=500, noise=0.2, turn_only=False, readout=None):
        """readout: of a rolling shutter, top to bottom, over the time between frames, or None."""
        self.camera = gsut.Camera(
            "kannala_brandt", [300, 301, 500, 505, 0.02, -0.01, 0.002, -0.0003], 1000, 1010
        )
        self.points = rng.uniform([-4, -4, -3], [4, 4, 5], (points, 3))
        self.poses = []
        self.features = []
        identity = rng.random((points, 128)) ** 4
        self.velocities = []
        for i in range(images):
            pose = _core.exp_pose([0, 0, 0, 0.02 * i, 0.15 * i, 0.01 * i])
            center = np.zeros(3) if turn_only else np.array([0.3 * i, 0.05 * i * i, 0.1 * (i % 2)])
            pose[:3, 3] = -pose[:3, :3] @ center
            velocity = np.zeros(6)
            if readout is not None:  # as fast as the walk, the sway apart
                velocity = readout * np.array([0.3, 0.1 * i, 0.0, 0.02, 0.15, 0.01])
            self.velocities.append(velocity)
            pixels, valid = self._seen(pose, velocity)
            pixels = pixels + noise * rng.standard_normal(pixels.shape)
            valid &= (pixels > 0).all(axis=1) & (pixels < [1000, 1010]).all(axis=1)
            valid[valid] = self.camera.unproject(pixels[valid])[1]
            values = np.sqrt(identity[valid] + 0.01 * rng.random((valid.sum(), 128)))
            values /= np.linalg.norm(values, axis=1, keepdims=True)
            count = int(valid.sum())
            order = rng.permutation(count)
            self.poses.append(pose)
            self.features.append(
                Features(
                    pixels[valid][order],
                    np.full(count, 3, np.float32),
                    np.rint(512 * values[order]).clip(0, 255).astype(np.uint8),
                    np.full((count, 3), 128, np.uint8),
                )
            )

    def _seen(self, pose, velocity):
        """Pixels of all points, each at the time of its line, and which have one."""
        times = np.zeros(len(self.points))
        for _ in range(30 if velocity.any() else 1):  # the line that sees a point: a fixed point
            moved = np.array([_core.moved_pose(pose, velocity, t) for t in times])
            p = np.einsum("nij,nj->ni", moved[:, :3, :3], self.points) + moved[:, :3, 3]
            pixels, valid = self.camera.project(p)
            times = np.where(valid, pixels[:, 1] / self.camera.height - 0.5, 0.0)
        return pixels, valid

    def verified(self, options=None):
        options = options or PosesOptions()
        count = len(self.features)
        raw = match_images([f"{i}" for i in range(count)], self.features, options, quiet)
        return verify(self.features, [self.camera] * count, raw, options)

    def settings(self, **more):
        return {"max_error": 2.5, "min_angle": 0.026, **more}

    def solve(self, camera=None, **settings):
        return _core.estimate_poses(
            [camera or self.camera],
            [0] * len(self.features),
            [f.pixels for f in self.features],
            [p.as_tuple() for p in self.verified()],
            self.settings(**settings),
            None,
        )
