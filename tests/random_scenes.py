"""Seeded scenes for tests: a small camera of every lens, poses, Gaussians that they see."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

import gsut
from gsut import _core

# A panorama of few pixels has tiles that span a hemisphere, which the tiled path refuses; images
# that reach beyond this angle from the axis (radians) get three times the pixels.
_PANORAMA_ANGLE = 2.0
# One lens of each family: perspective, fisheye by a polynomial, rational, panorama, splined, and
# without one centre. Formulas, domains and files of all lenses are tested in lens/.
FAMILIES = (
    *("pinhole", "kannala_brandt", "opencv8", "equirectangular", "splined_stereographic"),
    "cahvore",
)


def list_models() -> list[str]:
    """Lists the lenses for loops over renders and commands: FAMILIES, all with GSUT_EVERY_LENS."""
    return list(gsut.lens.camera_models() if os.environ.get("GSUT_EVERY_LENS") else FAMILIES)


def list_isas() -> list[str]:
    """Lists the instruction sets for loops: the best and the least, all with GSUT_EVERY_LENS."""
    available = gsut.machine.available_isas()
    chosen = available if os.environ.get("GSUT_EVERY_LENS") else (available[0], available[-1])
    assert chosen  # so that no loop over them runs over nothing
    return list(dict.fromkeys(chosen))


@functools.cache
def _is_panorama(model: str, example: int) -> bool:
    camera = _shrink(model, example, 48)
    rays, valid = camera.rays()
    return bool(np.arccos(rays[valid][:, 2].min()) > _PANORAMA_ANGLE)


def _shrink(model: str, example: int, width: int) -> gsut.Camera:
    _, params, full_width, full_height = _core.camera_examples(model)[example]
    whole = gsut.Camera(model, params, full_width, full_height)
    return whole.resize(width, max(1, round(full_height * width / full_width)))


def small_camera(model: str, example: int = 0, width: int = 48) -> gsut.Camera:
    """An example lens of a model, its image shrunk to `width` pixels: the field of view stays."""
    return _shrink(model, example, 3 * width if _is_panorama(model, example) else width)


def every_lens(width: int = 48) -> list[tuple[str, gsut.Camera]]:
    """(name, small camera) of each example of each central lens of `list_models`."""
    cameras = [
        (f"{model}[{example}]", small_camera(model, example, width))
        for model in list_models()
        for example in range(len(_core.camera_examples(model)))
    ]
    central = [(name, camera) for name, camera in cameras if camera.is_central]
    assert len(central) >= 5  # so that no loop over them runs over nothing
    return central


def rng_of(name: str) -> np.random.Generator:
    """Seeded by a name, so that what one lens draws does not depend on the others."""
    return np.random.default_rng([20260821, *name.encode()])


def fisheye(width: int = 48, height: int | None = None, degrees: float = 190.0) -> gsut.Camera:
    """An equidistant fisheye whose circle fills the image's width."""
    height = width if height is None else height
    focal = width / np.radians(degrees)
    params = [focal, focal, width / 2, height / 2]
    return gsut.Camera(
        "kannala_brandt", params, width, height, valid_field_angle=np.radians(degrees) / 2
    )


def pinhole(width: int = 48, height: int | None = None, focal: float | None = None) -> gsut.Camera:
    """A pinhole with its principal point in the middle; 53 degrees wide by default."""
    height = width if height is None else height
    focal = float(width) if focal is None else focal
    return gsut.Camera("pinhole", [focal, focal, width / 2, height / 2], width, height)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    """(4, 4) camera_from_world: any rotation, centre within a few units of the origin."""
    return gsut.exp_pose(np.concatenate([rng.normal(size=3), rng.uniform(-2, 2, 3)]))


def roll(pose: np.ndarray, twist: Sequence[float] = (0.02,) * 6) -> gsut.CameraMotion:
    """A camera that moves by a twist, about this pose, while its image is read top to bottom."""
    start, end = (gsut.exp_pose(sign * np.array(twist) / 2) @ pose for sign in (-1, 1))
    return gsut.CameraMotion(start, end, gsut.Shutter("top_to_bottom"))


