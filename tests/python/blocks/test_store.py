"""Gaussians of blocks in files: put to the block they lie in, and written as one scene."""

import dataclasses

import numpy as np
import pytest

import gsut
from gsut.blocks.layout import Layout
from gsut.blocks.store import BlockStore
from gsut.blocks.task import Trained
from gsut.gaussians import StoredGaussians, merge_gaussians

OFFSET = np.array([10.0, 0.0, 0.0])
LAYOUT = Layout(
    {"axis": 0, "at": 9.5, "below": None,
     "above": {"axis": 1, "at": 0.0, "below": None, "above": None}}
)  # fmt: skip


@pytest.fixture
def gaussians(rng):
    means = rng.normal(size=(300, 3)).astype(np.float32)
    return gsut.seed_from_points(means.astype(np.float64))


@pytest.fixture
def store(tmp_path):
    return BlockStore(tmp_path, LAYOUT, OFFSET)


def test_every_gaussian_goes_to_the_block_it_lies_in(store, gaussians):
    store.sort(0, [lambda b=b: Trained(gaussians[b::3]) for b in range(3)])
    owners = store.find_owners(gaussians)
    assert set(owners) == {0, 1, 2}
    assert store.count_gaussians(0) == np.bincount(owners).tolist()
    for block in range(3):
        own = store.read_gaussians(block, 0)
        assert (store.find_owners(own) == block).all()
        assert {row.tobytes() for row in own.means} == {
            row.tobytes() for row in gaussians.means[owners == block]
        }
    store.sort(0, [pytest.fail] * 3)  # done: nothing is read


def test_all_are_put_to_their_blocks_in_their_order(store, gaussians):
    store.begin(Trained(gaussians))
    owners = store.find_owners(gaussians)
    for block in range(3):
        np.testing.assert_array_equal(
            store.read_gaussians(block, 0).means, gaussians[owners == block].means
        )


def test_moments_go_where_their_gaussians_go(store, gaussians):
    twice = dataclasses.replace(gaussians, means=2 * gaussians.means)
    parts = [Trained(gaussians[b::3], (twice[b::3], gaussians[b::3])) for b in range(2)]
    store.sort(0, [lambda p=p: p for p in [*parts, Trained(gaussians[2::3])]])
    untrained = {row.tobytes() for row in gaussians[2::3].means}
    rows = 0
    for block in range(3):
        own = store.read_block(block, 0)
        known = np.array([row.tobytes() not in untrained for row in own.gaussians.means])
        first, second = own.moments
        np.testing.assert_array_equal(first.means[known], 2 * own.gaussians.means[known])
        np.testing.assert_array_equal(second.sh[known], own.gaussians.sh[known])
        assert not first.means[~known].any() and not second.quats[~known].any()
        rows += known.sum()
    assert rows == 200


def test_sorting_that_was_broken_off_is_done_again(store, gaussians, tmp_path):
    parts = [lambda b=b: Trained(gaussians[b::3]) for b in range(3)]
    store.sort(0, parts)
    before = [(tmp_path / f"b{block:03d}/own0.npz").read_bytes() for block in range(3)]
    (tmp_path / "b001/own0.npz").unlink()
    store.sort(0, parts)
    assert before == [(tmp_path / f"b{block:03d}/own0.npz").read_bytes() for block in range(3)]


def test_scene_is_written_block_by_block_as_one(store, gaussians, tmp_path):
    owners = store.find_owners(gaussians)
    store.sort(1, [lambda b=b: Trained(gaussians[owners == b]) for b in range(3)])
    origin = store.save(tmp_path / "parts.ply", 1, ["said"], False)
    parts = [gaussians[owners == block] for block in range(3)]
    whole = merge_gaussians([part[StoredGaussians.order_rows(part)] for part in parts]).translate(
        OFFSET
    )
    gsut.formats.save_ply(tmp_path / "whole.ply", whole, ["said"])
    assert (tmp_path / "parts.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert not origin.any()
    some, of = store.sample(1)
    assert len(some) == 300
    assert (store.find_owners(some) == of).all()


def test_scene_far_from_zero_keeps_its_origin(gaussians, tmp_path):
    far = BlockStore(tmp_path, LAYOUT, np.array([4e5, 5e6, 0.0]))
    owners = far.find_owners(gaussians)
    far.sort(0, [lambda b=b: Trained(gaussians[owners == b]) for b in range(3)])
    np.testing.assert_array_equal(far.save(tmp_path / "far.ply", 0, [], False), far._offset)
    back = gsut.formats.load_ply(tmp_path / "far.ply")
    np.testing.assert_array_equal(back.origin, far._offset)
    assert len(back) == 300
