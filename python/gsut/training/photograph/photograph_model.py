"""Finds exposure, white balance and falloff of the photographs while a scene is trained.

Each step compares its image with its photograph, and least squares give the photograph's gain, one
a channel (`PhotometricTarget.light_sums`); nothing is optimised by gradients. The photograph is
divided by its light, not the image multiplied: Gaussians learn the scene at the mean gain and
without falloff, and the backward pass needs neither. The mean log-gain of the training views is
held at zero, exactly, beside a level common to all: it gives gains and falloffs together a mean of
1 over the photographs' pixels, so that the scene is as bright as its photographs are.
"""

from __future__ import annotations

import bisect
import copy
import math
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Scene
from gsut.data.scene import Level
from gsut.judge import SURE
from gsut.render import (
    Falloff,
    Light,
    compute_field_angles,
)
from gsut.run import TrainOptions
from gsut.training.photograph.falloff_fit import (
    QUADRANTS,
    RINGS,
    average_basis,
    divide_photograph,
    find_widest_angle,
    fit_falloff,
    is_falloff_certain,
    measure_passed_light,
)
from gsut.training.photograph.gains_in_time import interpolate_gains

# Fraction of the steps before which images show too little of the scene to judge a photograph by.
_FROM = 0.05
# Fractions of the steps at which "auto" checks whether gains differ; a long run decides early.
_DECIDED_AT = (0.25, 0.3, 0.35, 0.4, 0.5, 0.6)
# Fractions of the steps at which falloffs are fitted: a young scene is less sharp at the rim than
# at the centre, which looks like falloff.
_FALLOFF_AT = (0.35, 0.5, 0.65, 0.8, 0.93)
# Relative change below which a new falloff is discarded: each change resets every photograph's
# statistics.
_MOVED = 0.002
# Normal deviate of the correlation of two visits' gains: chance exceeds it once in a thousand runs.
_CHANCE = 3.09
# Standard deviation of log-gains above which photographs differ: 1 % of brightness, which begins to
# show in the result.
GAINS_DIFFER = 0.01
# Views seen twice below which nothing is decided: correlations of fewer are chance.
_FEWEST_TWICE = 5
# Log-gain of all photographs together above which the scene has not reached their brightness and
# says nothing about one of them.
_UNSETTLED = 0.25
# Largest plausible logarithm of a gain, a factor of two.
_STRONGEST = 0.7
# Smallest plausible falloff: lenses darken towards the rim by at most ten.
_DARKEST = 0.1
# Largest plausible falloff: lenses do not brighten towards the rim, save for errors of the fit.
_BRIGHTEST = 1.05
# Number of angles at which a falloff is checked.
_CHECKED = 65


