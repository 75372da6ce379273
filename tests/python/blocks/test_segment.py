"""One block's training: exact gradients, a context that stays, a pure function of the state."""

import dataclasses
import weakref

import numpy as np
import pytest

import gsut
from gsut.blocks.segment import (
    TILE,
    BlockLoop,
    order_views,
    run_segment,
    spread_tiles,
    widen_tiles,
)
from gsut.blocks.shares import Shares, choose_context, find_shares
from gsut.blocks.task import BlockTask, Trained, list_photographs
from gsut.compact import list_seen_views
from gsut.run import read_checkpoint, write_checkpoint
from gsut.training import TrainingLoop
from small_blocks import OPTIONS, small_scene
from tolerances.blocks import SHARES_SUM

FEW_STEPS = dataclasses.replace(OPTIONS, steps=24)
FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return small_scene(tmp_path_factory.mktemp("blocks") / "data").centred


@pytest.fixture(scope="module")
def task(scene):
    start = TrainingLoop(scene, OPTIONS).gaussians.copy()
    train = [scene.views[index] for index in scene.train_indices]
    part = scene.replace(views=train, train_indices=range(len(train)), test_indices=())
    tiles = np.zeros((3, 3), bool)
    tiles[1, 0] = True
    return BlockTask(
        part, FEW_STEPS, 1.0, scene.extent, None, [tiles] * len(train), np.ones(len(train)),
        1 << 30, Trained(start[:30]), start[30:], 0, 24, 3,
    )  # fmt: skip


def finished(task, between=lambda state: state):
    """The last state, each passed through `between`; None begins anew in each segment."""
    state, kept = None, []
    for _ in range(task.segments):
        state = between(run_segment(task, state, kept))
    return state


def test_context_stays_and_own_move(task):
    before = task.context.copy()
    result = finished(task)["own"]
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(task.context, name), getattr(before, name))
    assert len(result["means"]) >= len(task.own)
    assert np.abs(result["means"][: len(task.own)] - task.own.gaussians.means).max() > 0


def test_segments_from_files_give_the_bits_of_one_go(task, tmp_path):
    whole = finished(dataclasses.replace(task, segments=1))["own"]

    def through_file(state):
        write_checkpoint(tmp_path / "state.npz", state)
        return read_checkpoint(tmp_path / "state.npz")

    write_checkpoint(tmp_path / "task.npz", task.as_dict())
    values = read_checkpoint(tmp_path / "task.npz")
    state = None
    for _ in range(task.segments):  # a worker that begins anew each time
        state = through_file(run_segment(BlockTask.from_dict(values), state, []))
    kept_loop = finished(task)["own"]
    for name in FIELDS:
        np.testing.assert_array_equal(state["own"][name], whole[name])
        np.testing.assert_array_equal(kept_loop[name], whole[name])
    assert state["pixels"] > 0
    assert all(path.endswith(".png") for path in list_photographs(values))


def test_round_that_goes_on_gives_the_bits_of_an_unbroken_one(task):
    """Adam's moments come along: without them the first steps are as large as the first of all."""
    whole = finished(dataclasses.replace(task, segments=1))
    assert whole["moments"] == []
    first = finished(dataclasses.replace(task, end=20))
    own = Trained.from_dict(first)
    assert len(own.moments) == 2
    rest = dataclasses.replace(task, own=own, begin=20)
    result, without = (
        finished(dataclasses.replace(rest, own=each)) for each in (own, Trained(own.gaussians))
    )
    for name in FIELDS:
        np.testing.assert_array_equal(result["own"][name], whole["own"][name])
    assert np.abs(without["own"]["means"] - whole["own"]["means"]).max() > 0


def test_the_loop_of_another_block_goes_before_the_next_is_made(task, monkeypatch):
    kept = []
    run_segment(task, None, kept)
    before = weakref.ref(kept[0])
    monkeypatch.setattr("gsut.blocks.segment.BlockLoop", lambda task: pytest.fail(str(before())))
    with pytest.raises(pytest.fail.Exception, match=r"^None$"):  # nothing holds its photographs
        run_segment(dataclasses.replace(task), None, kept)


def test_gradients_of_the_pixels_that_count_are_those_of_the_whole_view(task):
    """The loss at a pixel depends on a neighbourhood, all of which is rendered."""
    found = {}
    for name, tiles in (("part", task.tiles), ("whole", [np.ones((3, 3), bool)] * 12)):
        loop = BlockLoop(dataclasses.replace(task, tiles=tiles[: len(task.tiles)]))
        seen = {}
        apply = loop._choose_pixels

        def keep(step, dimage, apply=apply, seen=seen):
            seen["before"] = dimage.copy()
            apply(step, dimage)
            seen["after"] = dimage.copy()

        loop._choose_pixels = keep
        loop.advance()
        found[name] = seen
    counts = spread_tiles(task.tiles[0], (48, 48), (48, 48)) > 0
    np.testing.assert_array_equal(found["part"]["after"][counts], found["whole"]["before"][counts])
    assert np.abs(found["part"]["after"][counts]).max() > 0
    assert not found["part"]["after"][~counts].any()
    assert not widen_tiles(counts.astype(np.float32))[:, 2].any()  # and not all was rendered


