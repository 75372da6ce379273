"""Exposure, white balance and falloff of the photographs, found while a scene is trained.

Each step compares its image with its photograph, and least squares give the photograph's gain, one
a channel (`PhotometricTarget.light_sums`); there is nothing to optimise. The photograph is divided
by its light, not the image multiplied: Gaussians learn the scene at the mean gain and without
falloff, and the backward pass knows of neither. The mean log-gain of the training views is held at
zero, exactly. Where the scene's points show that gains differ, theirs are used from the first step
until the images are better than they are.
"""

from __future__ import annotations

import bisect
import copy
import math
from typing import Any

import numpy as np

from gsut import _core
from gsut.data import Level, Scene
from gsut.render import Falloff, Light, falloff_basis, field_angles, interpolated_gains
from gsut.run import TrainOptions
from gsut.training.first_gains import first_gains

# Fractions of the steps: before the first the scene says little of the photographs; at the next
# "auto" looks whether they differ; at the last falloffs are found, which need a scene whose rim
# is as sharp as its centre (young ones of sponza_fisheye show 3 % of falloff where there is none).
_FROM = 0.05
# Gains that points have shown stay up to this fraction of the steps; from the one before it images
# are compared with photographs all the same, for the falloffs.
_POINTS_ALONE, _POINTS_UNTIL = 0.3, 0.5
_DECIDED_AT = (0.25, 0.3, 0.35, 0.4, 0.5, 0.6)
_FALLOFF_AT = (0.35, 0.5, 0.65, 0.8, 0.93)
# A falloff that is found again is taken where it has moved by more than this: with each that is
# another, every photograph's statistics are, too.
_MOVED = 0.002
# Photographs differ where their gains come out alike at two visits and in the quarters of the
# picture; errors of a young scene do neither. Chance makes gains of two visits agree so well once
# in a thousand times (normal deviate), and lets gains differ by three standard errors of their
# quarters less often (F with 4 and 15 degrees of freedom, of 5 views: 8.3). A standard deviation
# of 1 % is worth 0.1 dB of a scene of 30 dB.
_CHANCE, DIFFER = 3.09, 0.01
_FEWEST_TWICE = 5  # views seen twice, below which nothing is said
# Log-gain of all photographs together from which the scene is not as bright as they are yet, and
# tells nothing of one (the adaptive strategy begins with a gain of 20).
_UNSETTLED = 0.25
_DISAGREE = 3.0  # standard errors that errors of the scene may explain
_FALLOFF_DIFFERS = 0.05  # of rings from their mean, below which a lens has no falloff
_FEWEST_SHOWN = 0.01  # of all that a camera shows, below which a ring is not judged
_RINGS, _QUADRANTS = 8, 4  # parts of a photograph: field angle, and quarter of the picture
_STRONGEST = 0.7  # largest logarithm of a gain that is believed: a factor of two
_PRIOR = 1e-4  # weight of a ring's prior; those of what is seen add up to 1
_DARKEST, _BRIGHTEST = 0.1, 1.05  # falloffs that are believed: lenses darken towards the rim
_BASIS_ROWS = 100  # of all pixels, at least so many rows and columns say what a ring is
_CHECKED = 65  # angles at which a falloff is checked


