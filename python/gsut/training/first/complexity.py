"""Chooses how many Gaussians the photographs of a scene support.

Where photographs are few, further Gaussians only memorize them. Two counts bound the number: that
of the training views and that of their pixels, both known before the first step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

from gsut.data import Scene
from gsut.run import TrainOptions
from gsut.run.options import AUTO, get_preset_value, is_from_preset

# Most Gaussians for each training view: held-out views of a dozen photographs are predicted best
# with 50,000 to 100,000 Gaussians, and worse with more.
_PER_VIEW = 5000
# Fewest training pixels for each Gaussian: one has more parameters than fewer pixels have values.
_PIXELS_EACH = 4


@dataclasses.dataclass(frozen=True)
class Complexity:
    """The number of Gaussians of a run and the reasons for it.

    Attributes:
        max_gaussians: the most that training may grow to.
        sh_degree: of their harmonics.
        views: number of training views.
        because: why this number, in words; "" if the options give it.
        fewer: whether it is below the preset's.
        steps: of the training.
        fewer_steps: by how much this is below the preset's number of steps.
        outgrown: whether Gaussians outgrow the most for a while, which takes the time of steps.
        degree_because: how the degree was chosen, in words; "" if the options give it.
    """

    max_gaussians: int
    sh_degree: int
    views: int
    because: str = ""
    fewer: bool = False
    steps: int = 0
    fewer_steps: int = 0
    outgrown: bool = False
    degree_because: str = ""

    def __str__(self) -> str:
        return (
            f"{self.views} photographs: at most {self.max_gaussians:,} Gaussians of degree "
            f"{self.sh_degree}, {self.because}"
        )

    def explain_changes(self) -> Iterator[str]:
        """Yields a sentence for the steps and one for the harmonics where the preset has others."""
        if self.fewer_steps:
            preset = self.steps + self.fewer_steps
            instead = f"{self.steps} steps, for which the preset has {preset}"
            if self.outgrown:
                yield (
                    f"{self.views} photographs, at most {self.max_gaussians:,} Gaussians: {instead}"
                    "; they outgrow this number for a while, which takes time (--steps)"
                )
            else:
                yield (
                    f"{self.views} photographs: {instead}; more would not show other views better "
                    "(--steps)"
                )
        if self.degree_because:
            yield self.degree_because

    def add_to(self, metrics: dict[str, Any]) -> None:
        """Adds itself to the content of metrics.json, with notes on what the preset has not."""
        metrics["complexity"] = dataclasses.asdict(self)
        if self.fewer:
            metrics["notes"].append(str(self))
        metrics["notes"] += self.explain_changes()


def choose_complexity(
    scene: Scene,
    options: TrainOptions,
    report: Callable[[str], None] = lambda text: None,
    degree_because: str = "",
) -> Complexity:
    """Chooses the number of Gaussians of a run.

    Args:
        scene: as it is trained on.
        options: for this scene; `max_gaussians` other than "auto" stays.
        report: receives a line for each choice and its reason.
        degree_because: see `choose_degree`.

    Returns:
        The preset's number, or a smaller one if training views, or their pixels, are few.
    """
    most, views = options.most_gaussians, len(scene.train_indices)
    preset = get_preset_value(options, "steps")
    fewer_steps = preset - options.steps if is_from_preset(options, "steps") else 0
    chosen = Complexity(
        most, options.sh_degree, views, steps=options.steps, fewer_steps=fewer_steps,
        outgrown=options.recipe.overgrowth > 1.0, degree_because=degree_because,
    )  # fmt: skip
    if options.max_gaussians == AUTO:
        chosen = _bound_number(scene, chosen)
        report(str(chosen))
    for line in chosen.explain_changes():
        report(line)
    return chosen


def _bound_number(scene: Scene, given: Complexity) -> Complexity:
    """Limits the number of Gaussians by the training views and their pixels."""
    most, views = given.max_gaussians, given.views
    pixels = _count_pixels(scene, _PIXELS_EACH * most)
    by_views, by_pixels = _PER_VIEW * views, pixels // _PIXELS_EACH
    number = max(1, min(most, by_views, by_pixels))
    because = "the preset's number"
    if number < most:
        rule = f"{_PER_VIEW:,} each" if number == by_views else f"one for {_PIXELS_EACH} pixels"
        because = f"{rule}: more would only memorize them"
    return dataclasses.replace(given, max_gaussians=number, because=because, fewer=number < most)


def _count_pixels(scene: Scene, enough: int) -> int:
    """Counts the unmasked pixels of the training views, stopping at `enough`."""
    count = 0
    for index in scene.train_indices:
        count += int(scene.mask(index).sum())
        if count >= enough:
            break
    return count