def gaussians_in_view(
    rng: np.random.Generator,
    camera: gsut.Camera,
    camera_from_world: np.ndarray,
    count: int,
    *,
    sh_degree: int = 1,
    distances: tuple[float, float] = (1.0, 6.0),
    sizes: tuple[float, float] = (0.02, 0.2),
    aspect: float = 0.5,
    opacity: float = 0.0,
) -> gsut.Gaussians:
    """Float32 Gaussians on rays of the camera's valid pixels.

    Args:
        distances: range of the distance from the camera, world units, uniform in its logarithm.
        sizes: range of the standard deviations over the distance, likewise.
        aspect: standard deviation of the logarithm of each axis about the Gaussian's size.
        opacity: mean of the opacity logits (standard deviation 1.5).
    """
    rays, valid = camera.rays()
    pixels = rng.integers(int(valid.sum()), size=count)
    starts = 0.0 if camera.is_central else camera.origins()[valid][pixels]
    chosen = rays[valid][pixels] + 0.02 * rng.normal(size=(count, 3))
    distance = np.exp(rng.uniform(*np.log(distances), count))
    size = distance * np.exp(rng.uniform(*np.log(sizes), count))
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    sh = 0.3 * rng.normal(size=(count, (sh_degree + 1) ** 2, 3))
    sh[:, 0] += 0.5
    arrays = (
        (starts + chosen * distance[:, None] - translation) @ rotation,
        rng.normal(size=(count, 4)) * np.exp(rng.normal(size=(count, 1))),
        np.log(size)[:, None] + aspect * rng.normal(size=(count, 3)),
        opacity + 1.5 * rng.normal(size=count),
        sh,
    )
    return gsut.Gaussians(*(array.astype(np.float32) for array in arrays))


def blob(
    mean: Sequence[float] = (0.0, 0.0, 2.0),
    scale: float | Sequence[float] = 0.3,
    opacity: float = 0.6,
    color: Sequence[float] = (1.0, 0.5, 0.25),
    quat: Sequence[float] = (1.0, 0, 0, 0),
) -> gsut.Gaussians:
    """One Gaussian; `scale` one number or three."""
    return gsut.Gaussians(
        np.array([mean], np.float32), np.array([quat], np.float32),
        np.log(np.broadcast_to(np.asarray(scale, np.float64), (1, 3))),
        np.array([np.log(opacity / (1 - opacity))]),
        (np.array([[color]]) - 0.5) * np.sqrt(4 * np.pi),
    )  # fmt: skip


