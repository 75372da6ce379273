"""Commands that work on a dataset's poses check it before they spend time; --force goes on."""

import argparse
import importlib

import numpy as np
import pytest

import gsut
from gsut.check import Finding, dataset
from gsut.cli import build_parser, list_commands, main
from rendered_dataset import write_dataset

# Words of each command, and what it spends its time in.
COMMANDS = {
    "train": ("train DATA -o OUT", "gsut", "train"),
    "train, poses refined": ("train DATA -o OUT --refine-poses", "gsut", "train"),
    "train, in blocks": ("train DATA -o OUT --blocks 2", "gsut", "train_blocks"),
    "depth": ("depth DATA -o OUT", "gsut.surface.stereo", "find_depth_maps"),
}


class SpentError(Exception):
    """Time would be spent now; no error of the user's, so that `main` raises it."""


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checked")
    data = write_dataset(folder / "data", np.random.default_rng(20260821))
    return {"DATA": str(data)}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_contradiction_stops_the_command_before_it_spends_time(
    name, places, tmp_path, monkeypatch, capsys
):
    line, module, spends = COMMANDS[name]
    for key, value in (*places.items(), ("OUT", str(tmp_path / "out"))):
        line = line.replace(key, value)
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
    assert "note: data: the photographs contradict it; they are refined by tracks" in said
    assert "error:" not in said


def test_the_table_has_every_command_that_can_be_forced():
    found = set()
    for name in list_commands():
        action = build_parser([name])._subparsers._group_actions[0]
        assert isinstance(action, argparse._SubParsersAction)
        if "--force" in action.choices[name]._option_string_actions:
            found.add(name)
    assert found == {name.split(",")[0] for name in COMMANDS}
