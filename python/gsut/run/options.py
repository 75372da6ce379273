"""Training options: every value with its unit, default, allowed range and the reason for it.

`TrainOptions` is the only list of options: the command line's flags, `options.json` and the
settings table of the report are all made from its fields. The defaults are the two recipes
measured for CPU budgets (short: up to 1000 steps; medium: 2000 and more); values that depend on
the number of steps are None until `TrainOptions.resolved()` fills them in.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any, ClassVar

from gsut._core import InputError
from gsut.run.option_fields import (
    check_options,
    choices_in,
    describe_options,
    option,
    words_of,
)
from gsut.run.recipe import PRESETS, preset_values, recipe

# --max-gaussians auto: see gsut.training.first.complexity.
AUTO = "auto"
# What `gsut train --help` lists; the rest is for `--help all`.
COMMON_OPTIONS = (
    "preset", "steps", "seed", "threads", "scale", "max_side", "test_every", "shutter",
    "refine_poses", "refine_lens", "max_gaussians", "sh_degree", "surface",
)  # fmt: skip


@describe_options
@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """All settings of one training run; immutable, checked when made.

    `steps`, `max_gaussians` and `sh_degree` take the preset's value where they are not given. The
    fields whose default depends on the number of steps are None (`coarse_to_fine`: "auto") until
    `resolved()`; their types are the ones they have from then on.

    Raises:
        InputError: a value of the wrong kind or out of range (names option, value and range), or
            options that contradict each other.
    """

    _open: ClassVar[set[str]] = set()  # of each object: what the preset has given; see fitted.py

    # A table: a few lines an option, not one an argument.
    # fmt: off
    preset: str | None = option(
        None, "Run", "sets --steps, --max-gaussians and --sh-degree where these are not given; "
        "fast takes 15 s, balanced 1 to 2 minutes, best 10 to 15 (60 images of 480 x 480, 2 cores)",
        choices=tuple(PRESETS), none="balanced",
    )
    steps: int = option(
        None, "Run", "training steps, one image each", low=1, high=10_000_000,
        none="fast 500, balanced 2000, best 7000; for fewer than 25 training views a 25th of that "
        "for each, at least 500",
    )
    seed: int = option(0, "Run", "seed of every random number", low=0, high=2**63 - 1)
    threads: int = option(
        0, "Run", "threads; 0 = all processors; the result's bits do not depend on it",
        low=0, high=4096,
    )
    eval_every: int = option(
        None, "Run", "steps between measurements of the held-out PSNR; 0 = at the end only",
        unit="steps", low=0, none="steps / 10, at least 100",
    )
    checkpoint_every: int = option(
        250, "Run", "steps between checkpoints; 0 = at the end only",
        unit="steps", low=0, reason="at most a minute of work is lost: after one a "
        "checkpoint is written in any case",
    )

    scale: float = option(
        1.0, "Data", "size of the images used, of the originals' (area filter)",
        low=0.0, high=1.0, low_open=True,
    )
    max_side: int = option(
        1600, "Data", "longer side of the images used, at most, where --scale is 1: larger "
        "photographs are decoded and kept smaller; 0 = as large as they are", unit="pixels", low=0,
        reason="the field's habit",
    )
    test_every: int = option(
        8, "Data", "every N-th image by name is held out where the dataset has no split of its "
        "own; 0 = none", low=0, reason="the split of published results",
    )
    test_names: tuple[str, ...] | None = option(
        None, "Data", "names of the held-out images, instead of --test-every",
        none="the data's own split",
    )

    shutter: str = option(
        "auto", "Data", "rolling: each line of an image has its own pose; global: one pose an "
        "image; auto: as the data says", choices=("auto", "global", "rolling"),
    )
    readout_time: float | None = option(
        None, "Data", "time from the first line of an image to its last, for a video with one pose "
        "a frame; the velocity is found from neighbouring frames", unit="x time between frames",
        low=0.0, high=1.0, low_open=True, none="the data's start and end poses",
    )
    readout_direction: str = option(
        "top_to_bottom", "Data", "order in which --readout-time reads the lines",
        choices=("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"),
    )

    refine_poses: bool = option(
        False, "Refinement", "the poses of the training views are refined: first from tracks of "
        "features, then against the Gaussians; test views are aligned before they are judged",
    )
    refine_lens: bool = option(
        False, "Refinement", "the lens is refined along with the poses; includes --refine-poses")
    refine_tracks: bool = option(
        True, "Refinement", "refinement begins with bundle adjustment of tracks of features; off: "
        "against the Gaussians alone", reason="colours alone leave 0.08 degrees where tracks leave "
        "0.03 (sponza_fisheye, poses 2 degrees off, 1000 steps)",
    )

    max_gaussians: int = option(
        AUTO, "Gaussians", "most Gaussians; auto: fast 50000, balanced 200000, best 300000, or "
        "fewer where photographs are few: 5000 a training view, and one for 4 of their pixels",
        low=1, high=100_000_000, words=(AUTO,),
    )
    sh_degree: int = option(
        None, "Gaussians", "degree of the spherical harmonics of colour", low=0, high=3,
        none="3 where the points' colours depend on the direction that they are seen from; else "
        "fast and balanced 1, best 2",
    )
    primitive: str = option(
        "gaussian", "Gaussians", "surfel: flat discs without a third scale, as in 2DGS; the file "
        "is 2DGS's, too", choices=("gaussian", "surfel"),
    )
    init: str = option(
        "auto", "Gaussians", "first Gaussians: the data's points; random ones inside the cameras' "
        "view; or points, with more from a plane sweep over the photographs where they are few",
        choices=("auto", "points", "random"),
        reason="a sweep in place of random ones: +2.0 dB on sponza_fisheye, +3.2 on the demo's "
        "hall, +8.3 on fox (500 steps)",
    )
    init_count: int | None = option(
        None, "Gaussians", "number of first Gaussians", low=1, high=100_000_000,
        none="all points, and a far sky where photographs show one that has none; where there are "
        "fewer than 2500, up to 20000 less eight times as many from a plane sweep; 30000 if random",
    )
    init_scale: float = option(
        0.7, "Gaussians", "first standard deviation along the points' surface, at least a fifth of "
        "it across", unit="x mean distance of 3 neighbours", low=0.0, high=100.0, low_open=True,
        reason="round ones of 0.5 cost 0.2 dB",
    )
    init_opacity: float = option(
        0.5, "Gaussians", "first opacity", low=0.0, high=1.0, low_open=True, high_open=True,
        reason="0.2 costs 0.25 dB",
    )
    background: tuple[float, float, float] | None = option(
        None, "Gaussians", "colour behind all Gaussians, red,green,blue", low=0.0, high=1.0,
        none="the colour that most of the photographs' edges have; without one, another at random "
        "in each step, so that all that is seen gets covered, and in renders a soft colour from "
        "what is around", reason="black leaves what is dark open, which then shows what is behind "
        "it: random +0.7 dB on fox, +1.0 on helmet",
    )
    low_pass: float = option(
        0.0, "Gaussians", "3D low-pass filter: standard deviation, in pixels of the camera that "
        "sees a Gaussian best; 0 = none", unit="pixels", low=0.0, high=100.0,
        reason="0.3 is a pixel's own; against aliasing of Gaussians below a pixel",
    )

    lr_means: float = option(
        None, "Learning rates", "centres", unit="x scene extent", low=0.0, high=1.0,
        none="1.3 / steps up to 500 steps, 0.8 / steps from 1000, within 4.8e-4 .. 3.2e-3",
        reason="+0.3 dB over the published 1.6e-4",
    )
    lr_means_final_factor: float = option(
        0.01, "Learning rates", "centres: last rate / first rate", low=0.0, high=1.0,
        low_open=True, reason="published; 0.05 costs 1.4 dB at 2000 steps",
    )
    lr_scales: float = option(
        None, "Learning rates", "logarithms of scales", low=0.0, high=1.0,
        none="2e-2 up to 500 steps, 1.5e-2 from 1000", reason="3 x published",
    )
    lr_quats: float = option(
        4e-3, "Learning rates", "rotations", low=0.0, high=1.0, reason="4 x published")
    lr_opacity: float = option(
        0.1, "Learning rates", "opacity logits", low=0.0, high=1.0, reason="+0.2 dB over 5e-2")
    lr_sh0: float = option(
        7e-3, "Learning rates", "base colour", low=0.0, high=1.0, reason="3 x published")
    lr_sh_rest: float = option(
        None, "Learning rates", "harmonics above degree 0", low=0.0, high=1.0,
        none="1 / steps within 1.25e-4 .. 1e-3",
        reason="1000 steps: 0.4 dB on fox, 0.13 on sponza_fisheye over the published 1.25e-4",
    )
    lr_final_factor: float = option(
        None, "Learning rates", "all but the centres: last rate / first rate",
        low=0.0, high=1.0, low_open=True, none="1 to 1000 steps, 0.5 at 2000, 0.3 from 7000",
    )
    sparse_adam: bool = option(
        True, "Learning rates", "update only Gaussians that the step's image saw",
        reason="10 % faster for 0.15 dB",
    )
    average_from: float = option(
        0.9, "Learning rates", "the result is the mean of the Gaussians over the steps after this "
        "fraction of them; 1 = the last step's", unit="fraction of steps", low=0.0, high=1.0,
        reason="+0.7 dB where exposure drifts, 0.1 dB where it does not",
    )

    ssim_weight: float = option(
        0.2, "Loss", "loss = (1 - w) L1 + w (1 - SSIM)", low=0.0, high=1.0,
        reason="published; 0 costs 0.66 dB PSNR",
    )
    exposure: str = option(
        "auto", "Loss", "exposure and white balance of each photograph are found and taken out: "
        "on, off, or auto: where photographs differ", choices=("auto", "on", "off"))
    surface: bool = option(
        False, "Loss", "Gaussians become flat and agree on one surface: for depth, normals and "
        "gsut mesh")
    known_depth: str = option(
        "auto", "Loss", "distances that --surface takes from the data: points, files (along the "
        "ray; 16-bit pictures in millimetres, .npy in the data's units), off, or auto: files where "
        "training views have them, else points", choices=("auto", "points", "files", "off"))
    robust: bool = option(
        False, "Loss", "areas of a photograph that differ from all others, such as passers-by, are "
        "left out of the loss", reason="+0.5 dB on the demo's hall with two in every photograph, "
        "-0.03 dB without any")
    drop_blurred: bool = option(
        False, "Loss", "photographs far less sharp than their neighbours in time are left out",
        reason="+1.4 dB on the demo's hall with a quarter of the photographs blurred")
    motion_blur: float | None = option(
        None, "Loss", "photographs are blurred by the camera's motion: time that each is exposed; "
        "it is compared with the mean of up to three poses within, at the velocity between its "
        "neighbours", unit="x time between frames", low=0.0, high=1.0, low_open=True, none="sharp",
        reason="+1.6 dB on the demo's hall, blurred by 6 pixels, in twice the time")
    opacity_regularizer: float = option(
        0.01, "Loss", "weight of the mean opacity", low=0.0, high=100.0, reason="published (MCMC)")
    scale_regularizer: float = option(
        0.01, "Loss", "weight of the mean scale", low=0.0, high=100.0, reason="published (MCMC)")
    coarse_to_fine: tuple[float, float] = option(
        "auto", "Loss", "train at 1/4 of the resolution until the first, at 1/2 until the second "
        "fraction of the steps; 0,0 = full resolution throughout", low=0.0, high=1.0,
        words=("auto",), reason="a third of the time less for 0.2 dB")
    calibration_weights: str | None = option(
        None, "Loss", "lens file of `gsut calibrate`: residuals count less where that lens is "
        "uncertain", none="all pixels count the same")
    sh_every: int = option(
        None, "Loss", "steps between degrees of harmonics", unit="steps", low=1,
        none="0.6 steps / (degree + 1), at most 1000")

    strategy: str = option(
        "mcmc", "Densification", "mcmc: relocation, with a cap; adaptive: clone, split and prune "
        "by gradient; mini: Mini-Splatting's, which overgrows and samples (0.2 and 1.5 dB "
        "below mcmc on sponza_fisheye and fox, in twice the time)",
        choices=choices_in("training/strategies", "mcmc"),
    )
    densify_from: float = option(
        0.05, "Densification", "first densification", unit="fraction of steps", low=0.0, high=1.0)
    densify_until: float = option(
        0.8, "Densification", "last densification", unit="fraction of steps", low=0.0, high=1.0)
    grow_until: float = option(
        None, "Densification", "--max-gaussians is reached here, by geometric growth",
        unit="fraction of steps", low=0.0, high=1.0, none="0.5",
        reason="60 % of the densification; 30 % of it costs 0.46 dB",
    )
    densify_every: int = option(
        None, "Densification", "steps between densifications", unit="steps", low=1,
        none="50 to 1000 steps, 100 from 2000",
    )
    dead_opacity: float = option(
        0.005, "Densification", "Gaussians at or below this opacity are relocated or pruned",
        low=0.0, high=1.0, high_open=True, reason="published",
    )
    noise: bool = option(
        None, "Densification", "MCMC noise on the centres", none="from 1500 steps on")

    compact_at: int | None = option(
        None, "Compaction", "step at which the Gaussians are compacted (see gsut compact); their "
        "number then stays", unit="steps", low=1, none="never",
    )
    keep: float = option(
        0.2, "Compaction", "fraction that --compact-at keeps", low=0.0, high=1.0, low_open=True)
    compact_method: str = option(
        "ghap", "Compaction", "method of --compact-at",
        choices=choices_in("compact/methods", "ghap"),
    )
    # fmt: on

    def __post_init__(self) -> None:
        check_options(self)
        preset = preset_values(self.preset)
        object.__setattr__(self, "_open", {name for name in preset if getattr(self, name) is None})
        for name in self._open:
            object.__setattr__(self, name, preset[name])
        if self.densify_from > self.densify_until:
            raise InputError(
                f"--densify-from {self.densify_from} lies after --densify-until "
                f"{self.densify_until}; both are fractions of the steps"
            )
        fractions = self.coarse_to_fine
        if isinstance(fractions, tuple) and fractions[0] > fractions[1]:
            raise InputError(
                f"--coarse-to-fine {fractions[0]:g},{fractions[1]:g}: the quarter resolution "
                "must end before the half resolution does"
            )
        if self.primitive == "surfel" and self.low_pass:
            raise InputError(
                f"--low-pass {self.low_pass:g} makes Gaussians thicker, and surfels have no "
                "thickness; leave one of the two out"
            )
        if self.refine_lens:
            object.__setattr__(self, "refine_poses", True)
        if self.compact_at is not None and self.compact_at >= self.steps:
            raise InputError(
                f"--compact-at {self.compact_at} is not before the end of {self.steps} --steps"
            )
        most = self.most_gaussians
        if self.strategy == "mcmc" and (self.init_count or 0) > most:
            raise InputError(f"--init-count {self.init_count} is more than --max-gaussians {most}")

    @property
    def most_gaussians(self) -> int:
        """`max_gaussians`, or where that is "auto" the most that it may come to."""
        auto = self.max_gaussians == AUTO
        return preset_values(self.preset)["max_gaussians"] if auto else self.max_gaussians

    def resolved(self) -> TrainOptions:
        """The same options with every value that depends on the number of steps filled in.

        Returns:
            TrainOptions in which only `preset`, `test_names`, `readout_time`, `init_count`,
            `background` (all but the first depend on the data) and `compact_at` (never) may be
            None. Values that were given are kept; resolving twice changes nothing.
        """
        changes = {
            name: value
            for name, value in recipe(self.steps, self.sh_degree).items()
            if getattr(self, name) in (None, AUTO)
        }
        return dataclasses.replace(self, **changes)

    def words(self, *but: str) -> list[str]:
        """Words of the command line that make these options, without what follows from others or
        from the scene; nothing of the fields `but`."""
        basis = {name: getattr(self, name) for name in ("preset", "steps", "sh_degree")}
        start = preset_values(self.preset)
        unsaid = {"preset": None, "steps": start["steps"], "sh_degree": start["sh_degree"]}
        default = TrainOptions(**basis)
        if self == self.resolved():  # nobody knows any more what was given
            default = default.resolved()
        return words_of(self, dataclasses.replace(default, **unsaid), (*but, *self._open))

    def to_json(self) -> str:
        """The options as a JSON object, one key a field; `from_json` gives the same object."""
        return json.dumps(dataclasses.asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str, source: str = "options") -> TrainOptions:
        """Options from the text of `to_json`; keys that are absent take their defaults.

        Args:
            text: a JSON object.
            source: name of the file, for messages.

        Raises:
            InputError: not a JSON object, an unknown key (lists the known ones), or a bad value.
        """
        try:
            values = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"{source}: not valid JSON ({error})") from None
        if not isinstance(values, dict):
            raise InputError(f"{source}: a JSON object of options is needed, found {text[:40]!r}")
        known = [field.name for field in dataclasses.fields(cls)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise InputError(
                f"{source}: unknown option {', '.join(unknown)}; known are {', '.join(known)}"
            )
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in values.items()
        }
        try:
            return cls(**given)
        except InputError as error:
            raise InputError(f"{source}: {error}") from None
