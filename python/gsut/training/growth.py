"""How many Gaussians training may grow to: a given number, or as many as held-out views reward."""

from __future__ import annotations

import math
from typing import Any

from gsut.data import Scene
from gsut.run import AUTO, TrainOptions

# Auto: at most one Gaussian for so many valid training pixels; growth ends there in any case.
_PIXELS_EACH = 20
_LEAST = 1000
# Auto: training views that are set aside while the scene grows, one of so many, and the most.
_ASIDE_EVERY, _ASIDE_MOST = 12, 4
# Auto: growth ends when the last so many measurements rose by less than so many dB in all.
_PATIENCE, _LEAST_GAIN_DB = 3, 0.05


class GrowthLimit:
    """The cap of a run and, with --max-gaussians auto, when to stop before it.

    Growth stops when the PSNR on training views that were set aside no longer rises; from then on
    these views are trained on, too. The test views play no part. Only the full resolution decides:
    a coarse one is soon satisfied, and what it does not miss may be missed later. So with auto the
    cap is reached later (`grow_until`) than without.

    Args:
        scene: at the resolution to train at.
        options: resolved.

    Attributes:
        most: the cap.
        auto: whether growth may stop before it.
        ended: growth has stopped.
    """

    def __init__(self, scene: Scene, options: TrainOptions) -> None:
        given: Any = options.max_gaussians
        self.auto = given == AUTO
        self.ended = not self.auto
        self.most = int(_most_for(scene) if self.auto else given)
        views = list(scene.train_indices)
        aside = views[_ASIDE_EVERY // 2 :: _ASIDE_EVERY][:_ASIDE_MOST] if self.auto else []
        self._aside = aside or (views[:1] if self.auto else [])
        if len(self._aside) == len(views):  # a single view: nothing can be set aside
            self.ended, self._aside = True, []
        self._found: list[float] = []
        self._last_step = _last_growth(options)
        self.end_where_reached(0)

    @property
    def held_aside(self) -> list[int]:
        """Views that are measured on and must not be trained on now."""
        return [] if self.ended else self._aside

    def observe(self, psnr: float) -> None:
        """Takes note of the PSNR on `held_aside` in dB; ends growth if it has stopped to rise."""
        self._found.append(psnr)
        if len(self._found) > _PATIENCE:
            before, last = self._found[:-_PATIENCE], self._found[-_PATIENCE:]
            self.ended = max(last) < max(before) + _LEAST_GAIN_DB

    def end_where_reached(self, step: int) -> None:
        """After each densification, with its step: ends growth where the cap is reached."""
        self.ended = self.ended or step >= self._last_step

    def state_dict(self) -> dict[str, Any]:
        """What later decisions depend on."""
        return {"ended": self.ended, "found": list(self._found)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on where `state_dict` was taken."""
        self.ended = bool(state["ended"])
        self._found = [float(value) for value in state["found"]]


def _last_growth(options: TrainOptions) -> int:
    """The step of the densification that reaches the cap, or is the last; 0 if there is none."""
    o, rounding = options, 1e-9
    last = math.floor(o.densify_until * o.steps + rounding) // o.densify_every * o.densify_every
    reaching = math.ceil(o.grow_until * o.steps / o.densify_every - rounding) * o.densify_every
    return 0 if last < o.densify_from * o.steps else min(reaching, last)


def _most_for(scene: Scene) -> int:
    pixels = sum(int(scene.mask(index).sum()) for index in scene.train_indices)
    return max(_LEAST, pixels // _PIXELS_EACH)
