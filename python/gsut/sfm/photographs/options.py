"""The settings of `gsut poses`: every default with its unit, range and reason."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from gsut._core import InputError
from gsut.lens import find_lens, is_lens_name
from gsut.run.options import check_options, define_option, describe_options

PAIR_RULES = ("auto", "all", "sequential", "similar")


@describe_options
@dataclasses.dataclass(frozen=True)
class PosesOptions:
    """All settings of `find_poses`; immutable, checked when made.

    Raises:
        InputError: a value of the wrong kind or out of range (names option, value and range).
    """

    FLAGS: ClassVar[tuple[str, ...]] = (
        *("unknown_lens", "fov", "refine_rig", "shutter", "readout_time", "seed", "threads"),
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
    feature_scale: float = define_option(
        0.0, "Features", "scale factor of the images in which features are sought; 0: "
        "as large as max_megapixels allows", low=0, high=1,
    )
    max_megapixels: float = define_option(
        2.1, "Features", "see feature_scale", low=0.01, high=1000,
    )
    contrast: float = define_option(
        0.0067, "Features", "SIFT's threshold of contrast", low=0, high=1,
        reason="a higher one misses features of even surfaces, and images with them",
    )
    pairs: str = define_option(
        "auto", "Pairs", "images compared: all; sequential: each with the next `window`, and with "
        "ever more distant ones; similar: each with the `neighbors` most alike; auto: all up to "
        "`all_up_to` images, beyond that similar, or sequential if names count up",
        choices=PAIR_RULES,
    )
    all_up_to: int = define_option(100, "Pairs", "see pairs", low=2)
    window: int = define_option(8, "Pairs", "see pairs", low=1)
    neighbors: int = define_option(20, "Pairs", "see pairs", low=1)
    preview_features: int = define_option(
        700, "Pairs", "features, the largest, that decide whether a pair is compared in full",
        low=10,
    )
    preview_matches: int = define_option(
        8, "Pairs", "of them that must match; 0: all pairs are compared in full", low=0,
    )
    partners: int = define_option(
        24, "Pairs", "most images that an image is compared with in full: those with the most "
        "matches of the largest features", low=2,
    )
    max_ratio: float = define_option(
        0.85, "Matches", "largest ratio of the descriptors' distances, nearest to second nearest",
        low=0, low_open=True, high=1,
    )
    max_distance: float = define_option(
        0.7, "Matches", "largest distance of matched descriptors of unit length", low=0,
        low_open=True, high=2,
    )
    max_two_view_error: float = define_option(
        1.2, "Matches", "largest error of a match under the relative pose of its two images",
        unit="thousandths of the image's diagonal", low=0, low_open=True, high=100,
    )
    min_matches: int = define_option(
        20, "Matches", "fewest verified matches of a pair that is used", low=8,
    )
    max_error: float = define_option(
        1.8, "Mapping", "largest reprojection error of an observation",
        unit="thousandths of the image's diagonal", low=0, low_open=True, high=100,
    )
    min_angle: float = define_option(
        1.5, "Mapping", "smallest triangulation angle of a point", unit="degrees", low=0,
        low_open=True, high=90,
    )
    min_inliers: int = define_option(
        15, "Mapping", "fewest inliers of an image while the structure grows", low=4,
    )
    loss_scale: float = define_option(
        1.5, "Mapping", "scale of the Cauchy loss, in medians of the residuals",
        low=0, low_open=True, high=100,
    )
    extend_rounds: int = define_option(
        2, "Mapping", "rounds of track extension at the end: points are sought in images that "
        "do not observe them yet", low=0, high=20,
        reason="more rounds add few observations",
    )
    extend_radius: float = define_option(
        2.2, "Mapping", "search radius around the predicted pixel of a point",
        unit="thousandths of the image's diagonal", low=0, low_open=True, high=100,
    )
    extend_distance: float = define_option(
        0.8, "Mapping", "largest distance of a feature's descriptor, of unit length, to the mean "
        "descriptor of the point", low=0, low_open=True, high=2,
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
    rolling_error: float = define_option(
        12.0, "Shutter", "rolling: factor on the error thresholds until velocities are estimated",
        low=1.0, high=1000,
    )
    threads: int = define_option(0, "Run", "threads; 0 = all processors", low=0, high=4096)
    seed: int = define_option(0, "Run", "seed of every random number", low=0, high=2**63 - 1)
    # fmt: on

    def __post_init__(self) -> None:
        check_options(self)
        if self.shutter == "global" and self.readout_time is not None:
            raise InputError("--shutter global and --readout-time contradict each other: drop one")


def add_lens_readout(
    options: PosesOptions, camera: str | None, captured: dict[str, Any]
) -> PosesOptions:
    """Adds the readout time of a lens given by name to the options of a rolling shutter.

    Args:
        options: unchanged if the shutter is not rolling or the readout time is known.
        camera: a lens file, a lens name, or None.
        captured: figures of a capture: "size" in pixels, and "name_rate", frames a second.
    """
    wanted = options.shutter == "rolling" and options.readout_time is None
    if not (wanted and camera and is_lens_name(camera)):
        return options
    profile = find_lens(camera, tuple(captured["size"]))
    share = profile.find_readout_share(captured["name_rate"])
    backwards = (profile.readout_ms or 0) < 0
    direction = "bottom_to_top" if backwards else options.readout_direction
    return dataclasses.replace(options, readout_time=share, readout_direction=direction)
