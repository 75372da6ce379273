"""Training in blocks: the same bits however it runs and is broken off, bounds, and what it says."""

import dataclasses
import json
import os
import re
import shutil
import signal

import numpy as np
import pytest

import gsut
from folder_snapshot import take_snapshot
from gsut.blocks import workers
from gsut.blocks.layout import Layout
from gsut.blocks.plan import (
    check_memory,
    choose_count,
    estimate_total_bytes,
    make_block_options,
    make_block_recipe,
)
from gsut.cli import main
from gsut.run import RunFolder, format_size, read_checkpoint
from small_blocks import OPTIONS, same_bits, states, train


@pytest.fixture
def scene(finished):
    return gsut.load_dataset(finished / "data")


def test_training_in_blocks_writes_one_scene(finished):
    out = finished / "run"
    metrics = json.loads((out / "metrics.json").read_text())
    blocks = metrics["blocks"]
    layout = Layout.read(str(out / "blocks/layout.json"))
    assert blocks["count"] == 3 == len(layout) == len(blocks["rows"])
    assert sum(row["gaussians"] for row in blocks["rows"]) == metrics["num_gaussians"]
    gaussians = gsut.formats.load_ply(out / "scene.ply").with_origin((0, 0, 0))
    assert metrics["num_gaussians"] == len(gaussians) == 400
    owners = layout.find_owners(gaussians.means.astype(float))
    assert np.bincount(owners).tolist() == [row["gaussians"] for row in blocks["rows"]]
    assert blocks["pixels"] > blocks["coarse"]["pixels"] > 0
    stages = ["coarse", "layout", "tasks 1", "round 1", "tasks 2", "round 2", "measure"]
    assert list(json.loads((out / "blocks/stages.json").read_text())) == stages
    assert blocks["stages"]["round 1"] > 0
    report = (out / "report.html").read_text()
    assert "3 blocks in 2 rounds" in report
    assert metrics["psnr"] > 15
    history = RunFolder(out).history.read()
    assert len(history) == 2
    assert history[1]["psnr"] > 15


def test_second_round_trains_odd_blocks_among_what_even_ones_have_become(finished):
    folder = finished / "run/blocks"

    def rows(block, file, *keys):
        content = read_checkpoint(folder / f"b{block:03d}/{file}.npz")
        return {row.tobytes() for key in keys for row in content[key]["means"]}

    seen = [rows(block, "task2", "own", "context") for block in (0, 1)]
    assert rows(1, "state1", "own") <= seen[0]
    assert rows(0, "state2", "own") <= seen[1]
    assert not rows(0, "state1", "own") <= seen[1]


def test_regularisers_pull_at_a_gaussian_as_in_one_training():
    """They are means: over fewer Gaussians each would be pulled at the harder."""
    pulls = [
        make_block_recipe(make_block_options(OPTIONS, 1.0, most), most / 400).regularizer / most
        for most in (400, 100, 25)
    ]
    assert pulls[0] == OPTIONS.recipe.regularizer / 400
    np.testing.assert_allclose(pulls[1:], [pulls[0]] * 2, rtol=1e-15)


def test_workers_that_are_killed_give_the_same_bits(scene, finished, tmp_path, monkeypatch):
    killed = []
    tell = workers.Workers.run

    def run(self, jobs, report):
        def kill_now_and_then(job, message):
            if message.get("segment") == 3 and not killed:
                killed.append(message["process"])
                os.kill(message["process"], signal.SIGKILL)
            report(job, message)

        tell(self, jobs, kill_now_and_then)

    monkeypatch.setattr(workers.Workers, "run", run)
    train(scene, tmp_path / "run", workers=2)
    assert len(killed) == 1
    assert same_bits(finished / "run", tmp_path / "run")


def test_run_that_was_broken_off_goes_on_to_the_same_bits(scene, finished, tmp_path, monkeypatch):
    out, count = tmp_path / "run", 0
    write = workers.write_state

    def stop_at_the_eleventh(path, state):
        nonlocal count
        count += 1
        if count == 11:
            raise KeyboardInterrupt
        return write(path, state)

    monkeypatch.setattr(workers, "write_state", stop_at_the_eleventh)
    with pytest.raises(KeyboardInterrupt):
        train(scene, out)
    monkeypatch.undo()
    assert not (out / "metrics.json").exists()
    assert "loop" in read_checkpoint(states(out)[-1])  # in the middle of a block
    monkeypatch.setattr("gsut.training.record.results.write_report", lambda *_: None)
    assert main(["train", str(scene.path), "-o", str(out), "--resume", "--quiet"]) == 0
    assert same_bits(finished / "run", out)


def test_block_that_nothing_shows_is_kept_as_it_is(scene, tmp_path, monkeypatch):
    layout = Layout({"axis": 0, "at": 1e6, "below": None, "above": None})
    monkeypatch.setattr("gsut.blocks.stages.cut_scene", lambda *_: layout)
    result = train(scene, tmp_path / "run", "2")
    rows = result.metrics["blocks"]["rows"]
    assert [row["steps"] for row in rows] == [60, 0]
    assert rows[1]["gaussians"] == 0


