"""The public names: every one has help of its own, and its repr fits a line."""

import importlib
import inspect
import re

import numpy as np
import pytest

import gsut
from public_names import list_public_names
from random_scenes import fisheye, gaussians_in_view

PUBLIC = list_public_names()
NAMES = [
    f"{module}.{name}"
    for module, names in PUBLIC.items()
    for name in names
    if callable(getattr(importlib.import_module(module), name))
]
# A description that is a reference to another docstring: "camera: as for `render`."
REFERENCE = re.compile(r"^\s+[\w, ]+: (as|see) (for |in )?`?[\w.]+`?[.;]", re.MULTILINE)


def own_doc(member) -> str:
    return inspect.cleandoc(
        (vars(member).get("__doc__") if inspect.isclass(member) else member.__doc__) or ""
    )


def takes_and_gives(function) -> tuple[bool, bool]:
    """Whether a function has arguments and returns something, by its signature."""
    if inspect.isbuiltin(function):  # pybind11 writes the signature as the first line
        head = function.__doc__.splitlines()[0]
        return "()" not in head, not head.endswith("-> None")
    signature = inspect.signature(function)
    return bool(signature.parameters), signature.return_annotation not in (None, "None")


@pytest.mark.parametrize("name", NAMES)
def test_public_name_has_help_of_its_own(name):
    module, _, short = name.rpartition(".")
    member = getattr(importlib.import_module(module), short)
    doc = own_doc(member)
    text = doc.partition("\n")[2] if inspect.isbuiltin(member) else doc
    assert len(text) > 40
    assert REFERENCE.findall(text) == []
    if not inspect.isclass(member):
        takes, gives = takes_and_gives(member)
        assert ("\nArgs:\n" in text, "\nReturns:\n" in text) == (takes, gives)
        return
    if not issubclass(member, Exception):
        assert "\nArgs:\n" in text or "\nAttributes:\n" in text
    for part, value in vars(member).items():
        if not part.startswith("_") and (callable(value) or isinstance(value, property)):
            assert (value.__doc__ or "").strip(), f"{name}.{part} has no docstring"


def test_public_names_are_listed_once_and_exist():
    listed = [name for names in PUBLIC.values() for name in names]
    assert len(set(listed)) == len(listed) >= 110
    assert len(gsut.__all__) <= 67
    for module, names in PUBLIC.items():
        assert [name for name in names if not hasattr(importlib.import_module(module), name)] == []


def test_reprs_fit_a_line(tmp_path):
    camera, pose = fisheye(), np.eye(4)
    gaussians = gaussians_in_view(np.random.default_rng(0), camera, pose, 20)
    rendered = gsut.render(gaussians, camera, pose)
    found = [
        repr(gaussians),
        repr(rendered),
        repr(gsut.render_backward(rendered, rendered.image, with_lens=True)),
        repr(gsut.project(gaussians, camera, pose)),
        repr(gsut.View("images/0001.png", tmp_path / "0001.png", 0, pose)),
        repr(gsut.poses.RefinedPose(pose, np.eye(6), 1.0, 0.0, 0.01, True)),
    ]
    assert [text for text in found if "\n" in text or len(text) > 120 or "array" in text] == []
    assert found[0] == "Gaussians(20, sh_degree=1, float32, 0.0 MB)"
