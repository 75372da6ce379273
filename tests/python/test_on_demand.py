"""Public names are imported when they are asked for, and none is hidden by a folder of its name."""

import subprocess
import sys

import gsut
from gsut import _on_demand

# A process of its own: what is imported here already says nothing.
PROGRAM = """
import sys
import gsut
assert not any(name.startswith("gsut.training") for name in sys.modules)
assert set(gsut.__all__) <= set(dir(gsut))
import gsut.render
from gsut.metrics import psnr
assert gsut.psnr is psnr and callable(gsut.render) and gsut.data.Scene is gsut.Scene
assert not any(name.startswith("gsut.training") for name in sys.modules)
assert callable(gsut.train) and gsut.train is sys.modules["gsut.train"].train
"""


def test_public_names_are_imported_when_asked_for():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr


def test_a_name_that_is_not_there_is_an_attribute_error(monkeypatch):
    assert isinstance(gsut, _on_demand._Package)
    assert not hasattr(gsut, "nothing_of_this_name")
    monkeypatch.setattr(gsut, "train", len)
    assert gsut.train is len
