"""The folder of a run: atomic writes, exact checkpoints, history, refusals."""

import json
import math
import os

import numpy as np
import pytest

import gsut
from gsut import InputError
from gsut.output_folder import MARKER
from gsut.run import TrainOptions
from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.run.folder import RunFile, RunFolder

OPTIONS_OF_RUN = TrainOptions(steps=100)


def state_of_training(rng: np.random.Generator, rows: int = 50) -> dict:
    special = np.array([np.nan, -0.0, np.inf, 5e-324], np.float64)
    return {
        "means": rng.standard_normal((rows, 3)).astype(np.float32),
        "special": special,
        "empty": np.zeros((0, 4), np.float32),
        "adam": {"m": [rng.standard_normal(rows), rng.integers(0, 9, rows)], "step": 7},
        "seconds": 0.1 + 0.2,
        "largest": 2**64 - 1,
        "scalar": np.float32(1 / 3),
        "name": "a.b",
        "nothing": None,
        "a.b": np.arange(2),
        "a": {"b": np.arange(3)},
    }


def assert_same_bits(found, expected):
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key in expected:
            assert_same_bits(found[key], expected[key])
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_same_bits(one, other)
    elif isinstance(expected, (np.ndarray, np.generic)):
        assert type(found) is type(expected)
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        assert found.tobytes() == expected.tobytes()
    else:
        assert type(found) is type(expected)
        assert found == expected


def test_checkpoint_of_any_state_is_read_back_exact_to_the_bit(tmp_path, rng):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    state = state_of_training(rng)
    run.save_checkpoint(40, state)
    step, found = run.load_checkpoint()
    assert step == 40
    assert_same_bits(found, state)


def test_entries_of_a_checkpoint_are_read_without_the_others(tmp_path):
    path = tmp_path / "c.npz"
    write_checkpoint(path, {"count": 3, "own": {"means": np.full(1000, 7.25)}, "b": [np.arange(2)]})
    data = bytearray(path.read_bytes())
    data[data.find(np.float64(7.25).tobytes() * 10) + 20] ^= 1  # which reading the array finds out
    path.write_bytes(data)
    assert read_checkpoint(path, ("count", "absent")) == {"count": 3}
    np.testing.assert_array_equal(read_checkpoint(path, ("b",))["b"][0], [0, 1])
    with pytest.raises(InputError, match="not a complete checkpoint"):
        read_checkpoint(path, ("own",))


def test_checkpoint_that_is_absent_is_none(tmp_path):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    assert run.load_checkpoint() is None


@pytest.mark.parametrize("value", [object(), {1: 2}, np.array([object()]), 1j])
def test_checkpoint_of_a_value_that_cannot_be_kept_is_refused(tmp_path, value):
    with pytest.raises(TypeError, match="checkpoint entry"):
        write_checkpoint(tmp_path / "c.npz", {"value": value})


def test_checkpoint_when_writing_fails_keeps_the_one_before(tmp_path, rng, monkeypatch):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    run.save_checkpoint(1, {"a": np.arange(3)})

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(InputError, match=r"cannot write .*checkpoint.npz: No space left"):
        run.save_checkpoint(2, {"a": np.arange(4)})
    monkeypatch.undo()
    assert run.load_checkpoint()[0] == 1
    assert sorted(p.name for p in run.path.iterdir()) == [
        RunFile.CHECKPOINT,
        MARKER,
        RunFile.OPTIONS,
    ]


def test_create_in_a_folder_with_a_run_refuses_and_changes_nothing(tmp_path):
    for name in (RunFile.SCENE, RunFile.OPTIONS, RunFile.METRICS, RunFile.CHECKPOINT):
        path = tmp_path / name.replace(".", "_")
        path.mkdir()
        (path / name).write_text("precious")
        with pytest.raises(InputError, match=rf"other than gsut wrote \({name}\)"):
            RunFolder.create(path, OPTIONS_OF_RUN)
        assert [p.name for p in path.iterdir()] == [name]
        assert (path / name).read_text() == "precious"


def test_create_where_a_file_stands_says_so(tmp_path):
    (tmp_path / "run").write_text("")
    with pytest.raises(InputError, match="is a file"):
        RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    with pytest.raises(InputError, match="is a file"):
        RunFolder(tmp_path / "run").refuse_run()


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write into any folder"
)
def test_create_in_a_folder_that_is_not_writable_says_so(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match=r"cannot make the folder .*Permission denied"):
        RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)


