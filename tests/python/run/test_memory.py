"""Memory is looked at before it is taken: estimates against what is free, sentences with both."""

import os
import sys

import numpy as np
import pytest

import gsut
import small_datasets
from formats.scene_cases import plain_scene
from gsut.check import refuse_too_large
from gsut.check.memory import check_memory
from gsut.cli import main
from gsut.run import check_fits, format_size, free_memory, limit_memory, memory


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    path = tmp_path_factory.mktemp("plane") / "data"
    small_datasets.write_nerfstudio(path)
    return path


@pytest.fixture
def little(monkeypatch):
    """A machine with 300 MB left."""
    for name in ("gsut.run.memory.free_memory", "gsut.check.memory.free_memory"):
        monkeypatch.setattr(name, lambda: 300_000_000)


def test_free_memory_is_that_of_the_machine_at_most():
    free = free_memory()
    assert 0 < free <= 2 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert format_size(1_234_567) == "1.23 MB"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a limit of Linux")
def test_memory_beyond_a_limit_is_refused_until_its_end():
    size = 256 << 20
    with limit_memory(size // 2), pytest.raises(MemoryError):
        np.ones(size, np.uint8)
    assert np.ones(size, np.uint8)[-1] == 1


def test_control_groups_count(tmp_path, monkeypatch):
    line = "1:name=systemd:/a\n0::/a/b\n"
    files = {
        "a/memory.max": "900", "a/memory.current": "500", "a/memory.stat": "inactive_file 30",
        "a/b/memory.max": "max",
    }  # fmt: skip
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content + "\n")
    (tmp_path / "cgroup").write_text(line)
    monkeypatch.setattr(memory, "_GROUPS", tmp_path)
    monkeypatch.setattr(memory, "_OWN_GROUPS", tmp_path / "cgroup")
    assert free_memory() == 430


def test_what_does_not_fit_is_refused_with_both_sizes(little):
    check_fits("a small thing", 299_000_000, "")
    with pytest.raises(gsut.InputError, match=r"a big thing .* 2 GB .* 300 MB are free; no"):
        check_fits("a big thing", 2e9, "no")


def test_a_render_that_cannot_fit_is_refused_before_it_is_begun(little):
    camera = gsut.Camera("pinhole", [1000, 1000, 15000, 15000], 30000, 30000)
    gaussians = plain_scene(np.random.default_rng(1), 3)
    with pytest.raises(gsut.InputError, match=r"30000 x 30000 .* 36 GB .* 300 MB are free"):
        gsut.render(gaussians, camera, np.eye(4))


def test_a_file_that_cannot_fit_is_refused_before_it_is_read(little, tmp_path):
    path = tmp_path / "huge.ply"
    with open(path, "wb") as file:
        file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nend_header\n")
        file.truncate(248_000_000_000)  # a hole
    with pytest.raises(gsut.InputError, match=r"huge\.ply takes about 248 GB .* 300 MB are free"):
        gsut.load_gaussians(path)


@pytest.mark.parametrize(
    ("words", "work"),
    [
        (["compact", "{}/in.ply", "-o", "{}/out.ply", "--keep", "0.5"], "compacting"),
        (["convert", "{}/in.ply", "{}/out.spz"], "converting"),
        (["edit", "{}/in.ply", "-o", "{}/out.ply", "--scale", "2"], "editing"),
    ],
)
def test_what_commands_need_beside_a_file_counts_before_they_begin(
    tmp_path, monkeypatch, capsys, words, work
):
    gsut.formats.save_ply(tmp_path / "in.ply", plain_scene(np.random.default_rng(1), 600))
    words = [word.format(tmp_path) for word in words]
    monkeypatch.setattr(memory, "_SMALL", 0)
    size = os.path.getsize(tmp_path / "in.ply")
    monkeypatch.setattr(memory, "free_memory", lambda: size + 1000)
    assert main(words) == 2
    assert f"{work} 600 Gaussians of degree " in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["in.ply"]
    monkeypatch.setattr(memory, "free_memory", lambda: 8 * size)
    assert main(words) == 0


def test_doctor_and_training_refuse_what_does_not_fit_in_the_same_words(little, plane):
    scene = gsut.load_dataset(plane)
    assert [found.severity for found in check_memory(scene)] == ["info"]
    many = gsut.TrainOptions(max_gaussians=5_000_000, sh_degree=3)
    (found,) = check_memory(scene, many)
    assert found.severity == "error" and "5,000,000 Gaussians of degree 3" in found.what
    with pytest.raises(gsut.InputError) as refused:
        gsut.train(scene, many, progress=False)
    assert found.what in str(refused.value) and "--max-gaussians" in str(refused.value)


@pytest.mark.parametrize("options", [{"steps": 1}, {"strategy": "mini", "steps": 500}])
def test_a_most_that_is_never_reached_refuses_nothing(little, plane, options):
    refuse_too_large(
        gsut.load_dataset(plane), gsut.TrainOptions(max_gaussians=100_000_000, **options)
    )