class PhotographModel:
    """Gains of the training views and falloffs of their cameras.

    Args:
        scene: at any resolution.
        options: resolved; `exposure` says whether the model is used.
        light: what is known already, such as of the run that is fine-tuned; None: nothing.
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
        self._sums = np.zeros((count, 2, _RINGS * _QUADRANTS, 3))
        self._before = np.zeros_like(self._sums)  # those of the visit before
        self._total = [0.0] * 3  # of the known log-gains; those of other views are zero
        self._num_known = 0
        self._falloffs: list[Falloff | None] = [None] * len(scene.cameras)
        self._looked = (0, 0)  # how often for gains, for falloffs
        self._by_points = False
        first = first_gains(scene) if light is None and self._mode != "off" else None
        if first is not None:
            self._gains_used, self._by_points = True, True
            self._know(first)
        if light is not None:
            self._know(np.log(light.gains))
            self._falloffs = list(light.falloffs)
        self._bases: dict[int, tuple[float, np.ndarray]] = {}
        self._lights: dict[int, np.ndarray] = {}  # see `_light_of_parts`
        self._planes: dict[tuple[int, int, int], Any] = {}  # of one level's cameras
        self._parts: dict[tuple[int, int, int], np.ndarray] = {}

    def _know(self, log_gains: np.ndarray) -> None:
        """Begins with these (V, 3) of the training views; those of others stay zero."""
        train = list(self._scene.train_indices)
        self._log_gains[train], self._known[train] = log_gains[train], True
        self._total, self._num_known = self._log_gains.sum(axis=0).tolist(), len(train)

    def observe(
        self,
        fraction: float,
        level: Level,
        view: int,
        target: _core.PhotometricTarget,
        image: np.ndarray,
    ) -> None:
        """Learns the light of a view's photograph from its image, and tells it to the target.

        Args:
            fraction: of the steps that are done.
            level: whose view it is.
            view: whose photograph `target` is.
            image: (H, W, 3) float32, the view as it is rendered now.
        """
        if self._mode == "off" or (fraction < _FROM and not self._by_points):
            return
        camera = level.camera(view)
        key = (self._camera_of[view], camera.width, camera.height)
        if not self._by_points or fraction >= _POINTS_ALONE:
            self._compare(fraction, key, camera, view, target, image)
        falloff = self._falloffs[key[0]]
        if falloff is not None and key not in self._planes:
            self._planes = {k: v for k, v in self._planes.items() if k[0] != key[0]}
            inverse = 1.0 / falloff.at(field_angles(camera))
            self._planes[key] = _core.FalloffPlane(inverse.astype(np.float32))
        target.set_light(self._inverse_gain(view), self._planes.get(key))

    def _compare(
        self,
        fraction: float,
        key: tuple[int, int, int],
        camera: Any,
        view: int,
        target: _core.PhotometricTarget,
        image: np.ndarray,
    ) -> None:
        """What one image tells: of the gain at once, of all that differs when it is time to look.

        Args:
            fraction, view, target, image: see `observe`.
            key: of the camera at this size; camera: itself.
        """
        if key not in self._parts:
            self._parts = {k: v for k, v in self._parts.items() if k[0] != key[0]}
            self._parts[key] = _parts(camera)
        if not self._gains_used:
            self._before[view] = self._sums[view]
        self._sums[view] = target.light_sums(image, self._parts[key], _RINGS * _QUADRANTS)
        if not self._by_points or fraction >= _POINTS_UNTIL:
            self._learn_gain(view)
        looked = bisect.bisect(_DECIDED_AT, fraction), bisect.bisect(_FALLOFF_AT, fraction)
        if looked[0] > self._looked[0]:
            self._gains_used = self._gains_used or self.spread() > DIFFER
        if looked[1] > self._looked[1]:
            self._find_falloffs()
        self._looked = looked

    def spread(self) -> float:
        """Standard deviation of log-gains that two visits and all quarters of a picture show.

        Of brightness or of white balance, whichever differs more; 0 where it may be chance.
        """
        twice = np.flatnonzero(self._known & (self._before[:, 1] > 0).any(axis=(1, 2)))
        if len(twice) < _FEWEST_TWICE:
            return 0.0
        visits = [
            sums[twice].reshape(-1, 2, _RINGS, _QUADRANTS, 3) for sums in (self._before, self._sums)
        ]
        if abs(np.log(visits[1][:, 0].sum() / visits[1][:, 1].sum())) > _UNSETTLED:
            return 0.0
        (before, _), (now, errors) = (_gains_of(visit) for visit in visits)
        found = [0.0]
        for part in (_brightness, _balance):
            a, b = (part(gains) - part(gains).mean(axis=0) for gains in (before, now))
            both = np.mean(np.sum(a * b, axis=1))
            alone = np.sqrt(np.mean(np.sum(a**2, axis=1)) * np.mean(np.sum(b**2, axis=1)))
            chance = np.arctanh(min(both / alone, 1 - 1e-12)) * np.sqrt(len(twice) - 3)
            noise = np.mean(np.sum(part(errors) ** 2, axis=(1, 2)))
            if chance > _CHANCE and both > _DISAGREE**2 * noise:
                found.append(float(np.sqrt(both - noise)))
        return max(found)

    def light(self) -> Light | None:
        """What all views were taken in; views that were not trained on as their neighbours."""
        if not self._gains_used and not any(self._falloffs):
            return None
        known = np.flatnonzero(self._known)
        logs = np.zeros_like(self._log_gains)
        if self._gains_used:
            logs = self._log_gains - self._log_gains[known].mean(axis=0)
        logs = interpolated_gains(logs, known.tolist(), self._names, self._camera_of)
        return Light(np.exp(logs), tuple(self._falloffs))

    def _learn_gain(self, view: int) -> None:
        """Halfway from what was known to what the last image says."""
        sums = self._sums[view]
        if self._falloffs[self._camera_of[view]] is not None:
            sums = sums * self._light_of_parts(self._camera_of[view])
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

    def _inverse_gain(self, view: int) -> list[float]:
        """What a view's photograph is multiplied by, one a channel; 1 if gains are unused."""
        if not self._gains_used:
            return [1.0, 1.0, 1.0]
        gains = self._log_gains[view].tolist()
        count = max(1, self._num_known)
        return [math.exp(total / count - g) for total, g in zip(self._total, gains, strict=True)]

    def _light_of_parts(self, camera: int) -> np.ndarray:
        """(2, rings x quadrants, 3) what sums of T C and C^2 are multiplied by."""
        falloff = self._falloffs[camera]
        assert falloff is not None
        if camera not in self._lights:
            light = 1.0 + self._basis(camera)[1] @ falloff.coefficients.T
            light = np.repeat(light, _QUADRANTS, axis=0)
            self._lights[camera] = np.stack([light, light**2])
        return self._lights[camera]

    def _basis(self, camera: int) -> tuple[float, np.ndarray]:
        """Widest angle and `_mean_basis` of a camera, computed when they are first asked for."""
        if camera not in self._bases:
            angles = field_angles(self._scene.cameras[camera])
            self._bases[camera] = _widest(angles), _mean_basis(angles)
        return self._bases[camera]

    def _find_falloffs(self) -> None:
        """Least squares over the rings of all photographs of a camera, gains held."""
        for camera in range(len(self._scene.cameras)):
            angle, basis = self._basis(camera)
            views = [v for v in np.flatnonzero(self._known) if self._camera_of[v] == camera]
            rings = self._sums[views].reshape(-1, 2, _RINGS, _QUADRANTS, 3).sum(axis=3)
            gains = np.exp(self._log_gains[views])[:, None]
            tc, cc = gains * rings[:, 0], gains**2 * rings[:, 1]  # (views, rings, 3)
            if not (cc.sum(axis=(0, 1)) > 0).all():
                continue
            found = _fit_falloff(angle, basis, tc.sum(axis=0), cc.sum(axis=0))
            values = found.at(np.linspace(0.0, angle, _CHECKED))
            believed = values.min() > _DARKEST and values.max() < _BRIGHTEST
            self._take_falloff(camera, found if believed and _differs(tc, cc) else None)

    def _take_falloff(self, camera: int, found: Falloff | None) -> None:
        """Uses this one from now on, unless it is as good as the one before."""
        before = self._falloffs[camera]
        if found is not None and before is not None:
            angles = np.linspace(0.0, found.max_angle, _CHECKED)
            if np.abs(found.at(angles) / before.at(angles) - 1.0).max() < _MOVED:
                return
        self._falloffs[camera] = found
        self._lights.pop(camera, None)
        self._planes = {key: plane for key, plane in self._planes.items() if key[0] != camera}

    def state_dict(self) -> dict[str, Any]:
        """Everything that later steps depend on."""
        return {name: copy.copy(getattr(self, name)) for name in _STATE} | {
            "falloffs": [None if each is None else each.as_dict() for each in self._falloffs]
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on exactly where `state_dict` was taken."""
        for name in _STATE:
            setattr(self, name, copy.copy(state[name]))
        self._falloffs = [Falloff.from_dict(each) for each in state["falloffs"]]
        self._lights, self._planes = {}, {}


_STATE = (
    "_mode", "_gains_used", "_log_gains", "_known", "_total", "_num_known", "_sums", "_before",
    "_looked",
)  # fmt: skip


def _gains_of(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log-gains (V, 3) of sums (V, 2, rings, quadrants, 3), and errors (V, quadrants, 3) of these.

    What all photographs' rings have in common, a falloff, is no gain. The squares of a view's
    errors add up to the variance of its gain, by how far its quarters disagree.
    """
    tc, cc = sums[:, 0], sums[:, 1]
    common = tc.sum(axis=(0, 2)) / np.maximum(cc.sum(axis=(0, 2)), np.finfo(float).tiny)
    tc = (tc / np.maximum(common, np.finfo(float).tiny)[:, None]).sum(axis=1)
    cc = cc.sum(axis=1)  # (V, quadrants, 3)
    share = cc / np.maximum(cc.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    gain = tc.sum(axis=1) / np.maximum(cc.sum(axis=1), np.finfo(float).tiny)
    apart = np.where(cc > 0, tc / np.where(cc > 0, cc, 1.0), 0.0) / gain[:, None] - 1.0
    apart -= np.mean(apart, axis=0)  # what the quarters of all have in common is no disagreement
    return np.log(gain), share * apart * np.sqrt(_QUADRANTS / (_QUADRANTS - 1))


def _brightness(logs: np.ndarray) -> np.ndarray:
    """(..., 1) of log-gains (..., 3)."""
    return logs.mean(axis=-1, keepdims=True)


def _balance(logs: np.ndarray) -> np.ndarray:
    """(..., 3) of log-gains (..., 3)."""
    return logs - _brightness(logs)


def _parts(camera: _core.Camera) -> np.ndarray:
    """(H, W) uint8 part of a photograph each pixel lies in: ring x quadrants + quadrant."""
    lower = np.arange(camera.height)[:, None] >= camera.height / 2
    right = np.arange(camera.width)[None] >= camera.width / 2
    angles = field_angles(camera)
    return (_rings(angles, _widest(angles)) * _QUADRANTS + 2 * lower + right).astype(np.uint8)


def _widest(angles: np.ndarray) -> float:
    """The largest of field angles (...) in radians; above zero even of a single pixel."""
    return float(np.nanmax(angles, initial=np.finfo(float).tiny))


def _rings(angles: np.ndarray, widest: float) -> np.ndarray:
    """The ring of each field angle (...) of a camera that sees so wide; of NaN the last one."""
    return np.minimum(_RINGS * np.nan_to_num(angles, nan=widest) / widest, _RINGS - 1).astype(int)


def _mean_basis(angles: np.ndarray) -> np.ndarray:
    """(rings, ORDERS) means of the falloff's even powers over the pixels of each ring."""
    few = max(1, min(angles.shape) // _BASIS_ROWS)
    widest, some = _widest(angles), angles[::few, ::few]
    known = some[~np.isnan(some)]
    ring, basis = _rings(known, widest), falloff_basis(known / widest)
    counts = np.maximum(1, np.bincount(ring, minlength=_RINGS))
    sums = [np.bincount(ring, column, minlength=_RINGS) for column in basis.T]
    return np.stack(sums, axis=1) / counts[:, None]


def _fit_falloff(angle: float, basis: np.ndarray, tc: np.ndarray, cc: np.ndarray) -> Falloff:
    """The falloff of mean `basis` that fits sums of T C and C^2 of rings (rings, 3) best."""
    basis = np.concatenate([np.ones((_RINGS, 1)), basis], axis=1)
    coefficients = np.zeros((3, basis.shape[1]))
    for channel in range(3):
        of_all = cc[:, channel].sum()
        mean = tc[:, channel].sum() / of_all
        # Rings that show nothing stay at the mean.
        weight = cc[:, channel] / of_all + _PRIOR
        right = basis.T @ (tc[:, channel] / of_all + _PRIOR * mean)
        normal = basis.T @ (weight[:, None] * basis)  # singular where all is on the axis
        coefficients[channel] = np.linalg.lstsq(normal, right, rcond=None)[0]
    return Falloff(angle, coefficients[:, 1:] / coefficients[:, :1])


def _differs(tc: np.ndarray, cc: np.ndarray) -> bool:
    """Whether rings differ from each other by more than photographs (views, rings, 3) disagree."""
    tc, cc = tc.sum(axis=2), cc.sum(axis=2)
    of_ring = np.maximum(cc.sum(axis=0), np.finfo(float).tiny)
    level = tc.sum(axis=0) / of_ring
    errors = np.sqrt(np.sum((tc - level * cc) ** 2, axis=0)) / of_ring
    mean = tc.sum() / cc.sum()
    seen = of_ring > _FEWEST_SHOWN * of_ring.sum()
    apart = np.abs(level / mean - 1.0)
    return bool((seen & (apart > np.maximum(_FALLOFF_DIFFERS, _DISAGREE * errors / mean))).any())
