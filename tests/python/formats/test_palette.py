"""Tests the two-level k-means behind the palette of a SOG file."""

import numpy as np
import pytest
from scipy.cluster.vq import kmeans2

import gsut
from gsut import InputError, _core
from tolerances import PALETTE_OF_BEST


@pytest.fixture
def rows(rng):
    """Rows about 200 middles of different weight, in an order in which neighbours are alike."""
    middles = np.sort(rng.normal(0, 1, (200, 9)), axis=0)
    at = np.sort(rng.integers(0, 200, 6000) ** 2 // 200)
    return (middles[at] + rng.normal(0, 0.1, (6000, 9))).astype(np.float32)


def squared_error(rows, entries, labels):
    return float(np.mean(np.sum((rows - entries[labels]) ** 2, axis=1)))


def test_palette_is_nearly_as_good_as_k_means_on_one_level(rows):
    entries, labels = _core.make_palette(rows, 256)
    assert 200 <= len(entries) <= 256
    best, best_labels = kmeans2(rows, 256, iter=20, minit="++", seed=0)
    found = squared_error(rows, entries, labels)
    assert found <= PALETTE_OF_BEST * squared_error(rows, best, best_labels)


def test_entries_are_the_means_of_their_rows_and_labels_name_near_ones(rows):
    entries, labels = _core.make_palette(rows, 64, 100)
    used = np.unique(labels)
    means = np.stack([rows[labels == label].mean(axis=0, dtype=np.float64) for label in used])
    np.testing.assert_allclose(entries[used], means, atol=1e-6)


def test_palette_has_the_same_bits_on_any_number_of_threads(rows):
    before, found = gsut.num_threads(), []
    for threads in (1, 2, 5):
        gsut.set_num_threads(threads)
        found.append(_core.make_palette(rows, 300))
    gsut.set_num_threads(before)
    for entries, labels in found[1:]:
        assert np.array_equal(entries, found[0][0]) and np.array_equal(labels, found[0][1])


@pytest.mark.parametrize(("count", "entries"), [(1, 1), (1, 50), (3, 2), (17, 16), (40, 1000)])
def test_few_rows_have_a_palette_too(rng, count, entries):
    rows = rng.normal(size=(count, 5)).astype(np.float32)
    values, labels = _core.make_palette(rows, entries)
    assert 1 <= len(values) <= min(count, entries) and labels.max() < len(values)
    if count <= entries <= 1:
        np.testing.assert_array_equal(values[labels], rows)


@pytest.mark.parametrize(
    ("rows", "entries", "message"),
    [
        (np.zeros((0, 3), np.float32), 4, "needs rows"),
        (np.zeros((5, 3), np.float32), 0, "needs rows"),
        (np.full((5, 3), np.nan, np.float32), 2, "finite"),
        (np.zeros((5, 3)), 2, "float32"),
        (np.zeros(5, np.float32), 2, "shape"),
    ],
)
def test_wrong_input_is_refused(rows, entries, message):
    with pytest.raises(InputError, match=message):
        _core.make_palette(rows, entries)
