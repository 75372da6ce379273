"""Features and matches of photographs; stage files of a killed run are not made again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gsut._core import InputError
from gsut.sfm.core.features import Features, find_all_features, no_features
from gsut.sfm.core.matching import RawMatches, match_in_full, preview_pairs
from gsut.sfm.core.options import PosesOptions
from gsut.sfm.core.pairs import choose_pairs
from gsut.sfm.core.photographs import FEWEST_IMAGES, Photographs
from gsut.sfm.core.stages import Stages

# Told (stage, done, total, text) as the work goes on.
OnProgress = Callable[[str, int, int, str], None]


def collect_features(
    photographs: Photographs,
    options: PosesOptions,
    on_progress: OnProgress,
    note: Callable[[str], None],
    stages: Stages | None = None,
) -> list[Features]:
    """The features of all images; none of those that cannot be read.

    Args:
        photographs: the images. options: see PosesOptions.
        on_progress: told of the stage "features". note: told which images are left out, and why.
        stages: where they are kept, or None.

    Raises:
        InputError: fewer than two images can be used.
    """
    total = len(photographs)
    found = [stages.load_features(i) if stages else None for i in range(total)]
    absent = [i for i, features in enumerate(found) if features is None]
    on_progress("features", total - len(absent), total, "")
    broken: list[str] = []

    def on_image(place: int, features: Features | None, error: Exception | None) -> None:
        index = absent[place]
        if features is None:
            broken.append(str(error))
            note(f"left out: {error}")
            features = no_features()
        elif stages is not None:
            stages.save_features(index, features)
        found[index] = features
        done = total - len(absent) + place + 1
        on_progress("features", done, total, f"{len(features):,} in {photographs.names[index]}")

    find_all_features(
        [photographs.paths[i] for i in absent],
        [photographs.cameras[i] for i in absent],
        [photographs.masks[i] for i in absent],
        options,
        on_image,
    )
    if total - len(broken) < FEWEST_IMAGES:
        raise InputError(
            f"{total - len(broken)} of {total} images can be used, and poses need at least "
            f"{FEWEST_IMAGES} that overlap; {broken[0] if broken else ''}"
        )
    return [features for features in found if features is not None]


def match_images(
    names: Sequence[str],
    features: Sequence[Features],
    options: PosesOptions,
    on_progress: OnProgress,
    frames: np.ndarray | None = None,
    stages: Stages | None = None,
) -> RawMatches:
    """The matches of all pairs of images that look alike.

    Args:
        names, features: of all images. options: see PosesOptions.
        on_progress: told of the stages "preview" and "matching".
        frames: of a rig's images, see Photographs.
        stages: where they are kept, or None.
    """
    kept = stages.load_matches() if stages is not None else None
    if kept is not None:
        return kept

    def show(stage: str) -> Callable[[int, int], None]:
        return lambda done, total: on_progress(stage, done, total, f"{total} pairs")

    pairs = choose_pairs(names, features, options, frames)
    pairs = preview_pairs(features, pairs, options, show("preview"))
    raw = match_in_full(features, pairs, options, show("matching"))
    if stages is not None:
        stages.save_matches(raw)
    return raw
