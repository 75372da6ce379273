"""Public functions name an argument of a wrong kind in one sentence, not where it first fails."""

import importlib
import inspect

import numpy as np
import pytest

import gsut
from public_names import list_public_names
from random_scenes import fisheye, gaussians_in_view, rng_of

FUNCTIONS = {
    f"{module}.{name}": function
    for module, names in list_public_names().items()
    for name in names
    if inspect.isfunction(function := getattr(importlib.import_module(module), name))
    and inspect.signature(function).parameters
}
CAMERA = fisheye()
GAUSSIANS = gaussians_in_view(rng_of("kinds"), CAMERA, np.eye(4), 20)
IMAGES = [np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)] * 2
SCENE = gsut.scene_from_arrays(IMAGES, CAMERA, [np.eye(4)] * 2)
# Function -> arguments that it takes; each is replaced by each wrong one.
GOOD = {
    gsut.render: {
        "gaussians": GAUSSIANS, "camera": CAMERA, "camera_from_world": np.eye(4), "shutter": None,
        "background": None, "order": None, "response": None, "sh_degree": 3,
        "unscented": (1.0, 2.0, 0.0), "features": None, "blend": None, "dtype": "float32",
    },
    gsut.project: {
        "gaussians": GAUSSIANS, "camera": CAMERA, "camera_from_world": np.eye(4),
        "method": "unscented", "unscented": (1.0, 2.0, 0.0),
    },
    gsut.scene_from_arrays: {
        "images": IMAGES, "cameras": CAMERA, "camera_from_world": [np.eye(4)] * 2, "points": None,
        "masks": None, "names": None, "test_every": 0, "test_names": None,
    },
    gsut.compact: {
        "gaussians": GAUSSIANS, "keep": 0.5, "method": "ghap", "seed": 0, "scores": None,
    },
    gsut.Shutter: {"direction": "global"},
    gsut.set_num_threads: {"num_threads": 0},
}  # fmt: skip
WRONG = (
    float("nan"), -1, 1e30, "x", b"x", 1j, object(), {}, [], [1, 2], np.full((4, 4), np.nan),
)  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_function_of_a_wrong_kind_names_its_argument(name):
    needed = [
        each.name
        for each in inspect.signature(FUNCTIONS[name]).parameters.values()
        if each.default is each.empty
    ]
    with pytest.raises(ValueError, match=r"\A.+\Z"):  # one line
        FUNCTIONS[name](**dict.fromkeys(needed, object()))


@pytest.mark.filterwarnings("ignore:of [0-9]+ Gaussians:RuntimeWarning")
@pytest.mark.parametrize("function", GOOD, ids=lambda function: function.__name__)
def test_public_function_with_one_wrong_argument_takes_it_or_says_so_in_one_line(function):
    threads, refused = gsut.num_threads(), 0
    for name in GOOD[function]:
        for wrong in WRONG:
            try:
                function(**GOOD[function] | {name: wrong})
            except ValueError as error:
                assert "\n" not in str(error), (name, wrong)
                refused += 1
    gsut.set_num_threads(threads)
    assert refused >= 5 * len(GOOD[function])


def test_an_error_that_no_argument_causes_stays():
    def fail(*_):
        raise AttributeError("of its own")

    with pytest.raises(AttributeError, match="of its own"):
        gsut.evaluate(GAUSSIANS, SCENE, [0], on_view=fail)


def test_write_png_of_values_that_are_no_pixels_is_refused(tmp_path):
    for wrong in (np.full((4, 4), np.nan), np.zeros((4, 4, 2), np.uint8)):
        with pytest.raises(gsut.InputError, match="image must be"):
            gsut.write_png(tmp_path / "wrong.png", wrong)
