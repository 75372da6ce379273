"""Training on a small rendered scene: it learns, has the same bits however run, and resumes."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import gsut
from folder_snapshot import take_snapshot
from gsut import InputError, TrainOptions
from gsut.optimize import choose_view
from gsut.run.folder import RunFile
from gsut.training.first.seeding import seed_first
from gsut.training.loop import TrainingLoop
from random_scenes import arrays_of, pinhole
from rendered_dataset import VIEWS, write_dataset

STEPS = 60
SHORT = {"steps": STEPS, "max_gaussians": 150, "checkpoint_every": 5}


@pytest.fixture(scope="module")
def unbroken(scene, tmp_path_factory):
    """The run folder of SHORT, made in one go."""
    out = tmp_path_factory.mktemp("training") / "unbroken"
    train(scene, TrainOptions(**SHORT), out=out)
    return out


def train(scene, options, **arguments):
    return gsut.train(scene, options, progress=False, **arguments)


def history_of(run):
    """Rows of a run's history without what the clock says."""
    rows = [json.loads(line) for line in (run / RunFile.HISTORY).read_text().splitlines()]
    return [{key: value for key, value in row.items() if "seconds" not in key} for row in rows]


def psnr_on(scene, gaussians, indices):
    return gsut.evaluate(gaussians, scene, indices)["psnr"]


def test_train_300_steps_learns_the_scene(scene):
    options = TrainOptions(steps=300, max_gaussians=300)
    result = train(scene, options)
    start = seed_first(scene, options)
    views = scene.train_indices
    assert psnr_on(scene, result.gaussians, views) > psnr_on(scene, start, views) + 10
    assert result.metrics["psnr"] > 30
    assert result.metrics["evaluated_on"] == "test views"
    losses = [row["loss"] for row in result.history]
    assert np.mean(losses[-20:]) < 0.3 * np.mean(losses[:20])
    assert [row["step"] for row in result.history] == list(range(1, 301))
    counts = [row["num_gaussians"] for row in result.history]
    assert counts[-1] == 300 and sorted(counts) == counts
    assert [row["step"] for row in result.history if "psnr" in row] == [100, 200, 300]


def test_train_uses_harmonics_up_to_their_degree(scene):
    result = train(scene, TrainOptions(steps=120, max_gaussians=150, sh_degree=3))
    assert result.gaussians.sh.shape == (150, 16, 3)
    assert np.abs(result.gaussians.sh[:, 9:]).max() > 0  # the third degree was switched on
    assert result.metrics["psnr"] > 25


@pytest.mark.parametrize("strategy", ["mcmc", "mini"])
def test_train_any_threads_same_bits(scene, tmp_path, strategy):
    options = {**SHORT, "strategy": strategy}
    files, histories = [], []
    for threads in (1, 2, 8):
        result = train(scene, TrainOptions(**options, threads=threads))
        assert gsut.num_threads() == threads
        files.append(arrays_of(result.gaussians))
        histories.append([{**row, "seconds": 0, "cpu_seconds": 0} for row in result.history])
    assert files[1] == files[0] and files[2] == files[0]
    assert histories[1] == histories[0] and histories[2] == histories[0]


def test_train_reading_images_again_same_bits(dataset, scene, unbroken):
    # Caches of decoded images, ray tables and tiles hold nothing that later runs depend on.
    fresh = gsut.load_dataset(dataset)
    assert arrays_of(train(fresh, TrainOptions(**SHORT)).gaussians) == arrays_of(
        gsut.formats.load_ply(unbroken / RunFile.SCENE)
    )


def test_train_interrupted_within_a_step_keeps_a_scene_and_resumes_to_same_bits(
    scene, unbroken, tmp_path, monkeypatch
):
    out, stop, densify = tmp_path / "run", 33, TrainingLoop._densify

    def interrupt(loop, step):
        if step.number == stop:
            os.kill(os.getpid(), signal.SIGINT)
        densify(loop, step)

    monkeypatch.setattr(TrainingLoop, "_densify", interrupt)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs
    try:
        with pytest.raises(KeyboardInterrupt, match=f"scene after {stop} of {STEPS} steps"):
            train(scene, TrainOptions(**SHORT), out=out)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    kept = gsut.load_run(out)
    assert len(kept.gaussians) > 0 and psnr_on(scene, kept.gaussians, scene.train_indices) > 10
    monkeypatch.undo()
    train(scene, TrainOptions(**SHORT), out=out, resume=True)
    assert (out / RunFile.SCENE).read_bytes() == (unbroken / RunFile.SCENE).read_bytes()
    assert history_of(out) == history_of(unbroken)


