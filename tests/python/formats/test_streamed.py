"""Tests streamed SOG: the table against its files, and what is refused."""

import json

import numpy as np
import pytest

import gsut
from formats.scene_cases import plain_scene
from gsut import InputError
from gsut.formats import TABLE, _streamed, write_levels
from gsut.view import open_stage

COUNTS = (300, 90, 20)


@pytest.fixture
def levels(rng):
    return [plain_scene(rng, count, 4) for count in COUNTS]


@pytest.fixture
def folder(tmp_path, levels, monkeypatch):
    """Three levels and an environment, cut into several leaves and files."""
    monkeypatch.setattr(_streamed, "_LEAF", 40)
    monkeypatch.setattr(_streamed, "_CHUNK", 100)
    path = tmp_path / "levels"
    path.mkdir()
    write_levels(path, levels, (31.0, 29.0, 26.0), levels[2])
    return path


def read_table(folder):
    return json.loads((folder / TABLE).read_text())


def list_leaves(node):
    children = node.get("children")
    return [node] if children is None else [leaf for c in children for leaf in list_leaves(c)]


def test_leaves_name_each_gaussian_of_each_level_once(folder):
    table = read_table(folder)
    leaves = list_leaves(table["tree"])
    assert table["counts"] == list(COUNTS) and table["count"] == sum(COUNTS) and len(leaves) == 8
    stored = [json.loads((folder / name).read_text())["count"] for name in table["filenames"]]
    for level, count in enumerate(COUNTS):
        runs = sorted(
            (lod["file"], lod["offset"], lod["count"])
            for leaf in leaves if (lod := leaf["lods"].get(str(level)))
        )  # fmt: skip
        assert sum(number for *_, number in runs) == count
        ends = dict.fromkeys((file for file, *_ in runs), 0)
        for file, offset, number in runs:
            assert offset == ends[file]
            ends[file] += number
        assert ends == {file: stored[file] for file in ends}
        assert {table["filenames"][file].split("_")[0] for file in ends} == {str(level)}
    assert len(stored) > len(COUNTS)


def test_leaf_encloses_the_gaussians_of_all_its_levels(folder):
    table = read_table(folder)
    parts = [gsut.formats._streamed._read_members(folder / TABLE, n) for n in table["filenames"]]
    checked = 0
    for leaf in list_leaves(table["tree"]):
        low, high = (np.array(leaf["bound"][end]) for end in ("min", "max"))
        for lod in leaf["lods"].values():
            g = parts[lod["file"]].gaussians[lod["offset"] : lod["offset"] + lod["count"]]
            assert np.all((g.means > low) & (g.means < high))
            checked += len(g)
    assert checked == sum(COUNTS)


def test_folder_is_read_as_its_finest_level_with_the_environment(folder, levels):
    for path in (folder, folder / TABLE):
        assert len(gsut.load_gaussians(path)) == COUNTS[0] + COUNTS[2]
        stage = open_stage(path)
        assert stage.name == folder.name
    found = np.sort(gsut.load_gaussians(folder).means[: COUNTS[0], 0])
    span = np.ptp(levels[0].means)
    assert np.abs(found - np.sort(levels[0].means[:, 0])).max() < 1e-3 * span


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("version", 2, "streamed SOG version 2; gsut reads 1"),
        ("filenames", ["../a/meta.json"], "has to be a meta.json in a folder beside it"),
        ("filenames", ["/etc/meta.json"], "has to be a meta.json in a folder beside it"),
        ("environment", 3, "has to be a meta.json in a folder beside it"),
        ("environment", "none/meta.json", "cannot be opened"),
        ("tree", None, "damaged: tree is"),
        ("tree", {"lods": {}}, "no leaf of its tree has Gaussians of level 0"),
        ("tree", {"lods": {"0": {"file": 0, "offset": 1, "count": 5}}}, "each of them once"),
        ("tree", {"lods": {"0": {"file": 99, "offset": 0, "count": 5}}}, "a whole number from 0"),
    ],
)
def test_damaged_table_is_refused_in_a_sentence(folder, key, value, said):
    table = read_table(folder) | {key: value}
    if key == "filenames":
        table["tree"] = {"lods": {"0": {"file": 0, "offset": 0, "count": 1}}}
    (folder / TABLE).write_text(json.dumps(table))
    with pytest.raises(InputError, match=said) as refused:
        gsut.load_gaussians(folder)
    assert "\n" not in str(refused.value)
