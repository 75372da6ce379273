"""The settings of `gsut poses`: every default with its unit, range and reason."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from gsut._core import InputError
from gsut.run.options import check_options, define_option, describe_options

# Largest error of an observation in the structure of all images, over that of two images: it holds
# the errors of poses and points too.
_OVER_TWO_VIEW_ERROR = 1.5
PAIR_RULES = ("auto", "all", "sequential", "similar")


@describe_options
@dataclasses.dataclass(frozen=True)
class PosesOptions:
    """All settings of `find_poses`; immutable, checked when made.

    Raises:
        InputError: a value of the wrong kind or out of range (names option, value and range).
    """

    FLAGS: ClassVar[tuple[str, ...]] = (
        *("unknown_lens", "fov", "refine_rig", "pairs", "shutter", "readout_time"),
        *("keep_all_pixels", "marker", "control", "seed", "threads"),
    )

    # fmt: off
    unknown_lens: bool = define_option(
        False, "Lens", "estimate the lens even where one lies beside the images",
    )
    fov: float | None = define_option(
        None, "Lens", "rough horizontal field of view of an unknown lens", unit="degrees",
        low=5, high=300, none="several are tried",
    )
    refine_rig: bool = define_option(
        False, "Rig", "adjust the cameras' poses on the rig too; its size is kept, as it sets the "
        "scale",
    )
    max_features: int = define_option(
        4000, "Features", "features of an image: those of most contrast", low=50, high=100_000,
    )
    max_megapixels: float = define_option(
        2.1, "Features", "size of the images in which features are sought; larger ones are scaled "
        "down", unit="megapixels", low=0.01, high=1000,
    )
    keep_all_pixels: bool = define_option(
        False, "Features", "use pixels that show the same in all images, such as the black around "
        "a lens' circle, bars and logos; otherwise they are masked",
    )
    pairs: str = define_option(
        "auto", "Pairs", "images compared: all; sequential: each with the next 8, and with ever "
        "more distant ones; similar: each with the 20 most alike; auto: all up to 100 images, "
        "beyond that similar, or sequential if names count up",
        choices=PAIR_RULES,
    )
    max_error: float = define_option(
        1.8, "Mapping", "largest reprojection error of an observation",
        unit="thousandths of the image's diagonal", low=0, low_open=True, high=100,
    )
    shutter: str = define_option(
        "auto", "Shutter", "rolling: the camera moves while an image is read, each image with its "
        "own velocity; global: one pose an image; auto: as the dataset says, found for a "
        "video, rolling where --readout-time is given", choices=("auto", "global", "rolling"),
    )
    readout_time: float | None = define_option(
        None, "Shutter", "time from the first line of an image to its last, for a video: "
        "velocities are held near those between neighbouring frames", unit="x time between frames",
        low=0.0, high=1.0, low_open=True, none="each image's velocity by itself",
    )
    readout_direction: str = define_option(
        "top_to_bottom", "Shutter", "order in which lines are read, where the dataset does not say",
        choices=("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"),
    )
    marker: float | None = define_option(
        None, "Scale", "edge of the ArUco or AprilTag markers in the pictures; gives metres",
        unit="m", low=0.0, high=100.0, low_open=True, none="markers are not sought",
    )
    control: str | None = define_option(
        None, "Scale", "CSV file of surveyed points and where photographs show them: name,use,x,y,"
        "z,sigma,picture,u,v, a line a pixel; use is control or check; x east, y north, z up, in "
        "metres",
        none="none are known",
    )
    threads: int = define_option(0, "Run", "threads; 0 = all processors", low=0, high=4096)
    seed: int = define_option(0, "Run", "seed of every random number", low=0, high=2**63 - 1)
    # fmt: on

    @property
    def max_two_view_error(self) -> float:
        """Returns the largest error of a match under the relative pose of its two images."""
        return self.max_error / _OVER_TWO_VIEW_ERROR

    def __post_init__(self) -> None:
        check_options(self)
        if self.shutter == "global" and self.readout_time is not None:
            raise InputError("--shutter global and --readout-time contradict each other: drop one")
