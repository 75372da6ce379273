"""What moved while photographs were taken: found where one contradicts the others, and left out."""

from types import SimpleNamespace

import numpy as np
import pytest

import gsut
import tolerances
from gsut import _core
from gsut.data import Frame, load_dataset, write_transforms
from gsut.data.points import format_points_ply
from gsut.data.poses import invert_pose
from gsut.evaluate import evaluate
from gsut.files import write_picture
from gsut.run import RunFolder
from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.training import read_trained
from gsut.training.loop import TrainingLoop
from gsut.training.photograph import Movers, movers
from gsut.training.record import find_run_movers
from gsut.training.record.results import _summarize_patches
from random_scenes import pinhole

SIZE, VIEWS, SIDE = 64, 9, 34
MOVED = {3: (20, 12), 4: (22, 30), 7: (18, 40)}  # view -> row and column of what passes
TALL, WIDE = 30, 12
RED = (220, 40, 30)


@pytest.fixture(scope="module")
def wall():
    """A wall of coloured discs, two units ahead."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(-2.4, 2.4, SIDE), np.linspace(-2.4, 2.4, SIDE))
    count = x.size
    scales = np.tile(np.log([0.08, 0.08, 0.005]), (count, 1))
    colors = np.repeat(np.repeat(rng.uniform(-1.2, 1.2, (SIDE // 2, SIDE // 2, 3)), 2, 0), 2, 1)
    return gsut.Gaussians(
        np.stack([x, y, np.full_like(x, 2.0)], axis=2).reshape(-1, 3).astype(np.float32),
        np.tile([1.0, 0, 0, 0], (count, 1)), scales, np.full(count, 4.0),
        colors.reshape(-1, 1, 3),
    )  # fmt: skip


def make_pose(view):
    """Makes the pose of a view in a row of places before the wall."""
    pose = np.eye(4)
    pose[:3, 3] = [0.12 * (view - VIEWS // 2), 0.05 * (view % 3), 0.0]
    return pose


def write_views(folder, wall, moved):
    """Writes views of the wall from a row of places; somebody passes in those of `moved`."""
    frames, lens = [], pinhole(SIZE)
    (folder / "images").mkdir(parents=True)
    for view in range(VIEWS):
        pose = make_pose(view)
        image = gsut.render(wall, lens, pose).image
        picture = np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)
        if view in moved:
            row, column = moved[view]
            picture[row : row + TALL, column : column + WIDE] = RED
        path = folder / "images" / f"{view:03d}.png"
        write_picture(path, picture[..., ::-1])
        frames.append(Frame(path.stem, path, lens, invert_pose(pose)))
    grey = np.full((len(wall.means), 3), 128, np.uint8)
    (folder / "points3D.ply").write_bytes(format_points_ply(wall.means, grey))
    write_transforms(folder / "transforms.json", frames, points_file="points3D.ply")
    return load_dataset(folder, test_every=0)


@pytest.mark.parametrize(("most", "fewest"), [(6, 3), (8, 1)])
def test_medians_of_what_others_show_are_those_of_numpy(rng, most, fewest):
    lens, pose = pinhole(SIZE), np.eye(4)
    rays, _ = lens.rays()
    distances = rng.uniform(2, 3, (SIZE, SIZE))
    looks = [
        (
            np.where(rng.random((SIZE, SIZE)) < share, distances, np.inf).astype(np.float32),
            rng.normal(size=(SIZE, SIZE, 9)).astype(np.float32),
        )
        for share in (1.0, *np.full(8, 0.4))
    ]
    views = [(lens, pose, *look) for look in looks]
    points = (rays * distances[..., None]).reshape(-1, 3)
    found = _core.compare_shown(points, views, 0.01, most, fewest)
    there = np.array([np.isfinite(near).reshape(-1) for near, _ in looks])
    there &= np.cumsum(there, axis=0) <= most
    shown = np.array([values.reshape(-1, 9) for _, values in looks])
    middle = np.nanmedian(np.where(there[..., None], shown, np.nan), axis=0)
    off = np.abs(shown[..., :3] - middle[:, :3]).mean(axis=2)
    spread = np.nanmedian(np.where(there, off, np.nan), axis=0)
    enough = there.sum(axis=0) >= fewest
    assert np.array_equal(found[2], there.sum(axis=0))
    assert enough.mean() > 0.5 and enough.all() == (fewest == 1)  # the first shows every point
    assert set(found[2]) == set(range(1, most + 1))
    np.testing.assert_array_equal(found[0], np.where(enough[:, None], middle, 0))
    np.testing.assert_allclose(found[1], np.where(enough, spread, 0), atol=tolerances.FLOAT32)


def measure_recall(found, moved=MOVED):
    """Share of what passes that is found, and of other pixels that are taken for it."""
    hit, wrong = [], []
    for view in range(VIEWS):
        truth = np.zeros((SIZE, SIZE), bool)
        if view in moved:
            row, column = moved[view]
            truth[row : row + TALL, column : column + WIDE] = True
        mask = found.scale_mask(view, SIZE, SIZE)
        mask = np.zeros((SIZE, SIZE), bool) if mask is None else mask
        hit.append((mask & truth).sum() / max(1, truth.sum()))
        wrong.append((mask & ~truth).mean())
    return np.mean([hit[view] for view in moved]), max(wrong)


def test_movers_finds_what_passes_and_nothing_where_nothing_does(wall, tmp_path):
    still = write_views(tmp_path / "still", wall, {})
    assert Movers.find(wall, still, range(VIEWS)).masks == {}
    scene = write_views(tmp_path / "moved", wall, MOVED)
    found = Movers.find(wall, scene, range(VIEWS))
    recall, wrong = measure_recall(found)
    assert sorted(found.masks) == sorted(MOVED)
    assert recall > tolerances.MOVERS_RECALL and wrong < tolerances.MOVERS_WRONG


def test_movers_finds_all_of_what_stays_in_the_middle(wall, tmp_path, monkeypatch):
    stays = {view: (16 + 4 * (view % 3), 24 + 4 * (view * 2 % 3)) for view in range(VIEWS)}
    scene = write_views(tmp_path / "stays", wall, stays)
    recall, wrong = measure_recall(Movers.find(wall, scene, range(VIEWS)), stays)
    assert recall > tolerances.MOVERS_RECALL and wrong < tolerances.MOVERS_WRONG
    monkeypatch.setattr("gsut.training.photograph.movers._grow", lambda found, *_: found)
    without = measure_recall(Movers.find(wall, scene, range(VIEWS)), stays)[0]
    assert 1 - recall < (1 - without) / 2


@pytest.mark.parametrize(("contradicting", "grows"), [(30, True), (5, False)])
def test_misfit_is_a_mover_where_enough_of_it_contradicts_the_others(contradicting, grows):
    misfit, found = np.zeros((2, SIZE, SIZE), np.float32)
    misfit[10:20, 10:20], found[10:13, 10:13] = 0.5, 1
    weights = np.where(misfit > 0, -movers._CONTRADICTS, np.float32(0))
    inside = np.argwhere(misfit > 0)[:contradicting]
    weights[tuple(inside.T)] += 1
    look = SimpleNamespace(misfit=misfit, mask=np.ones((SIZE, SIZE), bool))
    assert movers._grow(found > 0, look, weights)[15, 15] == grows


def test_training_leaves_movers_out_and_says_so(wall, tmp_path):
    write_views(tmp_path / "data", wall, MOVED)
    scene, out = load_dataset(tmp_path / "data", test_every=4), tmp_path / "run"
    options = gsut.TrainOptions(steps=60, max_gaussians=1200, test_every=4)
    metrics = gsut.train(scene, options, out=out, progress=False).metrics
    assert any("moved past" in reason for reason in metrics["verdict"]["reasons"])
    assert scene.test_indices == (0, 4, 8)
    moving = [row["moving"] > 0 for row in metrics["views"]]
    assert moving == [False, True, False]
    run = RunFolder.open(out)
    _, own, gaussians = read_trained(run, None)
    find_moving = find_run_movers(run, gaussians, own, own.test_indices, None)
    again = evaluate(gaussians, own, own.test_indices, find_moving=find_moving)
    assert [row["moving"] > 0 for row in again["views"]] == moving
    assert metrics["moving_train"] > tolerances.MOVERS_SHARE


@pytest.mark.parametrize(
    ("row", "patch", "outside"), [(30, 0.25, 0.9), (0, 0.0, 0.6)], ids=["in it", "in the sky"]
)
def test_wrong_patch_is_that_of_movers_only_beside_them(row, patch, outside):
    wrong, moved = np.zeros((2, SIZE, SIZE), bool)
    wrong[32:, 32:], moved[row : row + 9, 40:50] = True, True
    rows = [{"wrong_patch": wrong, "patch": 0.25, "detail": 0.6, "detail_outside": 0.9}] * 2
    figures = _summarize_patches(rows, (3, 4), Movers({3: moved, 4: moved}))
    assert figures == {"patch_train": patch, "detail_outside_train": outside}


def test_movers_survive_a_checkpoint(wall, tmp_path):
    scene = write_views(tmp_path / "data", wall, MOVED)
    options = gsut.TrainOptions(steps=40, max_gaussians=600)
    loop, other = TrainingLoop(scene, options), TrainingLoop(scene, options)
    loop.outliers.movers = Movers.find(wall, scene, range(VIEWS))
    write_checkpoint(tmp_path / "state.npz", loop.state_dict())
    other.load_state_dict(read_checkpoint(tmp_path / "state.npz"))
    assert sorted(other.outliers.movers.masks) == sorted(MOVED)
    for view, mask in loop.outliers.movers.masks.items():
        assert np.array_equal(mask, other.outliers.movers.masks[view])


def test_refinement_compares_no_pixel_that_moved(wall, tmp_path):
    scene = write_views(tmp_path / "data", wall, {})
    options = gsut.TrainOptions(steps=40, max_gaussians=600, refine_poses=True)
    loop, passing = TrainingLoop(scene, options), np.zeros((SIZE, SIZE), bool)
    passing[10:50, 20:40] = True
    level = loop.views.select_level(1.0)
    for moving, is_left in ((None, True), (passing, False)):
        loop.outliers.movers = Movers({} if moving is None else {3: moving})
        chosen = loop.refiner._sample_view(level, 3, 20, 0)[2]
        assert len(chosen) and passing.ravel()[chosen].any() == is_left
