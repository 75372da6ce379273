"""A run in blocks that is larger than the free memory: eval, render and view look at it alike."""

import json
import shutil

import numpy as np
import pytest

import gsut
from gsut.cli import main
from gsut.formats.ply import _OF_FREE
from gsut.gaussians import StoredGaussians, stored
from gsut.run import RunFolder
from gsut.training import open_trained
from gsut.view import Session, open_stage
from stored_reads import count_reads

COUNT = 6000
ENOUGH = 10**9  # bytes of memory
MEMORY = 2_200_000  # of the 2.4 MB that these take


@pytest.fixture(scope="module")
def grown(finished, tmp_path_factory):
    """The finished run, with more and smaller Gaussians."""
    run = tmp_path_factory.mktemp("grown") / "run"
    shutil.copytree(finished / "run", run)
    rng = np.random.default_rng(20261122)
    g = gsut.Gaussians(
        rng.uniform(-2.0, 2.0, (COUNT, 3)), rng.standard_normal((COUNT, 4)),
        rng.uniform(-5.0, -4.0, (COUNT, 3)), rng.uniform(-1.0, 3.0, COUNT),
        0.5 * rng.standard_normal((COUNT, 4, 3)),
    ).to_dtype(np.float32)  # fmt: skip
    gsut.formats.save_ply(run / "scene.ply", g[StoredGaussians.order_rows(g)])
    return run


@pytest.fixture
def run(grown, monkeypatch):
    monkeypatch.setattr(stored, "_ROWS", 16)  # pieces as small as this scene is
    monkeypatch.setattr(stored, "_CHANGE_BYTES", 0)
    return grown


@pytest.fixture
def reads(monkeypatch):
    """Rows of each reading from the file."""
    return count_reads(monkeypatch)


@pytest.fixture
def give(monkeypatch):
    """Sets the bytes of memory that Gaussians may take."""

    def set_limit(limit):
        monkeypatch.setattr("gsut.formats.ply.free_memory", lambda: limit / _OF_FREE)

    return set_limit


def test_eval_has_the_same_figures(run, reads, give, capsys):
    told = []
    for limit in (ENOUGH, MEMORY):
        give(limit)
        assert main(["eval", str(run), "--json", "--split", "all"]) == 0
        told.append(json.loads(capsys.readouterr().out))
        for row in (told[-1], *told[-1]["views"]):
            del row["render_ms"]
    assert told[0] == told[1]
    assert len(reads) >= len(told[0]["views"])
    assert max(reads) < told[0]["num_gaussians"] == COUNT


@pytest.mark.parametrize("size", ["40x40", "32x32"])  # the second is coarser than the photographs
def test_render_writes_the_same_pictures(run, reads, give, tmp_path, size):
    flags = ["render", str(run), "--path", "test", "--size", size]
    assert main([*flags, "-o", str(tmp_path / "whole")]) == 0
    assert not reads
    give(MEMORY)
    assert main([*flags, "-o", str(tmp_path / "stored")]) == 0
    assert reads
    names = sorted(path.name for path in (tmp_path / "whole").glob("*.png"))
    assert len(names) == 2
    for name in names:
        pictures = [(tmp_path / kind / name).read_bytes() for kind in ("whole", "stored")]
        assert pictures[0] == pictures[1]


def test_view_draws_the_same_frames_and_refuses_what_needs_all(run, reads, give):
    sessions = []
    for limit in (ENOUGH, MEMORY):
        give(limit)
        sessions.append(Session(open_stage(run)))
    pose = open_trained(RunFolder.open(run), None)[1].views[3].camera_from_world
    frame = {"pose": pose.ravel().tolist(), "lens": 0, "width": 40, "height": 40, "quality": None}
    for case in ({}, {"mode": "distance"}):
        replies = [session.draw_frame({**frame, **case}) for session in sessions]
        assert replies[0].content == replies[1].content
    assert len(reads) >= 2
    assert sessions[1].draw_frame({**frame, "share": 0.5}).content  # all of them: no half is known
    with pytest.raises(gsut.InputError, match="needs all 6,000 Gaussians"):
        sessions[1].draw_frame({**frame, "mode": "centers"})
