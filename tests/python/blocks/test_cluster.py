"""Blocks on a Ray cluster: the same bits, whatever is killed; and what a worker refuses."""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import gsut
from gsut.blocks import cluster
from gsut.blocks.segment import run_segment
from gsut.blocks.task import BlockTask, list_photographs
from gsut.run import read_checkpoint
from small_blocks import LARGE_OPTIONS, same_bits, train

SCRIPT = Path(__file__).parents[1] / "ray_runs.py"
needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed (gsut[cluster])"
)
_SECONDS = 300
KILLS = int(os.environ.get("KILLS", "2"))  # of a worker, and of a node


def on_ray(folder: Path, out: Path, case: str) -> dict:
    """What `ray_runs.py` says of a case; {} where it was killed."""
    paths = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, SCRIPT, folder / "data", out, case],
        env=os.environ | {"PYTHONPATH": paths, "RAY_USAGE_STATS_ENABLED": "0"},
        capture_output=True, text=True, timeout=_SECONDS, check=False,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else {}


@needs_ray
@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "kills"),
    [("one node", 0), ("two nodes", 0), ("worker killed", KILLS), ("node killed", KILLS)],
)
def test_cluster_gives_the_bits_of_one_machine(finished, tmp_path, case, kills):
    told = on_ray(finished, tmp_path / "run", case)
    assert told["killed"] == kills
    assert same_bits(finished / "run", tmp_path / "run")


@needs_ray
@pytest.mark.slow
def test_states_larger_than_the_object_store_give_the_same_bits(finished, tmp_path):
    scene = gsut.load_dataset(finished / "data")
    train(scene, tmp_path / "here", training=LARGE_OPTIONS)
    told = on_ray(finished, tmp_path / "there", "small store")
    print(f"states of {told['state_bytes'] / 1e6:.0f} MB")
    assert told["state_bytes"] > told["store_bytes"]
    assert same_bits(tmp_path / "here", tmp_path / "there")


@needs_ray
@pytest.mark.slow
def test_driver_that_is_killed_goes_on_from_what_came_home(finished, tmp_path):
    assert on_ray(finished, tmp_path / "run", "driver killed") == {}
    assert not (tmp_path / "run/metrics.json").exists()
    assert list(tmp_path.glob("run/blocks/b*/state1.npz"))
    assert "refused" not in on_ray(finished, tmp_path / "run", "two nodes")
    assert same_bits(finished / "run", tmp_path / "run")


@needs_ray
@pytest.mark.slow
def test_nodes_with_other_versions_are_refused(finished, tmp_path):
    told = on_ray(finished, tmp_path / "run", "mixed versions")
    assert "install the same version on all nodes" in told["refused"]
    assert not (tmp_path / "run").exists()


@pytest.fixture(scope="module")
def arguments(finished):
    """A first segment's task, paths and photographs, as a worker gets them."""
    file = finished / "run/blocks/b000/task1.npz"
    paths = list_photographs(read_checkpoint(file))
    return file.read_bytes(), paths, [Path(path).read_bytes() for path in paths]


def segment(arguments, state=None, isa=None, version=gsut.__version__):
    driver = cluster.Driver(isa or gsut.machine.active_isa(), version, 1)
    return cluster.train_segment(*arguments, state, driver)


def test_worker_gives_the_states_of_the_pure_function(arguments, finished, tmp_path):
    values = read_checkpoint(finished / "run/blocks/b000/task1.npz")
    expected = run_segment(BlockTask.from_dict(values), None, [])
    first, told = segment(arguments)
    (tmp_path / "state.npz").write_bytes(first)
    found = read_checkpoint(tmp_path / "state.npz")
    assert told["segment"] == 1 == found["segment"]
    sets = expected["loop"]["optimizer"]
    assert all((found["loop"]["optimizer"][name] == sets[name]).all() for name in sets)
    again, _ = segment(arguments, first)
    cluster._last.clear()  # another worker
    assert segment(arguments, first)[1]["step"] == 2 * told["step"]
    assert len(again) > 0


def test_worker_refuses_other_versions_and_missing_instructions(arguments):
    with pytest.raises(gsut.InputError, match=r"the driver 9\.9; install the same version"):
        segment(arguments, version="9.9")
    with pytest.raises(gsut.InputError, match="no avx1024 instructions"):
        segment(arguments, isa="avx1024")


def test_worker_without_a_disk_says_so(arguments, monkeypatch, tmp_path):
    monkeypatch.setattr(cluster, "_folder", [])
    monkeypatch.setattr(cluster, "_last", {})
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    with pytest.raises(gsut.InputError, match=r"cannot keep photographs in .*none"):
        segment(arguments)


def test_cluster_without_ray_says_what_to_install(tmp_path, monkeypatch, finished):
    monkeypatch.setitem(sys.modules, "ray", None)
    scene = gsut.load_dataset(finished / "data")
    with pytest.raises(gsut.InputError, match=r"pip install gsut\[cluster\]"):
        train(scene, tmp_path / "run", cluster="auto")
    assert not (tmp_path / "run").exists()
