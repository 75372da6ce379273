"""A made walk among points: features through a lens of 200 degrees, with their descriptors."""

from pathlib import Path

import numpy as np

import gsut
from gsut import _core
from gsut.lens import with_scaled_focal
from gsut.sfm.mapping import Mapping, PosesLog
from gsut.sfm.matches.matching import match_images
from gsut.sfm.matches.verification import verify_matches
from gsut.sfm.photographs import Images, Photographs
from gsut.sfm.photographs.features import Features
from gsut.sfm.photographs.options import PosesOptions


def quiet(*_: object) -> None:
    """Progress that nobody looks at."""


def observe(rng, camera, pixels, valid, noise, identity, most=None):
    """Which points have a feature, and these; the first `most` of those in the image and field."""
    pixels = pixels + noise * rng.standard_normal(pixels.shape)
    with np.errstate(invalid="ignore"):
        valid &= (pixels > 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    valid[valid] = camera.unproject(pixels[valid])[1]
    seen = np.flatnonzero(valid)[:most]
    values = np.sqrt(identity[seen] + 0.01 * rng.random((len(seen), 128)))
    values /= np.linalg.norm(values, axis=1, keepdims=True)
    return seen, Features(
        pixels[seen], np.full(len(seen), 3, np.float32),
        np.rint(512 * values).clip(0, 255).astype(np.uint8),
        np.full((len(seen), 3), 128, np.uint8),
    )  # fmt: skip


def shuffled(rng, features):
    """The features in an order that says nothing."""
    order = rng.permutation(len(features))
    arrays = features.pixels, features.sizes, features.descriptors, features.colors
    return Features(*(array[order] for array in arrays))


class Synthetic:
    """Points around a walk, seen by features with noise and with descriptors that match."""

    def __init__(
        self,
        rng,
        images=8,
        points=500,
        noise=0.2,
        reach=1.0,
        turn=1.0,
        readout=None,
        camera=None,
        zooms=None,
    ):
        """reach, turn: factors on the walk, and on how far the camera turns.

        readout: of a rolling shutter, top to bottom, over the time between frames, or None.

        zooms: factor on the focal length of each image, or None.
        """
        self.camera = camera or gsut.Camera(
            "kannala_brandt", [300, 301, 500, 505, 0.02, -0.01, 0.002, -0.0003], 1000, 1010
        )
        self.points = rng.uniform([-4, -4, -3], [4, 4, 5], (points, 3))
        self.poses = []
        self.features = []
        identity = rng.random((points, 128)) ** 4
        self.velocities = []
        for i in range(images):
            pose = _core.exp_pose([0, 0, 0, *(turn * np.array([0.02 * i, 0.15 * i, 0.01 * i]))])
            center = reach * np.array([0.3 * i, 0.05 * i * i, 0.1 * (i % 2)])
            pose[:3, 3] = -pose[:3, :3] @ center
            velocity = np.zeros(6)
            if readout is not None:  # as fast as the walk, the sway apart
                velocity = readout * np.array([0.3, 0.1 * i, 0.0, 0.02, 0.15, 0.01])
            self.velocities.append(velocity)
            self.poses.append(pose)
            camera = with_scaled_focal(self.camera, zooms[i]) if zooms else self.camera
            projected = self._seen(camera, pose, velocity)
            _, features = observe(rng, camera, *projected, noise, identity)
            self.features.append(shuffled(rng, features))

    def _seen(self, camera, pose, velocity):
        """Pixels of all points, each at the time of its line, and which have one."""
        times = np.zeros(len(self.points))
        for _ in range(30 if velocity.any() else 1):  # the line that sees a point: a fixed point
            moved = np.array([_core.moved_pose(pose, velocity, t) for t in times])
            p = np.einsum("nij,nj->ni", moved[:, :3, :3], self.points) + moved[:, :3, 3]
            pixels, valid = camera.project(p)
            times = np.where(valid, pixels[:, 1] / camera.height - 0.5, 0.0)
        return pixels, valid

    def verified(self, options=None):
        options = options or PosesOptions()
        images = self.images()
        raw = match_images(images.names, self.features, options, quiet)
        return verify_matches(images, raw, options)

    def images(self, camera=None, shutter=None):
        """All images as the solver takes them, through the true lens or another one."""
        names = [f"{i:03d}.png" for i in range(len(self.features))]
        return Images(names, [camera or self.camera] * len(names), self.features, shutter)

    def mapping(self, options, *, camera=None, raw=None, **known):
        """The state of a run that has found the features and matches of the walk."""
        images = self.images(camera)
        raw = raw or match_images(images.names, self.features, options, quiet)
        paths = [Path(name) for name in images.names]
        photographs = Photographs(Path(), images.names, paths, [None] * len(paths), images.cameras)
        return Mapping(photographs, options, PosesLog(), features=self.features, raw=raw, **known)

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