# Trains slowly enough (a pause a step) to be killed in the middle; writes a checkpoint every step
# or two, so that kills also fall into the writing.
CHILD = """
import sys, time
import gsut
scene = gsut.load_dataset(sys.argv[1])
options = gsut.TrainOptions(steps=60, max_gaussians=150, checkpoint_every=2,
                            threads=int(sys.argv[3]))
gsut.train(scene, options, out=sys.argv[2], resume=True,
           progress=lambda row: time.sleep(0.01))
"""
KILLS = 4


def lines_of(path):
    return path.read_bytes().count(b"\n") if path.exists() else 0


def test_train_killed_by_sigkill_and_resumed_same_bits(dataset, unbroken, tmp_path, rng):
    out = tmp_path / "run"
    paths = [str(Path(gsut.__file__).parent.parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    killed = 0
    # Each time some steps further than the last kill, then a moment that no step knows of.
    for kill in range(KILLS + 1):
        arguments = [sys.executable, "-c", CHILD, str(dataset), str(out), str(1 + kill % 3)]
        child = subprocess.Popen(arguments, env=environment, stderr=subprocess.PIPE)
        before, wanted = lines_of(out / RunFile.HISTORY), int(rng.integers(4, 10))
        deadline = time.monotonic() + 60
        while kill < KILLS and child.poll() is None and time.monotonic() < deadline:
            if before + wanted <= lines_of(out / RunFile.HISTORY) < STEPS:
                time.sleep(rng.uniform(0, 0.02))
                child.send_signal(signal.SIGKILL)
                break
            time.sleep(0.002)
        _, error = child.communicate(timeout=60)
        killed += child.returncode == -signal.SIGKILL
        assert child.returncode in (0, -signal.SIGKILL), error.decode()
    assert killed == KILLS
    assert child.returncode == 0
    assert (out / RunFile.SCENE).read_bytes() == (unbroken / RunFile.SCENE).read_bytes()
    assert history_of(out) == history_of(unbroken)
    assert not list(out.glob(".writing-*"))


def test_train_resume_of_a_finished_run_changes_nothing(scene, unbroken):
    before = take_snapshot(unbroken)
    train(scene, TrainOptions(**SHORT, threads=1), out=unbroken, resume=True)
    assert take_snapshot(unbroken) == before


def advance_to(loop, step):
    while loop.step < step:
        loop.advance()
    return loop


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"strategy": "mini"},
        {"surface": True},
        {"primitive": "surfel", "surface": True},
        {"primitive": "surfel", "strategy": "mini"},
        {"primitive": "triangle"},
        {"response": "extinction"},
        {"order": "ray"},
        {"order": "z"},
    ],
    ids=lambda given: " ".join(map(str, given.values())),
)
@pytest.mark.parametrize("stop", [25, 45])
def test_train_loop_state_restored_into_a_new_loop_same_bits(scene, given, stop):
    options = TrainOptions(**{**SHORT, **given})
    recipe = dataclasses.replace(options.recipe, noise="surface" in given)
    loop, other = (TrainingLoop(scene, options, recipe=recipe) for _ in range(2))
    other.load_state_dict(advance_to(loop, stop).state_dict())
    assert other.step == stop
    losses = [(loop.advance(), other.advance()) for _ in range(STEPS - stop)]
    assert all(a == b for a, b in losses)
    whole, again = loop.make_result(), other.make_result()
    assert arrays_of(whole) == arrays_of(again)
    for rule in ("order", "response", "primitive"):
        assert getattr(again, rule) == getattr(whole, rule) == getattr(loop.gaussians, rule)


def test_every_view_is_shown_once_an_epoch():
    views = [0, 2, 3, 5, 8]
    count = len(views)
    epochs = [[choose_view(views, e * count + i + 1, 0) for i in range(count)] for e in range(3)]
    for epoch in epochs:
        assert sorted(epoch) == views
    assert epochs[0] != epochs[1]


