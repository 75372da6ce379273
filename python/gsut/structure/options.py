"""The settings of `gsut poses`: every default with its unit and its reason."""

from __future__ import annotations

import dataclasses

from gsut._core import InputError

PAIR_RULES = ("auto", "all", "sequential", "similar")


@dataclasses.dataclass(frozen=True)
class PosesOptions:
    """What `estimate_poses` does; the defaults suit photographs and videos of one scene.

    Args:
        max_features: of an image; the strongest ones of all sizes are kept.
        feature_scale: of the images in which features are sought, above 0 and at most 1. 0: such
            that an image has at most `max_megapixels`.
        max_megapixels: see feature_scale.
        contrast: SIFT's threshold; OpenCV's own 0.04 finds too few on weak
            texture (sponza_fisheye: 56 of 60 images registered with 0.02, all with this).
        pairs: which images are compared: "all"; "sequential", each with the next `window` and with
            ever more distant ones; "similar", each with the `neighbors` most alike; "auto": all up
            to `all_up_to` images, beyond that sequential where the names count up, and similar.
        all_up_to, window, neighbors: see pairs.
        preview_features: of the largest features that decide whether a pair is compared in full.
        preview_matches: of them that must match.
        max_ratio: of descriptor distances, nearest to second nearest.
        max_distance: of matched descriptors (unit vectors).
        max_error: in thousandths of the image's diagonal: how far a feature may be off.
        max_two_view_error: the same for matches of two images.
        min_matches: of a pair, after verification.
        min_angle: degrees, smallest angle under which a point is seen.
        min_inliers: points that an image must see to be registered.
        loss_scale: residuals beyond this many times their median lose weight (Cauchy).
        threads: 0 for all.
        seed: of all random numbers.
    """

    max_features: int = 6000
    feature_scale: float = 0.0
    max_megapixels: float = 2.1
    contrast: float = 0.0067
    pairs: str = "auto"
    all_up_to: int = 100
    window: int = 8
    neighbors: int = 20
    preview_features: int = 700
    preview_matches: int = 6
    max_ratio: float = 0.8
    max_distance: float = 0.7
    max_error: float = 1.8
    max_two_view_error: float = 1.2
    min_matches: int = 20
    min_angle: float = 1.5
    min_inliers: int = 15
    loss_scale: float = 1.5
    threads: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.pairs not in PAIR_RULES:
            raise InputError(f"pairs is one of {', '.join(PAIR_RULES)}, found {self.pairs!r}")
        if not 0 <= self.feature_scale <= 1:
            raise InputError(
                f"feature_scale is at most 1 (0: chosen by size), found {self.feature_scale:g}"
            )
        for name in ("max_features", "max_megapixels", "max_error", "max_two_view_error"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be above 0, found {getattr(self, name):g}")
        for name in ("max_ratio", "max_distance"):
            if not 0 < getattr(self, name) <= 2:
                raise InputError(f"{name} must be in (0, 2], found {getattr(self, name):g}")
