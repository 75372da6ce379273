"""Chooses how many Gaussians the photographs of a scene support.

Where photographs are few, further Gaussians only memorize them: the number of training views, which
is known before the first step, bounds that of the Gaussians.
"""

from __future__ import annotations

from gsut.data import Scene
from gsut.run import TrainOptions
from gsut.run.options import AUTO, get_preset_value, is_from_preset

# Most Gaussians for each training view: held-out views of a dozen photographs are predicted best
# with 50,000 to 100,000 Gaussians, and worse with more.
_PER_VIEW = 5000


def choose_number(scene: Scene, options: TrainOptions) -> tuple[int, list[str]]:
    """Chooses the number of Gaussians of a run.

    Args:
        scene: as it is trained on.
        options: for this scene; `max_gaussians` other than "auto" stays.

    Returns:
        The preset's number, or a smaller one if training views are few; and sentences on number and
        steps where they are not the preset's.
    """
    most, views, notes = options.most_gaussians, len(scene.train_indices), list[str]()
    if options.max_gaussians == AUTO:
        number = min(most, _PER_VIEW * views)
        if number < most:
            notes.append(
                f"{views} photographs: at most {number:,} Gaussians of degree {options.sh_degree}, "
                f"{_PER_VIEW:,} each: more would only memorize them"
            )
        most = number
    preset = get_preset_value(options, "steps")
    if is_from_preset(options, "steps") and options.steps < preset:
        instead = f"{options.steps} steps, for which the preset has {preset}"
        outgrown = f", at most {most:,} Gaussians: {instead}; they outgrow this number for a while"
        notes.append(
            f"{views} photographs{outgrown}, which takes time (--steps)"
            if options.recipe.overgrowth > 1.0
            else f"{views} photographs: {instead}; more would not show other views better (--steps)"
        )
    return most, notes