class PhotographModel:
    """Estimates gains of the training views and falloffs of their cameras.

    Args:
        scene: at any resolution.
        options: `exposure` decides whether the model is used.
        light: what an earlier run has found; None: nothing is known.
    """

    def __init__(self, scene: Scene, options: TrainOptions, light: Light | None = None) -> None:
        self._mode = options.exposure
        self._gains_used = self._mode == "on"
        self._scene = scene
        self._camera_of = [view.camera_index for view in scene.views]
        self._names = [view.name for view in scene.views]
        count = len(scene.views)
        self._log_gains, self._known = np.zeros((count, 3)), np.zeros(count, bool)
        # The last sums of each view: (V, 2, rings x quadrants, 3) of T C and of C^2.
        self._sums = np.zeros((count, 2, RINGS * QUADRANTS, 3))
        self._before = np.zeros_like(self._sums)  # those of the visit before
        self._total = [0.0] * 3  # of the known log-gains; those of other views are zero
        self._num_known = 0
        self._falloffs: list[Falloff | None] = [None] * len(scene.cameras)
        self._level = np.ones(3)  # factor of all gains, one a channel
        self._looked = (0, 0)  # how often for gains, for falloffs
        if light is not None:
            train, log_gains = list(scene.train_indices), np.log(light.gains)
            if any(light.falloffs):
                self._level = np.exp(log_gains[train].mean(axis=0))
            self._log_gains[train] = log_gains[train] - np.log(self._level)
            self._known[train], self._num_known = True, len(train)
            self._total = self._log_gains.sum(axis=0).tolist()
            self._falloffs = list(light.falloffs)
        self._bases: dict[int, tuple[float, np.ndarray]] = {}
        self._lights: dict[int, np.ndarray] = {}  # see `_find_light_of_parts`
        self._planes: dict[tuple[int, int, int], Any] = {}  # of one level's cameras
        self._parts: dict[tuple[int, int, int], np.ndarray] = {}

    def observe(
        self,
        fraction: float,
        level: Level,
        view: int,
        target: _core.PhotometricTarget,
        image: np.ndarray,
    ) -> None:
        """Updates the light of a view's photograph from its image and passes it to `target`.

        Args:
            fraction: of the steps that are done.
            level: whose view it is.
            view: whose photograph `target` is.
            image: (H, W, 3) float32, the view as it is rendered now.
        """
        if self._mode == "off" or fraction < _FROM:
            return
        camera = level.scene.camera(view)
        key = (self._camera_of[view], camera.width, camera.height)
        self._compare(fraction, key, camera, view, target, image)
        falloff = self._falloffs[key[0]]
        if falloff is not None and key not in self._planes:
            self._planes = {k: v for k, v in self._planes.items() if k[0] != key[0]}
            inverse = 1.0 / falloff.evaluate(compute_field_angles(camera))
            self._planes[key] = _core.FalloffPlane(inverse.astype(np.float32))
        target.set_light(self._invert_gain(view), self._planes.get(key))

    def _compare(
        self,
        fraction: float,
        key: tuple[int, int, int],
        camera: Any,
        view: int,
        target: _core.PhotometricTarget,
        image: np.ndarray,
    ) -> None:
        """Compares one image: updates the gain, and at certain fractions decides on gains and
        falloffs.

        Args:
            fraction, view, target, image: see `observe`.
            key: of the camera at this size.
            camera: this camera.
        """
        if key not in self._parts:
            self._parts = {k: v for k, v in self._parts.items() if k[0] != key[0]}
            self._parts[key] = divide_photograph(camera)
        if not self._gains_used:
            self._before[view] = self._sums[view]
        self._sums[view] = target.light_sums(image, self._parts[key], RINGS * QUADRANTS)
        self._learn_gain(view)
        looked = bisect.bisect(_DECIDED_AT, fraction), bisect.bisect(_FALLOFF_AT, fraction)
        if looked[0] > self._looked[0]:
            self._gains_used = self._gains_used or self.measure_spread() > GAINS_DIFFER
        if looked[1] > self._looked[1]:
            self._find_falloffs()
        self._looked = looked

    def measure_spread(self) -> float:
        """Returns the standard deviation of log-gains that two visits and all quarters agree on.

        Of brightness or of white balance, whichever differs more; 0 if chance may explain it.
        """
        twice = np.flatnonzero(self._known & (self._before[:, 1] > 0).any(axis=(1, 2)))
        if len(twice) < _FEWEST_TWICE:
            return 0.0
        visits = [
            sums[twice].reshape(-1, 2, RINGS, QUADRANTS, 3) for sums in (self._before, self._sums)
        ]
        if abs(np.log(visits[1][:, 0].sum() / visits[1][:, 1].sum())) > _UNSETTLED:
            return 0.0
        (before, _), (now, errors) = (_estimate_gains(visit) for visit in visits)
        found = [0.0]
        for part in (_average_channels, _subtract_brightness):
            a, b = (part(gains) - part(gains).mean(axis=0) for gains in (before, now))
            both = np.mean(np.sum(a * b, axis=1))
            alone = np.sqrt(np.mean(np.sum(a**2, axis=1)) * np.mean(np.sum(b**2, axis=1)))
            chance = np.arctanh(min(both / alone, 1 - 1e-12)) * np.sqrt(len(twice) - 3)
            noise = np.mean(np.sum(part(errors) ** 2, axis=(1, 2)))
            if chance > _CHANCE and both > SURE**2 * noise:
                found.append(float(np.sqrt(both - noise)))
        return max(found)

    def find_light(self) -> Light | None:
        """Returns the light of all views; views without training take their neighbours' in time."""
        if not self._gains_used and not any(self._falloffs):
            return None
        known = np.flatnonzero(self._known)
        logs = np.zeros_like(self._log_gains)
        if self._gains_used:
            logs = self._log_gains - self._log_gains[known].mean(axis=0)
        logs = interpolate_gains(logs, known.tolist(), self._names, self._camera_of)
        return Light(np.exp(logs) * self._level, tuple(self._falloffs))

    def _learn_gain(self, view: int) -> None:
        """Moves a view's gain halfway to what the last image says."""
        sums = self._sums[view]
        if any(self._falloffs):
            sums = sums * self._find_light_of_parts(self._camera_of[view])
        tc, cc = np.add.reduce(sums, axis=1).tolist()
        if not all(value > 0 for value in (*tc, *cc)):
            return
        found = [math.log(t / c) for t, c in zip(tc, cc, strict=True)]
        found = [min(max(gain, -_STRONGEST), _STRONGEST) for gain in found]
        before = self._log_gains[view].tolist()
        if not self._known[view]:
            self._known[view] = True
            self._num_known += 1
            gains = found
        else:
            gains = [0.5 * (a + b) for a, b in zip(before, found, strict=True)]
        self._log_gains[view] = gains
        change = zip(self._total, gains, before, strict=True)
        self._total = [total + now - old for total, now, old in change]

    def _invert_gain(self, view: int) -> list[float]:
        """Returns the factors of a view's photograph, one a channel."""
        levels = self._level.tolist()
        if not self._gains_used:
            return [1.0 / level for level in levels]
        gains = self._log_gains[view].tolist()
        count = max(1, self._num_known)
        values = zip(self._total, gains, levels, strict=True)
        return [math.exp(total / count - gain) / level for total, gain, level in values]

    def _find_light_of_parts(self, camera: int) -> np.ndarray:
        """Returns (2, rings x quadrants, 3), the factors of sums of T C and of C^2."""
        if camera not in self._lights:
            falloff, light = self._falloffs[camera], np.ones((RINGS, 3))
            if falloff is not None:
                light += self._get_basis(camera)[1] @ falloff.coefficients.T
            light = np.repeat(self._level * light, QUADRANTS, axis=0)
            self._lights[camera] = np.stack([light, light**2])
        return self._lights[camera]

    def _get_basis(self, camera: int) -> tuple[float, np.ndarray]:
        """Returns widest angle and `average_basis` of a camera; computed once."""
        if camera not in self._bases:
            angles = compute_field_angles(self._scene.cameras[camera])
            self._bases[camera] = find_widest_angle(angles), average_basis(angles)
        return self._bases[camera]

    def _find_falloffs(self) -> None:
        """Fits each camera's falloff to the rings of all its photographs, with gains held."""
        for camera in range(len(self._scene.cameras)):
            angle, basis = self._get_basis(camera)
            views = [v for v in np.flatnonzero(self._known) if self._camera_of[v] == camera]
            rings = self._sums[views].reshape(-1, 2, RINGS, QUADRANTS, 3).sum(axis=3)
            gains = np.exp(self._log_gains[views])[:, None]
            tc, cc = gains * rings[:, 0], gains**2 * rings[:, 1]  # (views, rings, 3)
            if not (cc.sum(axis=(0, 1)) > 0).all():
                continue
            found = fit_falloff(angle, basis, tc.sum(axis=0), cc.sum(axis=0))
            values = found.evaluate(np.linspace(0.0, angle, _CHECKED))
            believed = values.min() > _DARKEST and values.max() < _BRIGHTEST
            self._take_falloff(camera, found if believed and is_falloff_certain(tc, cc) else None)

    def _take_falloff(self, camera: int, found: Falloff | None) -> None:
        """Replaces a camera's falloff unless the new one hardly differs."""
        before = self._falloffs[camera]
        if found is not None and before is not None:
            angles = np.linspace(0.0, found.max_angle, _CHECKED)
            if np.abs(found.evaluate(angles) / before.evaluate(angles) - 1.0).max() < _MOVED:
                return
        passed = measure_passed_light(self._scene, self._falloffs)
        self._falloffs[camera] = found
        self._level *= passed / measure_passed_light(self._scene, self._falloffs)
        self._lights = {}
        self._planes = {key: plane for key, plane in self._planes.items() if key[0] != camera}

    def state_dict(self) -> dict[str, Any]:
        """Returns everything that later steps depend on."""
        return {name: copy.copy(getattr(self, name)) for name in _STATE} | {
            "falloffs": [None if each is None else each.as_dict() for each in self._falloffs],
            "level": self._level.copy(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the state that `state_dict` returned; the following steps have the same bits."""
        for name in _STATE:
            setattr(self, name, copy.copy(state[name]))
        self._falloffs = [Falloff.from_dict(each) for each in state["falloffs"]]
        self._level = np.array(state["level"])
        self._lights, self._planes = {}, {}


_STATE = (
    "_mode", "_gains_used", "_log_gains", "_known", "_total", "_num_known", "_sums", "_before",
    "_looked",
)  # fmt: skip


def _estimate_gains(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimates log-gains (V, 3) and their errors (V, quadrants, 3).

    What all photographs' rings have in common, a falloff, is no gain. The squares of a view's
    errors add up to the variance of its gain, judged by how far its quarters disagree.

    Args:
        sums: (V, 2, rings, quadrants, 3) of T C and of C^2.
    """
    tc, cc = sums[:, 0], sums[:, 1]
    common = tc.sum(axis=(0, 2)) / np.maximum(cc.sum(axis=(0, 2)), np.finfo(float).tiny)
    tc = (tc / np.maximum(common, np.finfo(float).tiny)[:, None]).sum(axis=1)
    cc = cc.sum(axis=1)  # (V, quadrants, 3)
    share = cc / np.maximum(cc.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    gain = tc.sum(axis=1) / np.maximum(cc.sum(axis=1), np.finfo(float).tiny)
    apart = np.where(cc > 0, tc / np.where(cc > 0, cc, 1.0), 0.0) / gain[:, None] - 1.0
    apart -= np.mean(apart, axis=0)  # what the quarters of all have in common is no disagreement
    return np.log(gain), share * apart * np.sqrt(QUADRANTS / (QUADRANTS - 1))


def _average_channels(logs: np.ndarray) -> np.ndarray:
    """Returns the brightness (..., 1) of log-gains (..., 3)."""
    return logs.mean(axis=-1, keepdims=True)


def _subtract_brightness(logs: np.ndarray) -> np.ndarray:
    """Returns the white balance (..., 3) of log-gains (..., 3)."""
    return logs - _average_channels(logs)
