"""How many Gaussians and steps: no more than the photographs of a scene can tell apart.

Where photographs are few, further Gaussians only learn them by heart. Two counts bound the number,
that of the training views and that of their pixels, both known before the first step. Short
trainings that predict views set aside chose no better and took longer (docs/results.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

from gsut.data import Scene
from gsut.run import AUTO, TrainOptions, for_degree, is_open, of_preset
from gsut.training.view_dependence import unforeseen_share

# Gaussians a training view, and pixels of all training views a Gaussian, at the most. Of twelve to
# fifteen real photographs 50,000 to 100,000 predict others best, 200,000 less well by 0.5 dB.
_PER_VIEW = 5000
_PIXELS_EACH = 4
# Harmonics are of the highest degree where less than this of the variance of points' colours stays
# unforeseen by the direction of view: 0.2 to 0.6 on photographs of four captures, which gain by it,
# 0.8 to 1.1 on made scenes, which lose.
_FORETOLD, _HIGHEST = 0.7, 3


@dataclasses.dataclass(frozen=True)
class Complexity:
    """The number of Gaussians of a run and what it rests on.

    Attributes:
        max_gaussians: the most that training may grow to.
        sh_degree: of their harmonics.
        views: that are trained on.
        because: what the number is, in words; "" where the options give it.
        fewer: less than the preset's.
        steps: of the training.
        fewer_steps: by how many these are less than the preset's.
        higher_degree: by how many degrees the harmonics have more than the preset's.
    """

    max_gaussians: int
    sh_degree: int
    views: int
    because: str = ""
    fewer: bool = False
    steps: int = 0
    fewer_steps: int = 0
    higher_degree: int = 0

    def __str__(self) -> str:
        return (
            f"{self.views} photographs: at most {self.max_gaussians:,} Gaussians of degree "
            f"{self.sh_degree}, {self.because}"
        )

    def about_preset(self) -> Iterator[str]:
        """Where steps and harmonics are not the preset's, and why."""
        if self.fewer_steps:
            preset = self.steps + self.fewer_steps
            yield (
                f"{self.views} photographs: {self.steps} steps, for which the preset has {preset}; "
                "more would not show other views better (--steps)"
            )
        if self.higher_degree:
            yield (
                f"colours depend on the direction that they are seen from: harmonics of degree "
                f"{self.sh_degree} (--sh-degree)"
            )

    def tell(self, metrics: dict[str, Any]) -> None:
        """Adds itself to the content of metrics.json, and a note where photographs are few."""
        metrics["complexity"] = dataclasses.asdict(self)
        if self.fewer:
            metrics["notes"].append(str(self))
        metrics["notes"] += self.about_preset()


def choose_complexity(
    scene: Scene, options: TrainOptions, say: Callable[[str], None] = lambda text: None
) -> Complexity:
    """The number of Gaussians for a run, where its options leave it open.

    Args:
        scene: as it is trained on.
        options: of this scene; `max_gaussians` other than "auto" stays.
        say: told in a line what is chosen and why.

    Returns:
        The preset's number, or a smaller one where training views, or their pixels, are few.
    """
    most, views = options.most_gaussians, len(scene.train_indices)
    chosen = Complexity(
        most, options.sh_degree, views, steps=options.steps,
        fewer_steps=-_over_preset(options, "steps"),
        higher_degree=_over_preset(options, "sh_degree"),
    )  # fmt: skip
    if options.max_gaussians == AUTO:
        chosen = _bounded(scene, chosen)
        say(str(chosen))
    for line in chosen.about_preset():
        say(line)
    return chosen


def choose_degree(scene: Scene, options: TrainOptions) -> TrainOptions:
    """The options with the degree of harmonics that the photographs bear, where it is open.

    Args:
        scene: as it is trained on.
        options: not resolved.
    """
    if not is_open(options, "sh_degree"):
        return options
    share = unforeseen_share(scene)
    return for_degree(options, _HIGHEST) if share is not None and share < _FORETOLD else options


def _over_preset(options: TrainOptions, name: str) -> int:
    """What has been added to the preset's value; 0 where the user has given one."""
    return getattr(options, name) - of_preset(options, name) if is_open(options, name) else 0


def _bounded(scene: Scene, given: Complexity) -> Complexity:
    most, views = given.max_gaussians, given.views
    by_views, by_pixels = _PER_VIEW * views, _pixels(scene, _PIXELS_EACH * most) // _PIXELS_EACH
    number = max(1, min(most, by_views, by_pixels))
    because = "the preset's number"
    if number < most:
        rule = f"{_PER_VIEW:,} each" if number == by_views else f"one for {_PIXELS_EACH} pixels"
        because = f"{rule}: more would learn so few by heart"
    return dataclasses.replace(given, max_gaussians=number, because=because, fewer=number < most)


def with_most(options: TrainOptions, most: int) -> TrainOptions:
    """The options of a run of at most so many Gaussians."""
    first = min(options.init_count, most) if options.init_count else None
    return dataclasses.replace(options, max_gaussians=most, init_count=first)


def _pixels(scene: Scene, enough: int) -> int:
    """Pixels of the training views that can be compared; counted until there are enough."""
    count = 0
    for index in scene.train_indices:
        count += int(scene.mask(index).sum())
        if count >= enough:
            break
    return count