def test_train_random_init_learns_from_nothing(tmp_path, rng):
    folder = write_dataset(tmp_path / "data", rng, with_points=False)
    scene = gsut.load_dataset(folder)
    assert len(scene.points) == 0
    options = TrainOptions(steps=300, max_gaussians=500)
    assert len(seed_first(scene, options)) == 500
    result = train(scene, options)
    assert psnr_on(scene, result.gaussians, scene.train_indices) > (
        psnr_on(scene, seed_first(scene, options), scene.train_indices) + 5
    )


def test_train_init_points_without_points_is_refused(tmp_path, rng):
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng, with_points=False))
    with pytest.raises(InputError, match="use init='random'"):
        train(scene, TrainOptions(**SHORT, init="points"))


def test_train_without_test_views_measures_training_views(tmp_path, rng):
    folder = write_dataset(tmp_path / "data", rng, with_test=False)
    scene = gsut.load_dataset(folder, test_every=0)
    assert scene.test_indices == () and len(scene.train_indices) == VIEWS
    result = train(scene, TrainOptions(**SHORT), out=tmp_path / "run")
    assert result.metrics["evaluated_on"] == "training views"
    assert result.metrics["psnr"] > 20
    assert not any("psnr" in row for row in result.history)


def are_finite(gaussians):
    names = (*gaussians.list_arrays(), "origin")
    return all(np.isfinite(getattr(gaussians, name)).all() for name in names)


def test_train_with_few_unmasked_pixels_learns_these_only(tmp_path, rng):
    mask = np.zeros((48, 48), bool)
    mask[20:23, 24:28] = True
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng, mask=mask))
    options = TrainOptions(steps=150, max_gaussians=100)
    result = train(scene, options)
    assert all(np.isfinite(row["loss"]) for row in result.history)
    assert np.mean([r["loss"] for r in result.history[-20:]]) < np.mean(
        [r["loss"] for r in result.history[:20]]
    )
    assert [view["pixels"] for view in result.metrics["views"]] == [12, 12]
    assert are_finite(result.gaussians)


def test_train_with_everything_masked_leaves_no_number_that_is_not_finite(tmp_path, rng):
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng, mask=np.zeros((48, 48), bool)))
    try:
        result = train(scene, TrainOptions(**SHORT))
    except InputError:
        return  # refused in words: as good
    assert are_finite(result.gaussians)


# Below 64 pixels no coarser level is made; 11 is the window of SSIM.
@pytest.mark.parametrize(("width", "height"), [(40, 30), (11, 11), (7, 5), (1, 1)])
def test_train_on_small_images_runs_at_full_resolution(tmp_path, rng, width, height):
    camera = pinhole(width, height)
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng, camera=camera))
    options = TrainOptions(**SHORT)
    loop = TrainingLoop(scene, options)
    assert loop.views.select_level(0.1).scene.camera(scene.train_indices[0]).width == width
    result = train(scene, options)
    assert result.metrics["psnr"] is None or np.isfinite(result.metrics["psnr"])
    assert all(np.isfinite(row["loss"]) for row in result.history)
    assert are_finite(result.gaussians)


def test_train_coarse_to_fine_uses_quarter_half_and_full_resolution(tmp_path, rng):
    camera = pinhole(256, 260)
    scene = gsut.load_dataset(write_dataset(tmp_path / "data", rng, camera=camera))
    options = TrainOptions(steps=20, max_gaussians=100)
    loop = TrainingLoop(scene, options)
    view = scene.train_indices[0]
    sizes = [loop.views.select_level(f / 20).scene.camera(view).height for f in range(1, 21)]
    assert options.recipe.coarse_to_fine == (0.2, 0.45)
    assert sizes == [65] * 4 + [130] * 5 + [260] * 11
    result = train(scene, options)
    assert len(result.history) == 20


def test_train_no_training_view_is_refused(scene):
    scene = scene.replace(train_indices=[])
    with pytest.raises(InputError, match="no training view"):
        train(scene, TrainOptions(**SHORT))


def test_train_command_scale_is_applied_once(dataset, scene, tmp_path):
    from gsut.cli import main

    out = tmp_path / "run"
    words = ["train", str(dataset), "-o", str(out), "--steps", "2", "--scale", "0.5", "--quiet"]
    assert main(words) == 0
    full = scene.cameras[0]
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["image_size"] == [[full.width // 2, full.height // 2]]
