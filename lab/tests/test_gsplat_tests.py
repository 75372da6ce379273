"""The run of gsplat's own tests, by a stand-in of its repository."""

import pytest

from lab.gsplat_tests import copy_tests, describe, find_tests, judge_failure, main
from torch_or_skip import import_torch

import_torch()

PACKAGE = """
import sys, types
__version__ = "1.6.0"
def rasterization(*_, **__): raise AssertionError("not patched")
def has_3dgut(): return False
"""
TESTS = """
import gsplat, pytest, torch
device = torch.device("cuda:0")
def draw(**options):
    n = 10_000
    assert n == 300 and str(device) == "cpu"
    return gsplat.rasterization(
        torch.rand(n, 3), torch.rand(n, 4), torch.rand(n, 3), torch.rand(n), torch.rand(n, 3),
        torch.eye(4)[None], torch.eye(3)[None] * 8, 16, 16, with_ut=True, with_eval3d=True,
        packed=False, **options)
@pytest.mark.skipif(not torch.cuda.is_available(), reason="No CUDA device")
@pytest.mark.skipif(not gsplat.has_3dgut(), reason="not built")
def test_shape():
    assert draw()[0].shape == (1, 16, 16, 3)
def test_refused():
    draw(absgrad=True)
def test_wrong():
    assert draw()[0].shape == (2, 16, 16, 3)
@pytest.mark.skip(reason="lidar")
def test_lidar():
    pass
"""


@pytest.fixture
def checkout(tmp_path):
    for file, text in {"gsplat/__init__.py": PACKAGE, "tests/core/test_strategy.py": TESTS}.items():
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text(text)
    return tmp_path


def test_gsplats_tests_run_on_the_cpu_and_are_counted_with_reasons(checkout, capsys):
    assert main([str(checkout)]) == 1  # one of them is wrong
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["test_strategy", "3", "1", "1", "1", "1"]
    assert any(line.startswith("refused 1: absgrad is not supported") for line in lines)
    assert any(line.startswith("failed 1: ") for line in lines)
    assert "skipped 1: lidar" in lines


def test_folder_without_gsplats_tests_is_refused_with_what_is_expected(checkout, tmp_path):
    assert find_tests(checkout) == checkout / "tests" / "core"
    assert [path.name for path in copy_tests(checkout, tmp_path / "copy")] == ["test_strategy.py"]
    with pytest.raises(SystemExit, match="no gsplat/__init__"):
        find_tests(checkout / "tests")
    (checkout / "tests" / "core" / "test_strategy.py").unlink()
    with pytest.raises(SystemExit, match="has none of test_basic"):
        find_tests(checkout)


def test_operators_of_gsplats_library_are_refused_and_other_failures_are_not():
    cases = {
        "AttributeError: '_OpNamespace' 'gsplat' object has no attribute 'x'": "refused",
        "gsut._core.InputError: gsplat's isect_tiles needs CUDA": "refused",
        "AssertionError: No CUDA GPUs are available": "refused",
        "AssertionError: Tensor-likes are not close!": "failed",
    }
    assert {text: judge_failure(text)[0] for text in cases} == cases
    assert describe([]).startswith("file")
