"""Training options: every value with its unit, default, allowed range and the reason for it.

`TrainOptions` is the only list of options: the command line's flags, `options.json` and the
settings table of the report are all made from its fields. Values that depend on the number of
steps are None until `TrainOptions.resolve()` fills them in (see `compute_recipe`).
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any, ClassVar

from gsut._core import InputError
from gsut.run.options.fields import (
    check_options,
    define_option,
    describe_options,
    list_choices,
    list_words,
)
from gsut.run.options.primitives import FLAT_PRIMITIVES, OTHER_PRIMITIVES, check_rule
from gsut.run.options.recipe import PRESETS, compute_recipe, get_preset

# --max-gaussians auto: see gsut.training.complexity.
AUTO = "auto"


@describe_options
@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """All settings of one training run; immutable, checked when made.

    `steps`, `max_gaussians` and `sh_degree` take the preset's value unless they are given. The
    fields whose default depends on the number of steps are None (`coarse_to_fine`: "auto") until
    `resolve()`; their types are the ones they have from then on.

    Raises:
        InputError: a value of the wrong kind or out of range (names option, value and range), or
            options that contradict each other.
    """

    FLAGS: ClassVar[tuple[str, ...]] = (
        *("preset", "steps", "seed", "threads", "scale", "max_side", "test_every", "shutter"),
        *("readout_time", "refine_poses", "refine_lens", "max_gaussians", "sh_degree"),
        "primitive",
        *("background", "exposure", "surface", "robust", "drop_blurred", "motion_blur"),
    )
    UNLISTED_FLAGS: ClassVar[tuple[str, ...]] = ("order",)  # that `--help` leaves out
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
    eval_every: int = define_option(
        None, "Run", "steps between measurements of the held-out PSNR; 0 = at the end only",
        unit="steps", low=0, none="steps / 10, at least 100",
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

    shutter: str = define_option(
        "auto", "Data", "rolling: each line of an image has its own pose; global: one pose an "
        "image; auto: as the dataset says", choices=("auto", "global", "rolling"),
    )
    readout_time: float | None = define_option(
        None, "Data", "time from the first line of an image to its last, for a video with one pose "
        "a frame; the velocity is found from neighbouring frames", unit="x time between frames",
        low=0.0, high=1.0, low_open=True, none="the dataset's start and end poses",
    )
    readout_direction: str = define_option(
        "top_to_bottom", "Data", "order in which --readout-time reads the lines",
        choices=("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"),
    )

    refine_poses: bool = define_option(
        False, "Refinement", "refine the poses of the training views: first from tracks of "
        "features, then against the Gaussians; test views are aligned before they are judged",
    )
    refine_lens: bool = define_option(
        False, "Refinement", "refine the lens along with the poses; implies --refine-poses")
    refine_tracks: bool = define_option(
        True, "Refinement", "start the refinement with bundle adjustment of feature tracks; off: "
        "against the Gaussians alone", reason="tracks correct larger errors than colours do",
    )

    max_gaussians: int = define_option(
        AUTO, "Gaussians", "largest number of Gaussians; auto: fast 50000, balanced 200000, best "
        "300000, or fewer for few photographs: 5000 a training view, and one for 4 of their pixels",
        low=1, high=100_000_000, words=(AUTO,),
    )
    sh_degree: int = define_option(
        None, "Gaussians", "degree of the spherical harmonics of colour", low=0, high=3,
        none="3 if the points' colours depend on the viewing direction; otherwise fast and "
        "balanced 1, best 2",
    )
    primitive: str = define_option(
        "gaussian", "Gaussians", "surfel: flat discs without a third scale, written as in 2DGS; "
        "atom: Gaussians with one scale; power4: exp(-D^4 / 18), 3DGRT's default; beta: "
        "(1 - D^2 / 2b)^b, its shape b learnt; triangle: flat, its sharpness learnt; other viewers "
        "do not draw the last three",
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
    init_count: int | None = define_option(
        None, "Gaussians", "number of first Gaussians", low=1, high=100_000_000,
        none="all points, and a far sky if photographs show one without points; if points lie on "
        "less than 80 % of the photographs, up to 8000 less twice as many by stereo; 30000 if "
        "random",
    )
    init_scale: float = define_option(
        0.7, "Gaussians", "first standard deviation along the points' surface; across it at least "
        "a fifth of that", unit="x mean distance of 3 neighbours", low=0.0, high=100.0,
        low_open=True, reason="flat Gaussians start closer to a surface than round ones",
    )
    init_opacity: float = define_option(
        0.5, "Gaussians", "first opacity", low=0.0, high=1.0, low_open=True, high_open=True,
        reason="fainter ones take longer to become opaque",
    )
    background: tuple[float, float, float] | None = define_option(
        None, "Gaussians", "colour behind all Gaussians, red,green,blue", low=0.0, high=1.0,
        none="the colour of most of the photographs' edges; if there is none, a random one in "
        "each step, so that everything visible gets covered, and in renders a soft colour from "
        "the surroundings", reason="black leaves dark places open",
    )
    low_pass: float = define_option(
        0.0, "Gaussians", "3D low-pass filter: standard deviation, in pixels of the camera that "
        "sees a Gaussian best; 0 = none", unit="pixels", low=0.0, high=100.0,
        reason="0.3 is a pixel's own; against aliasing of Gaussians below a pixel",
    )

    lr_means: float = define_option(
        None, "Learning rates", "centres", unit="x scene extent", low=0.0, high=1.0,
        none="1.3 / steps up to 500 steps, 0.8 / steps from 1000, within 4.8e-4 .. 3.2e-3",
        reason="short runs need more than the published 1.6e-4",
    )
    lr_means_final_factor: float = define_option(
        0.01, "Learning rates", "centres: last rate / first rate", low=0.0, high=1.0,
        low_open=True, reason="published",
    )
    lr_scales: float = define_option(
        None, "Learning rates", "logarithms of scales", low=0.0, high=1.0,
        none="2e-2 up to 500 steps, 1.5e-2 from 1000", reason="3 x published",
    )
    lr_quats: float = define_option(
        4e-3, "Learning rates", "rotations", low=0.0, high=1.0, reason="4 x published")
    lr_opacity: float = define_option(
        0.1, "Learning rates", "opacity logits", low=0.0, high=1.0, reason="2 x published")
    lr_sh0: float = define_option(
        7e-3, "Learning rates", "base colour", low=0.0, high=1.0, reason="3 x published")
    lr_sh_rest: float = define_option(
        None, "Learning rates", "harmonics above degree 0", low=0.0, high=1.0,
        none="1 / steps within 1.25e-4 .. 1e-3",
        reason="short runs need more than the published 1.25e-4",
    )
    lr_shapes: float = define_option(
        2e-2, "Learning rates", "shapes of primitives that have some", low=0.0, high=1.0)
    lr_final_factor: float = define_option(
        None, "Learning rates", "all but the centres: last rate / first rate",
        low=0.0, high=1.0, low_open=True, none="1 to 1000 steps, 0.5 at 2000, 0.3 from 7000",
    )
    sparse_adam: bool = define_option(
        True, "Learning rates", "update only Gaussians that the step's image saw",
        reason="a tenth faster, slightly less accurate",
    )
    average_from: float = define_option(
        0.9, "Learning rates", "the result is the mean of the Gaussians over the steps after this "
        "fraction of them; 1 = the last step's", unit="fraction of steps", low=0.0, high=1.0,
        reason="the mean is steadier, above all if the exposure drifts",
    )

    ssim_weight: float = define_option(
        0.2, "Loss", "loss = (1 - w) L1 + w (1 - SSIM)", low=0.0, high=1.0, reason="published",
    )
    exposure: str = define_option(
        "auto", "Loss", "find and remove the exposure and white balance of each photograph; auto: "
        "if photographs differ", choices=("auto", "on", "off"))
    surface: bool = define_option(
        False, "Loss", "make Gaussians flat and agree on one surface: for depth, normals and "
        "gsut mesh")
    known_depth: str = define_option(
        "auto", "Loss", "distances that --surface takes from the dataset: points, files (along the "
        "ray; 16-bit pictures in millimetres, .npy in the dataset's units), off, or auto: files if "
        "training views have them, else points", choices=("auto", "points", "files", "off"))
    robust: bool = define_option(
        False, "Loss", "leave areas of a photograph that differ from all others, such as "
        "passers-by, out of the loss")
    movers: str = define_option(
        "auto", "Loss", "auto: leave what moved, such as passers-by, out of the loss where a "
        "photograph contradicts the others that see the same surface; keep: learn it",
        choices=("auto", "keep"))
    drop_blurred: bool = define_option(
        False, "Loss", "leave out photographs far less sharp than their neighbours in time")
    motion_blur: float | None = define_option(
        None, "Loss", "photographs are blurred by the camera's motion: exposure time of each; it "
        "is compared with the mean of up to three poses within this time, at the velocity between "
        "its neighbours", unit="x time between frames", low=0.0, high=1.0, low_open=True,
        none="sharp", reason="takes twice the time")
    opacity_regularizer: float = define_option(
        0.01, "Loss", "weight of the mean opacity", low=0.0, high=100.0, reason="published (MCMC)")
    scale_regularizer: float = define_option(
        0.01, "Loss", "weight of the mean scale", low=0.0, high=100.0, reason="published (MCMC)")
    coarse_to_fine: tuple[float, float] = define_option(
        "auto", "Loss", "train at 1/4 of the resolution until the first, at 1/2 until the second "
        "fraction of the steps; 0,0 = full resolution throughout", low=0.0, high=1.0,
        words=("auto",), reason="saves a third of the time")
    calibration_weights: str | None = define_option(
        None, "Loss", "lens file of `gsut calibrate`: residuals count less where that lens is "
        "uncertain", none="all pixels count the same")
    sh_every: int = define_option(
        None, "Loss", "steps between degrees of harmonics", unit="steps", low=1,
        none="0.6 steps / (degree + 1), at most 1000")

    strategy: str = define_option(
        "mcmc", "Densification", "mcmc: relocation, with a cap; mini: as in Mini-Splatting, which "
        "overgrows and samples",
        choices=list_choices("training/strategies", "mcmc"),
    )
    densify_from: float = define_option(
        0.05, "Densification", "first densification", unit="fraction of steps", low=0.0, high=1.0)
    densify_until: float = define_option(
        0.8, "Densification", "last densification", unit="fraction of steps", low=0.0, high=1.0)
    grow_until: float = define_option(
        None, "Densification", "--max-gaussians is reached here, by geometric growth",
        unit="fraction of steps", low=0.0, high=1.0, none="0.5",
        reason="60 % of the densification; the rest refines",
    )
    densify_every: int = define_option(
        None, "Densification", "steps between densifications", unit="steps", low=1,
        none="50 to 1000 steps, 100 from 2000",
    )
    dead_opacity: float = define_option(
        0.005, "Densification", "relocate or prune Gaussians at or below this opacity",
        low=0.0, high=1.0, high_open=True, reason="published",
    )
    noise: bool = define_option(
        None, "Densification", "MCMC noise on the centres", none="from 1500 steps on")

    compact_at: int | None = define_option(
        None, "Compaction", "step at which the Gaussians are compacted (see gsut compact); their "
        "number then stays", unit="steps", low=1, none="never",
    )
    keep: float = define_option(
        0.2, "Compaction", "fraction that compact_at keeps", low=0.0, high=1.0, low_open=True)
    compact_method: str = define_option(
        "ghap", "Compaction", "method of compact_at",
        choices=list_choices("compact/methods", "ghap"),
    )
    # fmt: on

    def __post_init__(self) -> None:
        check_options(self)
        preset = get_preset(self.preset)
        object.__setattr__(self, "_open", {name for name in preset if getattr(self, name) is None})
        for name in self._open:
            object.__setattr__(self, name, preset[name])
        if self.densify_from > self.densify_until:
            raise InputError(
                f"--set densify_from={self.densify_from} lies after densify_until="
                f"{self.densify_until}; both are fractions of the steps"
            )
        fractions = self.coarse_to_fine
        if isinstance(fractions, tuple) and fractions[0] > fractions[1]:
            raise InputError(
                f"--set coarse_to_fine={fractions[0]:g},{fractions[1]:g}: the quarter resolution "
                "must end before the half resolution does"
            )
        if self.primitive in FLAT_PRIMITIVES and self.low_pass:
            raise InputError(
                f"--set low_pass={self.low_pass:g} makes Gaussians thicker, and {self.primitive}s "
                "have no thickness; leave one of the two out"
            )
        if self.refine_lens:
            object.__setattr__(self, "refine_poses", True)
        check_rule(self)
        if self.compact_at is not None and self.compact_at >= self.steps:
            raise InputError(
                f"--set compact_at={self.compact_at} is not before the end of {self.steps} --steps"
            )
        most = self.most_gaussians
        if self.strategy == "mcmc" and (self.init_count or 0) > most:
            raise InputError(
                f"--set init_count={self.init_count} is more than --max-gaussians {most}"
            )

    @property
    def most_gaussians(self) -> int:
        """`max_gaussians`, or the limit of "auto"."""
        auto = self.max_gaussians == AUTO
        return get_preset(self.preset)["max_gaussians"] if auto else self.max_gaussians

    def resolve(self) -> TrainOptions:
        """Fills in every value that depends on the number of steps.

        Returns:
            TrainOptions in which only `preset`, `test_names`, `readout_time`, `init_count`,
            `background` (all but the first depend on the data) and `compact_at` (never) may be
            None. Values that were given are kept; resolving twice changes nothing.
        """
        changes = {
            name: value
            for name, value in compute_recipe(self.steps, self.sh_degree).items()
            if getattr(self, name) in (None, AUTO)
        }
        return dataclasses.replace(self, **changes)

    def list_words(self, *but: str) -> list[str]:
        """Lists the words of a command line that make these options, without the fields `but`.

        Values that follow from other options or from the scene are left out.
        """
        basis = {name: getattr(self, name) for name in ("preset", "steps", "max_side", "sh_degree")}
        start = get_preset(self.preset)
        of_preset = {name: start[name] for name in ("steps", "max_side", "sh_degree")}
        unsaid = {"preset": None, **of_preset}
        default = TrainOptions(**basis)
        if self == self.resolve():  # which values were given is no longer known
            default = default.resolve()
        return list_words(self, dataclasses.replace(default, **unsaid), (*but, *self._open))

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