def test_each_tenth_step_is_about_the_whole_view(task):
    loop = BlockLoop(task)
    pixels = []
    for _ in range(10):
        before = loop.pixels
        loop.advance()
        pixels.append(loop.pixels - before)
    assert pixels[9] == 48 * 48
    assert max(pixels[:9]) < 48 * 48


def test_shares_of_all_blocks_add_up_to_what_is_covered(scene, rng):
    g = TrainingLoop(scene, OPTIONS).gaussians.copy()
    for blocks in (4, 9):  # drawn all, or those alone that a first pass has found
        owners = rng.integers(0, blocks, len(g)).astype(np.int32)
        indices = scene.train_indices[:3]
        shares = find_shares(g, owners, blocks, scene, scene, indices)
        for row, index in enumerate(indices):
            view, mask = scene.views[index], scene.mask(index)
            alpha = gsut.render(g, scene.camera(index), view.motion).alpha
            assert shares.weights[row].sum() == pytest.approx(alpha[mask].sum(), rel=SHARES_SUM)
            shown = np.zeros((3, 3), bool)
            for block in range(blocks):
                shown |= shares.tiles.get((row, block), np.zeros((3, 3), bool))
            covered = np.add.reduceat(np.add.reduceat(alpha, range(0, 48, TILE), 0),
                                      range(0, 48, TILE), 1)  # fmt: skip
            assert (shown >= (covered > 1)).all()


def test_context_is_what_is_seen_and_merged_to_a_most(scene, rng):
    g = TrainingLoop(scene, OPTIONS).gaussians.copy()
    own, others = g[:20], g[20:]
    views = list_seen_views(scene, scene.train_indices[:2])
    assert len(choose_context(own, others, views, 1000, 0)) == len(others)
    assert len(choose_context(own, others, views, 15, 0)) == 15
    nothing = [dataclasses.replace(view, mask=np.zeros_like(view.mask)) for view in views]
    assert len(choose_context(own, others, nothing, 15, 0)) == 0


def test_views_are_trained_on_as_often_as_their_rates_say():
    rates = np.array([1.0, 0.25, 0.02, 1.0])
    order = order_views(rates, 227, 5)
    times = np.bincount(order, minlength=4)
    assert len(order) == 227
    assert np.abs(times / times[0] - rates).max() < 0.02
    np.testing.assert_array_equal(order_views(rates, 100, 5), order[:100])  # whatever follows
    epochs = order_views(np.ones(7), 21, 5).reshape(3, 7)
    assert (np.sort(epochs) == np.arange(7)).all()


def test_photographs_that_are_not_kept_change_no_bits(task):
    kept = finished(dataclasses.replace(task, segments=1))["own"]
    short = finished(dataclasses.replace(task, keep_bytes=0, segments=1))["own"]
    for name in FIELDS:
        np.testing.assert_array_equal(short[name], kept[name])
    assert len(task.scene._images._items) == 1


def test_neighbours_are_those_that_a_block_s_views_show_most_of_first():
    tile = np.ones((1, 1), bool)
    shares = Shares(
        np.array([[50.0, 30.0, 2.0, 0.0], [0.1, 80.0, 0.0, 9.0]]), np.array([100.0, 100.0]),
        {(0, 0): tile, (0, 1): tile, (0, 2): tile, (1, 1): tile, (1, 3): tile},
    )  # fmt: skip
    assert shares.find_neighbours(0).tolist() == [1, 2]  # 3 is in no view that it is trained on
    assert shares.find_neighbours(1).tolist() == [0, 3, 2]
    np.testing.assert_allclose(shares.rates, [[1, 1, 8 / 82, 0], [0, 1, 0, 36 / 89.1]])


def test_light_travels_and_stays(task, tmp_path):
    from gsut.render import Falloff, Light

    light = Light(
        np.linspace(0.8, 1.2, 3 * len(task.tiles)).reshape(-1, 3),
        (Falloff(0.5, np.full((3, 3), -0.1)),),
    )
    lit = dataclasses.replace(task, light=light, segments=1)
    write_checkpoint(tmp_path / "task.npz", lit.as_dict())
    back = BlockTask.from_dict(read_checkpoint(tmp_path / "task.npz"))
    np.testing.assert_array_equal(back.light.gains, light.gains)
    one, two = (finished(each)["own"]["sh"] for each in (lit, back))
    np.testing.assert_array_equal(one, two)
    assert np.abs(one - finished(dataclasses.replace(task, segments=1))["own"]["sh"]).max() > 0
    assert back.own.as_dict()["own"].keys() == set(FIELDS)