def test_resume_with_other_options_names_the_difference(tmp_path):
    path = tmp_path / "run"
    RunFolder.create(path, OPTIONS_OF_RUN)
    with pytest.raises(InputError, match="started with seed = 0, not 3"):
        RunFolder.create(path, TrainOptions(steps=100, seed=3), resume=True)
    RunFolder.create(path, TrainOptions(steps=100, threads=2, checkpoint_every=9), resume=True)
    assert RunFolder.open(path).read_options().threads == 2


def test_resume_keeps_the_environment_of_the_first_start(tmp_path):
    path = tmp_path / "run"
    RunFolder.create(path, OPTIONS_OF_RUN, environment={"command": "first"})
    RunFolder.create(path, OPTIONS_OF_RUN, resume=True, environment={"command": "second"})
    assert RunFolder.open(path).read_json(RunFile.ENVIRONMENT) == {"command": "first"}


def test_resume_removes_unfinished_files(tmp_path):
    path = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN).path
    (path / f".writing-1-{RunFile.CHECKPOINT}").write_bytes(b"half")
    RunFolder.create(path, OPTIONS_OF_RUN, resume=True)
    assert sorted(p.name for p in path.iterdir()) == [MARKER, RunFile.OPTIONS]


def test_resume_without_a_run_begins_one(tmp_path):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN, resume=True)
    assert run.read_options() == OPTIONS_OF_RUN


def test_resume_where_the_options_are_gone_is_refused_and_changes_nothing(tmp_path):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    run.save_checkpoint(3, {})
    (run.path / RunFile.OPTIONS).unlink()
    with pytest.raises(InputError, match=r"options\.json is absent, so nobody knows how"):
        RunFolder.create(run.path, OPTIONS_OF_RUN, resume=True)
    assert sorted(p.name for p in run.path.iterdir()) == [RunFile.CHECKPOINT, MARKER]


def test_history_after_a_crash_is_rolled_back_to_the_checkpoint(tmp_path):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    for step in range(1, 6):
        run.history.append({"step": step, "loss": np.float32(0.5)})
    run.save_checkpoint(3, {})
    with open(run.path / RunFile.HISTORY, "a") as file:
        file.write('{"step": 6, "lo')  # torn by the crash
    run.load_checkpoint()
    run.history.append({"step": 4})
    assert [row["step"] for row in run.history.read()] == [1, 2, 3, 4]


def test_history_without_a_checkpoint_begins_again(tmp_path):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN)
    run.history.append({"step": 1})
    run.load_checkpoint()
    assert run.history.read() == []


def test_json_of_numpy_values_and_non_finite_numbers_is_valid(tmp_path):
    run = RunFolder.create(tmp_path / "run", OPTIONS_OF_RUN, environment={"isa": "AVX2"})
    value = {"a": np.float32(0.5), "b": math.nan, "c": [np.int64(3), math.inf], "d": np.arange(2)}
    run.write_json(RunFile.METRICS, value)
    text = (run.path / RunFile.METRICS).read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": 0.5, "b": None, "c": [3, None], "d": [0, 1],
    }  # fmt: skip
    assert run.read_json(RunFile.ENVIRONMENT) == {"isa": "AVX2"}
    assert run.read_json("absent.json") is None


@pytest.mark.parametrize(
    ("make", "said"),
    [(lambda path: None, "no such folder"), (lambda path: path.mkdir(), "holds no run")],
)
def test_open_without_a_run_says_so(tmp_path, make, said):
    make(tmp_path / "run")
    with pytest.raises(InputError, match=said):
        RunFolder.open(tmp_path / "run")


def test_resumed_run_with_another_instruction_set_is_refused_or_warned_of(tmp_path):
    here = gsut.machine.available_isas()
    if len(here) == 1:
        pytest.skip("this build is for one instruction set")
    create = RunFolder.create
    run = create(tmp_path / "run", OPTIONS_OF_RUN, environment={"isa": here[0]})
    for other in here[1:]:
        del run
        with pytest.raises(InputError, match=f"set GSUT_ISA={here[0]}, or start a new run"):
            create(tmp_path / "run", OPTIONS_OF_RUN, resume=True, environment={"isa": other})
        run = create(tmp_path / "run", OPTIONS_OF_RUN, resume=True, environment={"isa": here[0]})
    run.write_json(RunFile.ENVIRONMENT, {"isa": "future"})
    with pytest.warns(RuntimeWarning, match="instruction set future, not .* machine lacks it"):
        create(tmp_path / "run", OPTIONS_OF_RUN, resume=True, environment={"isa": here[0]})
