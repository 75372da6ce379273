"""Training options: every value with its unit, default, allowed range and the reason for it.

`TrainOptions` is the only list of options: the command line's flags, `options.json` and the
settings table of the report are all made from its fields. What follows from the number of steps is
in the recipe (see `make_recipe`).
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any, ClassVar

from gsut._core import InputError
from gsut.files import parse_json
from gsut.run.options.fields import (
    check_options,
    define_option,
    describe_options,
    list_choices,
    list_words,
)
from gsut.run.options.primitives import OTHER_PRIMITIVES, check_rule
from gsut.run.options.recipe import PRESETS, Recipe, get_preset, make_recipe

# --max-gaussians auto: see gsut.training.first.complexity.
AUTO = "auto"
# Directions of a rolling shutter other than from the top down.
READOUTS = ("bottom_to_top", "left_to_right", "right_to_left")


@describe_options
@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """All settings of one training run; immutable, checked when made.

    `steps`, `max_side` and `sh_degree` take the preset's value unless they are given. What else
    depends on them is the `recipe`.

    Raises:
        InputError: a value of the wrong kind or out of range (names option, value and range), or
            options that contradict each other.
    """

    FLAGS: ClassVar[tuple[str, ...]] = (
        *("preset", "steps", "seed", "threads", "scale", "max_side", "test_every", "test_names"),
        "keep_all_pixels",
        *("shutter", "readout_time", "refine_poses", "refine_lens", "max_gaussians", "sh_degree"),
        *("primitive", "order", "background", "exposure", "surface", "robust"),
    )
    _open: ClassVar[set[str]] = set()  # of each instance: what the preset gave; see presets.py

    # A table: a few lines an option, not one an argument.
    # fmt: off
    preset: str | None = define_option(
        None, "Run", "sets --steps, --max-gaussians, --max-side and --sh-degree unless given; fast "
        "takes 15 s, balanced 1 to 2 minutes, best 10 to 15 (60 images of 480 x 480, 2 cores)",
        choices=tuple(PRESETS), none="balanced",
    )
    steps: int = define_option(
        None, "Run", "training steps, one image each", low=1, high=10_000_000,
        none="fast 500, balanced 2000, best 7000; with fewer than 25 training views "
        "proportionally fewer, at least 500",
    )
    seed: int = define_option(0, "Run", "seed of every random number", low=0, high=2**63 - 1)
    threads: int = define_option(
        0, "Run", "threads; 0 = all processors; the result's bits do not depend on it",
        low=0, high=4096,
    )
    checkpoint_every: int = define_option(
        250, "Run", "steps between checkpoints; 0 = at the end only", unit="steps", low=0,
        reason="a checkpoint is also written every minute, so at most a minute of work is lost",
    )

    scale: float = define_option(
        1.0, "Data", "image scale factor (area filter)", low=0.0, high=1.0, low_open=True,
    )
    max_side: int = define_option(
        None, "Data", "longest side of the images if --scale is 1; larger photographs are "
        "decoded and kept smaller; 0 = full size", unit="pixels", low=0,
        none="fast 800; balanced and best 1600, what published results use",
    )
    test_every: int = define_option(
        8, "Data", "hold out every N-th image by name if the dataset has no split of its own; "
        "0 = none", low=0, reason="the split of published results",
    )
    test_names: tuple[str, ...] | None = define_option(
        None, "Data", "names of the held-out images, instead of --test-every",
        none="the dataset's own split",
    )

    keep_all_pixels: bool = define_option(
        False, "Data", "train on pixels that show the same in all images of a camera, such as the "
        "black around a lens' circle, bars and logos; otherwise they are left out",
    )
    shutter: str = define_option(
        "auto", "Data", "rolling: each line of an image has its own pose, read from the top down, "
        "or in another direction; global: one pose an image; auto: as the dataset says",
        choices=("auto", "global", "rolling", *READOUTS),
    )
    readout_time: float | None = define_option(
        None, "Data", "time from the first line of an image to its last, for a video with one pose "
        "a frame; the velocity is found from neighbouring frames", unit="x time between frames",
        low=0.0, high=1.0, low_open=True, none="the dataset's start and end poses",
    )

    refine_poses: bool = define_option(
        False, "Refinement", "refine the poses of the training views: first from tracks of "
        "features, then against the Gaussians; test views are aligned before they are judged",
    )
    refine_lens: bool = define_option(
        False, "Refinement", "refine the lens along with the poses; implies --refine-poses")

    max_gaussians: int = define_option(
        AUTO, "Gaussians", "largest number of Gaussians; auto: fast 50000, balanced 200000, best "
        "300000, or fewer for few photographs: 5000 a training view; up to 20000, training "
        "grows to twice the number and merges halfway",
        low=1, high=100_000_000, words=(AUTO,),
    )
    sh_degree: int = define_option(
        None, "Gaussians", "degree of the spherical harmonics of colour", low=0, high=3,
        none="3 if it shows photographs better that two short trainings set aside, or if the steps "
        "are too few for these, below about 500; otherwise, and with fewer than 12 training views, "
        "fast and balanced 1, best 2",
    )
    primitive: str = define_option(
        "gaussian", "Gaussians", "surfel: flat discs without a third scale, written as in 2DGS; "
        "atom: Gaussians with one scale; triangle: flat, falling linearly to its outline, which "
        "other viewers do not draw",
        choices=("gaussian", "surfel", "atom", *OTHER_PRIMITIVES),
    )
    response: str = define_option(
        "maximum", "Gaussians", "how alpha follows from a Gaussian's opacity o and its response G; "
        "maximum: o G, as in 3DGS and its viewers; extinction: 1 - (1 - o)^G, which other viewers "
        "do not draw", choices=("maximum", "extinction"),
    )
    order: str = define_option(
        "distance", "Gaussians", "order of Gaussians: by their means' distance or z, or as each "
        "pixel's own ray passes them; other viewers draw by z", choices=("distance", "z", "ray"))
    init: str = define_option(
        "auto", "Gaussians", "first Gaussians; points: the dataset's; random: inside the cameras' "
        "view; auto: points, with more by stereo where they cover too little of the photographs",
        choices=("auto", "points", "random"), reason="stereo starts closer than random points",
    )
    background: tuple[float, float, float] | None = define_option(
        None, "Gaussians", "colour behind all Gaussians, red,green,blue", low=0.0, high=1.0,
        none="the colour of most of the photographs' edges; if there is none, a random one in "
        "each step, so that everything visible gets covered, and in renders a soft colour from "
        "the surroundings", reason="black leaves dark places open",
    )


    exposure: str = define_option(
        "auto", "Loss", "find and remove the exposure and white balance of each photograph; auto: "
        "if photographs differ", choices=("auto", "on", "off"))
    surface: bool = define_option(
        False, "Loss", "make Gaussians flat and agree on one surface: for depth, normals and "
        "gsut mesh")
    robust: bool = define_option(
        False, "Loss", "leave areas of a photograph that differ from all others, such as "
        "passers-by, out of the loss")

    strategy: str = define_option(
        "mcmc", "Densification", "mcmc: relocation, with a cap; mini: as in Mini-Splatting, which "
        "overgrows and samples",
        choices=list_choices("training/strategies", "mcmc"),
    )

    # fmt: on

    def __post_init__(self) -> None:
        check_options(self)
        preset = get_preset(self.preset)
        object.__setattr__(self, "_open", {name for name in preset if getattr(self, name) is None})
        for name in self._open:
            object.__setattr__(self, name, preset[name])
        if self.refine_lens:
            object.__setattr__(self, "refine_poses", True)
        check_rule(self)

    @property
    def most_gaussians(self) -> int:
        """`max_gaussians`, or the limit of "auto"."""
        auto = self.max_gaussians == AUTO
        return get_preset(self.preset)["max_gaussians"] if auto else self.max_gaussians

    @property
    def recipe(self) -> Recipe:
        """The values that follow from steps, degree of harmonics and most Gaussians."""
        can_merge = self.strategy == "mcmc" and self.primitive == "gaussian"
        return make_recipe(self.steps, self.sh_degree, self.most_gaussians if can_merge else None)

    def list_words(self, *but: str) -> list[str]:
        """Lists the words of a command line that make these options, without the fields `but`.

        Values that follow from other options or from the scene are left out.
        """
        basis = {name: getattr(self, name) for name in ("preset", "steps", "max_side", "sh_degree")}
        start = get_preset(self.preset)
        of_preset = {name: start[name] for name in ("steps", "max_side", "sh_degree")}
        default = dataclasses.replace(TrainOptions(**basis), preset=None, **of_preset)
        return list_words(self, default, (*but, *self._open))

    def to_json(self) -> str:
        """Returns the options as a JSON object, one key a field; `from_json` reads it back."""
        return json.dumps(dataclasses.asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str, source: str = "options") -> TrainOptions:
        """Reads options from the text of `to_json`; keys that are absent take their defaults.

        Args:
            text: a JSON object.
            source: name of the file, for messages.

        Raises:
            InputError: not a JSON object, an unknown key (lists the known ones), or a bad value.
        """
        values = parse_json(text, source)
        if not isinstance(values, dict):
            raise InputError(f"{source}: a JSON object of options is needed, found {text[:40]!r}")
        known = [field.name for field in dataclasses.fields(cls)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise InputError(
                f"{source}: unknown option {', '.join(unknown)}, as other versions of gsut write; "
                f"leave it out of the file, or train again; known are {', '.join(known)}"
            )
        given: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in values.items()
        }
        try:
            return cls(**given)
        except InputError as error:
            raise InputError(f"{source}: {error}") from None
