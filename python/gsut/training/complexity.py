"""How many Gaussians: as many as predict photographs that were not trained on.

Short trainings ("pilots") at half the size, each with a third of the Gaussians of the one before,
leave a quarter of the training views aside and predict them. The number goes down as long as that
predicts them better: where photographs are few, or agree badly, further Gaussians only learn them
by heart. The training itself begins anew, with all training views. Test views play no part.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

from gsut.data import Scene
from gsut.evaluate import mean_psnr
from gsut.refine import TracksResult
from gsut.run import AUTO, COMPLEXITY, Progress, RunFolder, TrainOptions
from gsut.training.loop import TrainingLoop

# Shorter runs do not learn by heart, and pilots would cost more than their share.
_FEWEST_STEPS, _FEWEST_VIEWS = 1000, 4
_MOST_VIEWS = 30  # of more, no number that was tried was ever too large
# Pilots have few Gaussians on small images, but not few steps: after 150 of them on fox (12 views)
# 7407 Gaussians predict best, after 300 as many as in a whole run.
_STEPS = 300
_SCALE = 0.5  # of the images; the number of Gaussians falls with their pixels
# Views set aside: one of so many, and the most.
_ASIDE_EVERY, _ASIDE_MOST = 4, 8
_STEP_DOWN = 3  # from one number of Gaussians to the next
_LEAST = 6000  # Gaussians below which nothing is tried
# What fewer Gaussians must gain on the views set aside: they settle sooner, a pilot is short, and
# of two to four views chance alone makes 0.2 dB.
_LEAST_GAIN_DB = 0.3
# Options whose defaults depend on the number of steps: a pilot has its own.
_BY_STEPS = (
    "eval_every", "lr_means", "lr_final_factor", "sh_every", "densify_every", "noise", "grow_until",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Complexity:
    """The number of Gaussians of a run and what it rests on.

    Attributes:
        max_gaussians: the most that training may grow to.
        pilots: one dict a pilot: max_gaussians (the run's that it stands for), psnr (dB, on the
            views set aside); none where nothing was tried.
        aside: names of the views that the pilots were judged on.
    """

    max_gaussians: int
    pilots: tuple[dict[str, float], ...] = ()
    aside: tuple[str, ...] = ()

    def tell(self, metrics: dict[str, Any]) -> None:
        """Adds what was tried to the content of metrics.json, and a note that says so."""
        metrics["complexity"] = self.as_dict()
        if not self.pilots:
            return
        tried = ", ".join(f"{row['max_gaussians']:,}: {row['psnr']:.2f} dB" for row in self.pilots)
        metrics["notes"].append(
            f"at most {self.max_gaussians:,} Gaussians (--max-gaussians auto): short trainings "
            f"predicted {len(self.aside)} training views set aside with {tried}"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON; `from_dict` gives the same."""
        return {name: list(v) if isinstance(v, tuple) else v for name, v in vars(self).items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Complexity:
        """What `as_dict` was taken of."""
        return cls(int(values["max_gaussians"]), tuple(values["pilots"]), tuple(values["aside"]))


def choose_complexity(
    scene: Scene,
    options: TrainOptions,
    on_progress: Callable[[int, int, str], None] = lambda done, total, text: None,
) -> Complexity:
    """The number of Gaussians for a run, by pilots where the options leave it open.

    Args:
        scene: as it is trained on.
        options: resolved; `max_gaussians` other than "auto" stays.
        on_progress: called with steps done, steps of a pilot, and the state in words.

    Returns:
        At most `options.most_gaussians`; that number where a run is too short to try, its views
        are too few, or so many that no number is too large for them.
    """
    most = options.most_gaussians
    views = len(scene.train_indices)
    asked = options.max_gaussians == AUTO and options.steps >= _FEWEST_STEPS
    if not (asked and _FEWEST_VIEWS <= views <= _MOST_VIEWS):
        return Complexity(most)
    aside = views_aside(scene)
    small = scene.replace(
        train_indices=[i for i in scene.train_indices if i not in aside], test_indices=aside
    ).scaled(_SCALE, keep_larger=True)
    pilots: list[dict[str, float]] = []
    number, best = most, -math.inf
    while number >= _LEAST or not pilots:
        psnr = _predict(small, _pilot_options(options, round(_SCALE**2 * number)), on_progress)
        pilots.append({"max_gaussians": number, "psnr": psnr})
        if psnr < best + _LEAST_GAIN_DB and len(pilots) > 1:
            break
        best, chosen, number = psnr, number, round(number / _STEP_DOWN)
    names = tuple(scene.views[index].name for index in aside)
    return Complexity(chosen, tuple(pilots), names)


def complexity_of_run(
    scene: Scene,
    options: TrainOptions,
    tracks: TracksResult | None,
    run: RunFolder | None,
    progress: bool,
) -> Complexity:
    """`choose_complexity` once a run: one that is resumed reads what was chosen.

    Args:
        scene, options: see there.
        tracks: whose poses are better than the scene's, if any.
        run: the folder that keeps the choice; None: nothing is kept.
        progress: show a bar.
    """
    kept = None if run is None else run.read_json(COMPLEXITY)
    if kept is not None:
        return Complexity.from_dict(kept)
    with Progress(progress) as bar:

        def show(done: int, total: int, text: str) -> None:
            bar.show("try", done, total, text)

        chosen = choose_complexity(scene if tracks is None else tracks.scene, options, show)
    if run is not None and chosen.pilots:
        run.write_json(COMPLEXITY, chosen.as_dict())
    return chosen


def with_most(options: TrainOptions, most: int) -> TrainOptions:
    """The options of a run of at most so many Gaussians."""
    first = min(options.init_count, most) if options.init_count else None
    return dataclasses.replace(options, max_gaussians=most, init_count=first)


def views_aside(scene: Scene) -> list[int]:
    """Training views, spread evenly, that pilots are judged on."""
    views = scene.train_indices
    count = min(max(1, round(len(views) / _ASIDE_EVERY)), _ASIDE_MOST)
    return [views[int((place + 0.5) * len(views) / count)] for place in range(count)]


def _pilot_options(options: TrainOptions, most: int) -> TrainOptions:
    by_steps: dict[str, Any] = dict.fromkeys(_BY_STEPS) | {"coarse_to_fine": "auto"}
    return dataclasses.replace(
        with_most(options, most), steps=_STEPS, compact_at=None, refine_poses=False,
        refine_lens=False, **by_steps,
    ).resolved()  # fmt: skip


def _predict(
    scene: Scene, options: TrainOptions, on_progress: Callable[[int, int, str], None]
) -> float:
    """PSNR in dB of the test views after a training."""
    loop = TrainingLoop(scene, options)
    while loop.step < options.steps:
        loop.advance()
        on_progress(loop.step, options.steps, f"{options.max_gaussians:,} Gaussians")
    light = loop.photographs.light()
    return mean_psnr(
        scene, loop.result(), scene.test_indices, options.background, loop.renderer, light
    )
