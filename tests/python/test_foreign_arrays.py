"""Arrays of other libraries in public calls: read through the protocols they share, or refused."""

import numpy as np
import pytest

import gsut
from raising import raises_saying


class WithArray:
    """An array that only offers __array__."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values

    def __array__(self, dtype=None, copy=None):
        return self._values if dtype is None else self._values.astype(dtype)


class WithDlpack:
    """An array that only offers DLPack, as torch and jax do, from a device of a kind."""

    device = 1  # main memory

    def __init__(self, values: np.ndarray) -> None:
        self._values = values

    def __dlpack_device__(self):
        return self.device, 0

    def __dlpack__(self, **options):
        return self._values.__dlpack__()


class OnGpu(WithDlpack):
    """One whose memory the processor cannot read."""

    device = 2  # CUDA


class WithGradient(WithDlpack):
    """One that records what is done with it."""

    requires_grad = True


class OfHalfPrecision(WithArray):
    """One whose numbers numpy cannot compute with, as bfloat16."""

    def __init__(self, values: np.ndarray) -> None:
        super().__init__(np.zeros(values.shape, np.dtype("V2")))


class Traced:
    """One that has no values yet, as a jax tracer."""

    def __array__(self, dtype=None, copy=None):
        raise TypeError("has no values while it is traced\nsee elsewhere")


WRAPPERS = {
    "array": WithArray,
    "dlpack": WithDlpack,
    "read-only": lambda a: _hold_still(a.copy()),
    "fortran": np.asfortranarray,
    "strided": lambda a: np.stack([a, a], axis=-1)[..., 0],
    "float32": lambda a: a if a.dtype == np.uint8 else a.astype(np.float32),
}


def _hold_still(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


CAMERA = gsut.Camera("pinhole", [20.0, 20.0, 8.0, 6.0], 16, 12)
MEANS = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 3.0]])
QUATS = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
IMAGE = np.full((12, 16, 3), 0.25)
BYTES = np.full((12, 16, 3), 64, np.uint8)
POSE = np.eye(4)


def make_gaussians(wrap):
    arrays = (MEANS, QUATS, np.full((2, 3), -2.0), np.zeros(2), np.full((2, 1, 3), 0.5))
    return gsut.Gaussians(*(wrap(array) for array in arrays))


def render_backward(wrap):
    gaussians = make_gaussians(np.asarray)
    drawn = gsut.render(gaussians, CAMERA, POSE)
    return gsut.render_backward(drawn, wrap(IMAGE)).gaussians.means


CALLS = {
    "Gaussians": lambda wrap: make_gaussians(wrap).means,
    "Camera": lambda wrap: gsut.Camera("pinhole", wrap(np.array([20.0, 20, 8, 6])), 16, 12).params,
    "Camera.project": lambda wrap: CAMERA.project(wrap(MEANS))[0],
    "Camera.unproject": lambda wrap: CAMERA.unproject(wrap(np.array([[3.0, 4.0]])))[0],
    "render": lambda wrap: gsut.render(make_gaussians(np.asarray), CAMERA, wrap(POSE)).image,
    "background": lambda wrap: (
        gsut.render(make_gaussians(np.asarray), CAMERA, POSE, background=wrap(IMAGE)).image
    ),
    "render_backward": render_backward,
    "psnr": lambda wrap: gsut.psnr(wrap(IMAGE), IMAGE + 0.1),
    "ssim": lambda wrap: gsut.ssim(wrap(BYTES), BYTES),
    "seed_from_points": lambda wrap: gsut.seed_from_points(wrap(MEANS)).means,
    "scene_from_arrays": lambda wrap: (
        gsut.scene_from_arrays([wrap(BYTES)] * 2, CAMERA, [POSE, POSE], points=wrap(MEANS)).points
    ),
    "exp_pose": lambda wrap: gsut.exp_pose(wrap(np.zeros(6))),
}


@pytest.mark.parametrize("kind", WRAPPERS)
def test_arrays_of_other_libraries_give_what_numpy_gives(kind):
    for name, call in CALLS.items():
        expected, found = call(np.asarray), call(WRAPPERS[kind])
        # float32 of values that float32 holds exactly; the renderer draws in it
        assert np.allclose(expected, found, rtol=0, atol=1e-6 if kind == "float32" else 0), name


REFUSALS = {
    OnGpu: ("is on a device", "CUDA", ".cpu()"),
    WithGradient: ("records gradients", ".detach()"),
    OfHalfPrecision: ("dtype |V2", "float32"),
    Traced: ("TypeError: has no values while it is traced",),
}


@pytest.mark.parametrize("wrap", REFUSALS, ids=lambda wrap: wrap.__name__)
def test_arrays_that_cannot_be_read_are_refused_with_the_cure(wrap):
    for call in CALLS.values():
        with raises_saying(REFUSALS[wrap]):
            call(wrap if wrap is not Traced else lambda _: Traced())


def test_gaussians_share_the_memory_of_what_dlpack_offers():
    values = np.zeros((2, 3), np.float32)
    others = (QUATS, np.zeros((2, 3)), np.zeros(2), np.zeros((2, 1, 3)))
    gaussians = gsut.Gaussians(WithDlpack(values), *others)
    assert np.shares_memory(gaussians.means, values)


def test_png_takes_what_dlpack_offers(tmp_path):
    gsut.write_png(tmp_path / "a.png", WithDlpack(BYTES))
    gsut.write_png(tmp_path / "b.png", BYTES)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