def joined(*parts: gsut.Gaussians) -> gsut.Gaussians:
    """All Gaussians of several sets."""
    names = [field.name for field in dataclasses.fields(gsut.Gaussians)][:5]
    return gsut.Gaussians(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def random_gaussians(
    rng: np.random.Generator, count: int, coefficients: int = 4, dtype: type = np.float32
) -> gsut.Gaussians:
    """Of normal numbers, with scales of about a seventh of a unit."""
    return gsut.Gaussians(
        rng.normal(size=(count, 3)).astype(dtype),
        rng.normal(size=(count, 4)).astype(dtype),
        (rng.normal(size=(count, 3)) * 0.5 - 2).astype(dtype),
        rng.normal(size=count).astype(dtype),
        rng.normal(size=(count, coefficients, 3)).astype(dtype),
    )


def arrays_of(g: gsut.Gaussians) -> list[bytes]:
    """The bits of all arrays."""
    return [getattr(g, field.name).tobytes() for field in dataclasses.fields(g)]


def assert_same(found: gsut.Gaussians, expected: gsut.Gaussians) -> None:
    """Equal values in all arrays."""
    for field in dataclasses.fields(expected):
        np.testing.assert_array_equal(
            getattr(found, field.name), getattr(expected, field.name), err_msg=field.name
        )


def no_gaussians(sh_degree: int = 0) -> gsut.Gaussians:
    """None at all."""
    k = (sh_degree + 1) ** 2
    shapes = ((0, 3), (0, 4), (0, 3), (0,), (0, k, 3))
    return gsut.Gaussians(*(np.zeros(shape, np.float32) for shape in shapes))


def random_weights(
    rng: np.random.Generator, camera: gsut.Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """dimage (H, W, 3), dalpha and ddepth (H, W) of a loss that is linear in all three."""
    size = (camera.height, camera.width)
    return rng.normal(size=(*size, 3)), rng.normal(size=size), 0.3 * rng.normal(size=size)


def loss_of(result: gsut.Render, weights: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """sum(dimage * image) + sum(dalpha * alpha) + sum(ddepth * depth)."""
    dimage, dalpha, ddepth = weights
    return float(
        np.sum(dimage * result.image)
        + np.sum(dalpha * result.alpha)
        + np.sum(ddepth * result.depth)
    )


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """|found - expected| / |expected| (Euclidean), 0 where both are 0."""
    difference = np.linalg.norm(np.asarray(found, np.float64) - expected)
    size = np.linalg.norm(expected)
    return float(difference / size) if size > 0 else float(difference)


def open_rule():
    """No cut-offs, which central differences would see."""
    rule = gsut.BlendRule()
    rule.alpha_min, rule.transmittance_min = 1e-30, 0.0
    return rule


def central_differences(
    loss: Callable[[], float],
    array: np.ndarray,
    indices: Iterable[int] | None = None,
    step: float = 1e-5,
) -> np.ndarray:
    """Differentiates `loss` with respect to flat entries of an array that it reads.

    Returns:
        The slopes of the entries `indices`, or, in the shape of `array`, those of all entries.
    """
    slopes = []
    for index in range(array.size) if indices is None else indices:
        kept, sides = array.flat[index], []
        for sign in (1, -1):
            array.flat[index] = kept + sign * step
            sides.append(loss())
        array.flat[index] = kept
        slopes.append((sides[0] - sides[1]) / (2 * step))
    return np.array(slopes).reshape(array.shape if indices is None else -1)


def pose_differences(
    loss: Callable[[np.ndarray], float], pose: np.ndarray, step: float = 1e-5
) -> np.ndarray:
    """(6,) slopes of a loss of a pose with respect to a twist of it from the left."""
    twist = np.zeros(6)
    return central_differences(lambda: loss(gsut.exp_pose(twist) @ pose), twist, step=step)


def pair_differences(
    loss: Callable[[tuple[np.ndarray, np.ndarray]], float], pair: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """(2, 6) slopes of a loss of a moving camera with respect to its start and its end."""
    start, end = pair
    return np.stack(
        [pose_differences(lambda near: loss((near, end)), start),
         pose_differences(lambda near: loss((start, near)), end)]
    )  # fmt: skip


def hold_to_differences(
    g: gsut.Gaussians,
    camera: gsut.Camera,
    place: Any,
    weights: tuple[np.ndarray, np.ndarray, np.ndarray],
    bound: float,
    *,
    entries: np.random.Generator | None = None,
    **options: Any,
) -> int:
    """Holds the double reference's gradients, to the Gaussians and the pose, to differences.

    Args:
        place: a pose or, with a shutter, a pair.
        bound: relative error of each array.
        entries: draws 32 of an array's entries; None: all of them.

    Returns:
        How many entries were compared.
    """
    moved, compared = g.copy(), 0

    def loss(at: Any = place) -> float:
        return loss_of(gsut.render(moved, camera, at, dtype="float64", **options), weights)

    result = gsut.render(g, camera, place, dtype="float64", **options)
    found = gsut.render_backward(result, *weights)
    for name in g.list_arrays():
        slopes, array = getattr(found.gaussians, name).ravel(), getattr(moved, name)
        chosen = np.arange(array.size) if entries is None else entries.permutation(array.size)[:32]
        error = relative_error(slopes[chosen], central_differences(loss, array, chosen))
        assert error < bound, (name, error)
        compared += len(chosen)
    differences = pair_differences if isinstance(place, tuple) else pose_differences
    assert relative_error(found.pose, differences(loss, place)) < bound
    return compared


def subtract_poses(one, other):
    """Returns (6,) the change of centre (world axes) and small rotation vector (camera axes)."""
    turn = one[:3, :3] @ other[:3, :3].T
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    centers = [-pose[:3, :3].T @ pose[:3, 3] for pose in (one, other)]
    return np.concatenate([centers[0] - centers[1], vector / 2])
