"""Commands that work on a dataset's poses check it before they spend time; --force goes on."""

import argparse
import importlib
import json

import numpy as np
import pytest

import gsut
import small_run
from gsut.check import Finding, dataset
from gsut.cli import build_parser, list_commands, main
from gsut.cli._flags import keep_findings
from gsut.run import RunFile
from rendered_dataset import write_dataset

# Words of each command, and what it spends its time in.
COMMANDS = {
    "train": ("train DATA -o OUT", "gsut", "train"),
    "train, poses refined": ("train DATA -o OUT --refine-poses", "gsut", "train"),
    "train, in blocks": ("train DATA -o OUT --blocks 2", "gsut", "train_blocks"),
    "depth": ("depth DATA -o OUT", "gsut.surface.stereo", "find_depth_maps"),
}

# The same of commands that trust the poses and the lens of a finished run.
OF_RUNS = {
    "eval": ("eval RUN", "gsut.cli.eval", "_measure_run"),
    "localize": ("localize DATA/images/0.png --run RUN", "gsut.refine", "localize"),
    "mesh": ("mesh RUN -o OUT.ply", "gsut.surface", "extract_mesh"),
    "lift": ("lift DATA RUN MAPS -o OUT.npz", "gsut.lifting", "lift"),
    "compact": ("compact RUN -o OUT --keep 0.5", "gsut.training.tuning", "RunCompactor"),
}
WARNING = Finding("warning", "transforms.json", "two poses are far from the others", "mend them")


class SpentError(Exception):
    """Time would be spent now; no error of the user's, so that `main` raises it."""


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checked")
    data = write_dataset(folder / "data", np.random.default_rng(20260821))
    return {"DATA": str(data)}


def fill_places(line, places, folder):
    """Writes the paths of data and results into a command."""
    for key, value in (*places.items(), ("OUT", str(folder / "out"))):
        line = line.replace(key, value)
    return line


@pytest.mark.parametrize("name", COMMANDS)
def test_a_contradiction_stops_the_command_before_it_spends_time(
    name, places, tmp_path, monkeypatch, capsys
):
    line, module, spends = COMMANDS[name]
    line = fill_places(line, places, tmp_path)
    looked = []

    def contradict(scene, evidence):
        looked.append(len(scene))
        return [Finding("error", str(scene.path), "the photographs contradict the poses", "mend")]

    def spend(*_, **__):
        raise SpentError

    monkeypatch.setattr(dataset, "check_photographs", contradict)
    monkeypatch.setattr(importlib.import_module(module), spends, spend)
    assert main(line.split()) == 2
    said = capsys.readouterr().err
    assert "contradict the poses; mend" in said and "--force goes on as it is" in said
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(SpentError):
        main([*line.split(), "--force"])
    assert looked == [len(gsut.load_dataset(places["DATA"]))] * 2


@pytest.mark.parametrize(
    ("flag", "mended"), [("--refine-poses", {"poses"}), ("--refine-lens", {"poses", "lens"})]
)
@pytest.mark.parametrize("subject", ["poses", "lens", ""])
def test_an_error_that_refinement_may_mend_is_a_note(
    flag, mended, subject, places, tmp_path, monkeypatch, capsys
):
    def contradict(scene, evidence):
        return [Finding("error", "data", "the photographs contradict it", "mend", subject)]

    def spend(*_, **__):
        raise SpentError

    monkeypatch.setattr(dataset, "check_photographs", contradict)
    monkeypatch.setattr(gsut, "train", spend)
    words = ["train", places["DATA"], "-o", str(tmp_path / "out"), flag]
    if subject not in mended:
        assert main(words) == 2
        return
    with pytest.raises(SpentError):
        main(words)
    said = capsys.readouterr().err
    assert "note: data: the photographs contradict it; that is refined by tracks" in said
    assert "error:" not in said


def test_the_table_has_every_command_that_can_be_forced():
    found = set()
    for name in list_commands():
        action = build_parser([name])._subparsers._group_actions[0]
        assert isinstance(action, argparse._SubParsersAction)
        if "--force" in action.choices[name]._option_string_actions:
            found.add(name)
    assert found == {name.split(",")[0] for name in COMMANDS}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_warning_of_the_doctor_is_shown_before_the_command_spends_time(
    name, places, tmp_path, monkeypatch, capsys
):
    line, module, spends = COMMANDS[name]
    line = fill_places(line, places, tmp_path)
    monkeypatch.setattr(dataset, "check_photographs", lambda *_: [WARNING])
    monkeypatch.setattr(importlib.import_module(module), spends, spend)
    for words, shown in (([], True), (["--quiet"], False)):
        with pytest.raises(SpentError):
            main([*line.split(), *words])
        assert (f"gsut: {WARNING}\n" in capsys.readouterr().err) == shown


def spend(*_, **__):
    raise SpentError


@pytest.mark.parametrize("name", OF_RUNS)
def test_a_run_shows_what_the_doctor_said_of_its_data(name, tmp_path, monkeypatch, capsys):
    scene = small_run.scene_from_arrays(tmp_path / "data")
    small_run.install(monkeypatch, scene)
    run = small_run.finished_run(tmp_path / "run", scene, report=False)
    maps = tmp_path / "maps"
    maps.mkdir()
    for view in scene.views:
        np.save(maps / f"{view.name.split('/')[1][:-4]}.npy", np.zeros((32, 32, 2)))
    line, module, spends = OF_RUNS[name]
    for key, value in {"RUN": "run", "DATA": "data", "OUT": "out", "MAPS": "maps"}.items():
        line = line.replace(key, str(tmp_path / value))
    monkeypatch.setattr(importlib.import_module(module), spends, spend)
    looked = []
    monkeypatch.setattr(
        importlib.import_module("gsut.check"), "check_scene",
        lambda scene: looked.append(scene) or [WARNING],
    )  # fmt: skip
    for _ in range(2):  # made now, then as training has kept them
        with pytest.raises(SpentError):
            main(line.split())
        assert f"gsut: {WARNING}\n" in capsys.readouterr().err
        keep_findings(run, [WARNING])
    assert len(looked) == 1
    kept = json.loads((run.path / RunFile.FINDINGS).read_text())["findings"]
    assert [Finding(**each) for each in kept] == [WARNING]


def test_a_depth_file_that_training_would_stop_at_is_found_before_the_first_step(
    tmp_path, monkeypatch, capsys
):
    data = write_dataset(tmp_path / "data", np.random.default_rng(20261128))
    file = data / "transforms.json"
    values = json.loads(file.read_text())
    values["frames"][-1]["depth_file_path"] = "depth.npy"
    file.write_text(json.dumps(values))
    (data / "depth.npy").write_bytes(b"damaged")
    monkeypatch.setattr(importlib.import_module("gsut.train"), "TrainingLoop", spend)
    line = ["train", str(data), "-o", str(tmp_path / "out"), "--steps", "2", "--force"]
    for more in ([], ["--surface"]):
        assert main([*line, *more]) == 2
        assert "depth.npy" in capsys.readouterr().err
    main(["doctor", str(data)])
    said = capsys.readouterr().out
    assert any("depth.npy" in row and "training stops there" in row for row in said.splitlines())
    del values["frames"][-1]["depth_file_path"]
    file.write_text(json.dumps(values))
    with pytest.raises(SpentError):
        main(line)