def test_worker_that_always_dies_ends_the_run_with_a_sentence(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(workers.sys, "executable", "/bin/false")
    with pytest.raises(gsut.InputError, match=r"ended 3 times .* --resume"):
        train(scene, tmp_path / "run", workers=2)


def test_what_a_worker_refuses_is_said_here(scene, finished, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(finished / "run", out)
    for state in states(out):
        state.unlink()
    damaged = out / "blocks/b001/task1.npz"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    with pytest.raises(gsut.InputError, match=re.escape(str(damaged))):
        train(scene, out, resume=True, workers=2)


def test_resumed_run_keeps_its_division(scene, finished):
    with pytest.raises(gsut.InputError, match="blocks 3, not 4"):
        train(scene, finished / "run", blocks="4", resume=True)
    plan = finished / "run/blocks/plan.json"
    text = plan.read_text()
    for name, other in (("isa", "none"), ("version", "0.0")):
        plan.write_text(json.dumps(json.loads(text) | {name: other}))
        with pytest.raises(gsut.InputError, match=f"started with {name} {other}"):
            train(scene, finished / "run", resume=True)
    plan.write_text(text)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"robust": True}, "--robust"),
        ({"surface": True}, "--surface"),
        ({"strategy": "mini"}, "strategy=mini"),
        ({"order": "ray"}, "--order ray"),
    ],
)
def test_options_that_are_not_there_for_blocks_are_refused(scene, tmp_path, given, words):
    options = dataclasses.replace(OPTIONS, **given)
    with pytest.raises(gsut.InputError, match=f"{words} cannot be combined with --blocks"):
        gsut.train_blocks(scene, options, out=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_memory_decides_the_number_of_blocks_and_refuses_what_does_not_fit(scene):
    many = dataclasses.replace(OPTIONS, max_gaussians=10_000_000)
    counts = {}
    for memory in ("64GB", "8GB", "2GB"):
        options = gsut.BlockOptions("auto", memory=memory)
        counts[memory] = choose_count(scene, many, options)
        assert estimate_total_bytes(scene, many, options, counts[memory]) <= options.parse_memory()
    assert counts["64GB"] == 1 < counts["8GB"] < counts["2GB"]
    pair = gsut.BlockOptions("auto", memory="8GB", workers=2)
    assert choose_count(scene, many, pair) > counts["8GB"]
    with pytest.raises(gsut.InputError, match="--memory 160 MB: even blocks of"):
        choose_count(scene, many, gsut.BlockOptions("auto", memory="160MB"))
    with pytest.raises(gsut.InputError, match=r"block 1 takes about 5 GB, times 2 workers"):
        check_memory({"block 0": 10**9, "block 1": 5 * 10**9}, pair)
    assert format_size(1234567) == "1.23 MB"


def test_run_killed_before_its_first_step_goes_on_to_the_same_bits(
    scene, finished, tmp_path, monkeypatch
):
    def stop(*_):
        raise KeyboardInterrupt

    out = tmp_path / "run"
    monkeypatch.setattr(RunFolder, "write_text", stop)  # all but the folder of the blocks
    with pytest.raises(KeyboardInterrupt):
        train(scene, out)
    monkeypatch.undo()
    assert [path.name for path in (out / "blocks").iterdir()] == ["plan.json"]
    monkeypatch.setattr("gsut.blocks.stages.train_coarse", stop)
    words = ["train", str(scene.path), "-o", str(out), "--resume", "--quiet"]
    assert main(words) == 130
    assert (out / "options.json").is_file()
    monkeypatch.undo()
    monkeypatch.setattr("gsut.training.record.results.write_report", lambda *_: None)
    assert main(words) == 0
    assert same_bits(finished / "run", out)


def test_run_goes_on_as_a_whole_or_in_blocks_as_it_was_begun(scene, finished, tmp_path, capsys):
    with pytest.raises(gsut.InputError, match="was started in blocks, not as a whole"):
        gsut.train(scene, OPTIONS, out=finished / "run", resume=True, progress=False)
    whole = RunFolder.create(tmp_path / "whole", OPTIONS)
    with pytest.raises(gsut.InputError, match="was started as a whole, not in blocks"):
        train(scene, whole.path, resume=True)
    words = ["train", "ds", "-o", str(whole.path), "--blocks", "2", "--resume"]
    assert main(words) == 2
    assert "was not started in blocks; leave --blocks out" in capsys.readouterr().err
    (whole.path / "blocks").mkdir()  # of a run in blocks whose plan is lost
    assert main(words) == 2
    assert "plan.json is absent or is not a file" in capsys.readouterr().err


def test_finished_run_in_blocks_stays_as_it_is(scene, finished):
    before = take_snapshot(finished / "run")
    train(scene, finished / "run", resume=True, report=True)
    assert take_snapshot(finished / "run") == before
