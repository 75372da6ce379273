"""Which views are trained on and which are held out for testing."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from gsut.bounds import check_number
from gsut.data.errors import DatasetError, list_some
from gsut.data.images import normalize_name
from gsut.data.scene.scene import Scene

TEST_EVERY = 8  # every 8th image by name is held out, as in the 3DGS papers


def split_views(
    names: Sequence[str],
    source: Path,
    *,
    test_every: int = TEST_EVERY,
    test_names: Sequence[str] | None = None,
    listed_train: Sequence[str] | None = None,
    listed_test: Sequence[str] | None = None,
    missing: Sequence[str] = (),
) -> tuple[list[int], list[int], list[str]]:
    """Splits views into training and test.

    In order of precedence: `test_names`, the dataset's own lists, every `test_every`-th by name.

    Args:
        names: of the views, sorted.
        source: the dataset's file, for messages.
        test_every: 0 holds none out.
        test_names: names, file names or stems to hold out.
        listed_train, listed_test: lists in the dataset's file, or None.
        missing: names that the dataset lists but whose image does not exist.
    Returns:
        train indices, test indices, notes.
    Raises:
        DatasetError: an unknown name, a view in both lists, or no training view left.
        InputError: `test_every` is negative.
    """
    test_every = check_number(test_every, "test_every", 0, whole=True)
    notes: list[str] = []
    everything = range(len(names))
    if test_names is not None:
        test = _find_indices(test_names, names, "test_names", source, missing)
        train = set(everything) - test
    elif listed_test is not None or listed_train is not None:
        test = _find_indices(listed_test or (), names, "test_filenames", source, missing)
        if listed_train is None:
            train = set(everything) - test
        else:
            train = _find_indices(listed_train, names, "train_filenames", source, missing)
        both = sorted(train & test)
        if both:
            raise DatasetError(
                source,
                f"{len(both)} images are in the training and the test list:"
                f" {list_some([names[i] for i in both])}",
                "a held-out image must not be trained on: remove them from one list",
            )
        neither = [names[i] for i in everything if i not in test | train]
        if neither:
            notes.append(
                f"{source}: {len(neither)} images are in no list and are not used:"
                f" {list_some(neither)}"
            )
    else:
        test = set(everything[::test_every]) if test_every and len(names) > 1 else set()
        train = set(everything) - test
    if not train:
        raise DatasetError(source, "no training view is left", "hold fewer images out for testing")
    return sorted(train), sorted(test), notes


def choose_inner_views(
    names: Sequence[str], test_every: int, spare: Sequence[float] | None = None
) -> list[str]:
    """Chooses views to hold out that have training views on both sides, evenly spread.

    The usual split begins with the first view, which only one side sees: with few views its score
    says how far the path reaches, not how good the scene is.

    Args:
        names: of the views, in order.
        test_every: one view in this number is held out, rounded up; 0 holds none out.
        spare: what the other views know of each, where the order says nothing of that: of each
            part of the views the one of which they know most is held out.

    Returns:
        names; none of fewer than three views.
    """
    total = len(names)
    if not test_every or total < 3:
        return []
    count = min(-(-total // test_every), total // 3)
    if spare is not None:
        parts = np.array_split(np.arange(total), count)
        return [names[part[np.argmax(np.take(spare, part))]] for part in parts]
    return [names[(2 * i + 1) * total // (2 * count)] for i in range(count)]


def hold_out_views(scene: Scene, names: Sequence[str]) -> Scene:
    """Returns the scene with the views of these names held out and all others trained on.

    Raises:
        DatasetError: see `split_views`.
    """
    train, test, _ = split_views([v.name for v in scene.views], scene.path, test_names=names)
    return scene.replace(train_indices=train, test_indices=test)


def _find_indices(
    wanted: Sequence[str], names: Sequence[str], what: str, source: Path, missing: Sequence[str]
) -> set[int]:
    """Finds names given in full, as file name or as stem; missing images are skipped."""
    in_full = {_clean(name): [index] for index, name in enumerate(names)}
    by_alias: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        for alias in _list_aliases(name):
            by_alias.setdefault(alias, []).append(index)
    absent = {alias for name in missing for alias in _list_aliases(name)}
    found: set[int] = set()
    for name in wanted:
        rows = in_full.get(_clean(name)) or by_alias.get(_clean(name), [])
        if len(rows) > 1:
            raise DatasetError(
                source,
                f"{what} has '{name}', which fits {len(rows)} images:"
                f" {list_some([names[i] for i in rows])}",
                "give the name with its folder",
            )
        if not rows and _clean(name) not in absent:
            near = difflib.get_close_matches(str(name), names, n=1, cutoff=0)
            hint = f"the nearest is '{near[0]}'" if near else "there are no images"
            raise DatasetError(source, f"{what} has '{name}', which is not an image", hint)
        found.update(rows)
    return found


def _clean(name: object) -> str:
    return normalize_name(str(PurePosixPath(str(name))))


def _list_aliases(name: str) -> set[str]:
    path = PurePosixPath(_clean(name))
    return {str(path), path.name, path.stem, str(path.parent / path.stem)}
