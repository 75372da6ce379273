"""Arguments of gsplat's functions: what each camera of a batch is, and what is refused and why."""

from __future__ import annotations

import dataclasses
import functools
import importlib.metadata
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from gsut import BlendRule, Camera, InputError, Shutter
from gsut.torch.lenses import find_model, make_params
from gsut.torch.views import View

APIS = ("1.4", "1.5", "1.6")
MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED", "d", "Ed", "RGB-d", "RGB-Ed")
# gsplat's numbers of rolling shutters, and ours.
_SHUTTERS = ("top_to_bottom", "left_to_right", "bottom_to_top", "right_to_left", None)
_SHUTTER_NAMES = {
    "ROLLING_TOP_TO_BOTTOM": 0,
    "ROLLING_LEFT_TO_RIGHT": 1,
    "ROLLING_BOTTOM_TO_TOP": 2,
    "ROLLING_RIGHT_TO_LEFT": 3,
    "GLOBAL": 4,
}
FULL_DEGREE = 3  # of harmonics that the engine shades by itself
# Arguments of `rasterization` that are refused unless they have the value here, and why.
_REFUSED: dict[str, tuple[Any, str]] = {
    "rasterize_mode": ("classic", "antialiased belongs to the 2D kernels; use classic"),
    "sparse_grad": (False, "gradients are dense; use sparse_grad=False and a dense optimizer"),
    "absgrad": (False, "means2d has no absolute gradient; use DefaultStrategy(absgrad=False)"),
    "distributed": (False, "one process renders; gsut train --cluster shares a scene"),
    "covars": (None, "rays meet Gaussians of quats and scales; give these"),
    "rays": (None, "rays are the lens'; camera= takes any lens of gsut"),
    "lidar_coeffs": (None, "there is no spinning lidar; camera= takes any lens of gsut"),
    "external_distortion_coeffs": (None, "there is no windshield; camera= takes a splined lens"),
}


@dataclasses.dataclass(frozen=True)
class Place:
    """Where one camera of a batch is, and the tensors that it sees.

    Attributes:
        index: of the camera in the batch.
        scene: means, quats, scales and opacities.
        pose: (4, 4).
        pose_end: (4, 4) at the end of a rolling shutter.
        lens: (K,) parameters.
    """

    index: tuple[int, ...]
    scene: tuple[torch.Tensor, ...]
    pose: torch.Tensor
    pose_end: torch.Tensor | None
    lens: torch.Tensor


@dataclasses.dataclass(frozen=True)
class Lenses:
    """The lenses of a batch of cameras, of one model.

    Attributes:
        camera_model: gsplat's name.
        matrices: [..., C, 3, 3] Ks.
        coefficients: radial, tangential and thin-prism, [..., C, n] each.
        ftheta: gsplat's object of F-theta coefficients.
        camera: a lens of gsut in place of all of these.
        camera_params: (K,) or [..., C, K], its parameters; None: its own.
    """

    camera_model: str
    matrices: torch.Tensor | None
    coefficients: tuple[torch.Tensor | None, ...]
    ftheta: Any = None
    camera: Camera | None = None
    camera_params: torch.Tensor | None = None

    @functools.cached_property
    def model(self) -> str:
        """Our name of the model."""
        if self.camera is not None:
            return self.camera.model
        return find_model(self.camera_model, any(c is not None for c in self.coefficients))

    def make_params(self, index: tuple[int, ...]) -> torch.Tensor:
        """Makes the parameters (K,) of one camera.

        Raises:
            InputError: as of `lenses.make_params`, and without Ks.
        """
        if self.camera is not None:
            params = self.camera_params
            if params is None:
                return torch.tensor(self.camera.params.tolist(), dtype=torch.float64)
            return params if params.ndim == 1 else params[index]
        if self.matrices is None:
            raise InputError("Ks is None: give it, or camera=")
        radial, tangential, prism = (None if c is None else c[index] for c in self.coefficients)
        matrix = self.matrices[index]
        return make_params(self.model, matrix, radial, tangential, prism, self.ftheta)


def make_view(
    lenses: Lenses, width: int, height: int, near_plane: float, far_plane: float,
    rolling_shutter: Any, global_z_order: bool, sh_degree: int | None = None,
) -> View:  # fmt: skip
    """Makes what all cameras of a batch share: lens model, size, rules and shutter."""
    rule = BlendRule("gsplat")
    rule.near_z, rule.far_z = near_plane, far_plane
    rule.order = "z" if global_z_order else "distance"
    direction = _SHUTTERS[_read_shutter(rolling_shutter)]
    return View(
        lenses.model, width, height, rule,
        FULL_DEGREE if sh_degree is None else min(sh_degree, FULL_DEGREE),
        None if direction is None else Shutter(direction, "gsplat"),
        None if lenses.camera is None else lenses.camera.valid_field_angle,
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Cameras:
    """A batch of cameras [..., C] of one lens model and size, and the scenes that they see.

    Attributes:
        view: what they share.
        scene: means, quats, scales and opacities, [...] scenes of each.
        viewmats: [..., C, 4, 4].
        viewmats_rs: [..., C, 4, 4] at the end of a rolling shutter.
        lenses: of each.
    """

    view: View
    scene: tuple[torch.Tensor, ...]
    viewmats: torch.Tensor
    viewmats_rs: torch.Tensor | None
    lenses: Lenses

    def __post_init__(self) -> None:
        given = tuple(self.viewmats.shape)
        if len(given) < 3 or given[-2:] != (4, 4):
            raise InputError(
                f"viewmats has shape {given}, expected (..., C, 4, 4); of one camera give "
                "viewmats[None] and Ks[None]"
            )
        matrices = self.lenses.matrices
        if matrices is not None and tuple(matrices.shape) != (*self.lead, 3, 3):
            raise InputError(
                f"Ks has shape {tuple(matrices.shape)}, expected {(*self.lead, 3, 3)}, one for "
                "each camera; of one camera give Ks[None]"
            )

    @property
    def lead(self) -> tuple[int, ...]:
        """(..., C), how the cameras are arranged."""
        return (*self.scene[0].shape[:-2], self.viewmats.shape[-3])

    def __iter__(self) -> Iterator[Place]:
        """Yields the cameras, batches of scenes outermost."""
        ends = self.viewmats_rs if self.view.shutter is not None else None
        for index in np.ndindex(*self.lead):
            yield Place(
                index,
                tuple(t[index[:-1]] for t in self.scene) if len(index) > 1 else self.scene,
                self.viewmats[index],
                None if ends is None else ends[index],
                self.lenses.make_params(index),
            )

    def freeze(self) -> Cameras:
        """Returns the same without gradients, which no optimizer's step changes."""
        params = self.lenses.camera_params
        lenses = dataclasses.replace(
            self.lenses, matrices=_freeze(self.lenses.matrices),
            coefficients=tuple(_freeze(c) for c in self.lenses.coefficients),
            camera_params=_freeze(params),
        )  # fmt: skip
        scene = tuple(t.detach().clone() if t.is_leaf else t.detach() for t in self.scene)
        ends = _freeze(self.viewmats_rs)
        viewmats = self.viewmats.detach().clone()
        return Cameras(self.view, scene, viewmats, ends, lenses)


def _freeze(tensor: torch.Tensor | None) -> torch.Tensor | None:
    return None if tensor is None else tensor.detach().clone()


def refuse(render_mode: str, **values: Any) -> None:
    """Refuses arguments that are not supported, each by its name and with the reason.

    Raises:
        InputError: the first of them.
    """
    for name, value in values.items():
        expected, reason = _REFUSED[name]
        if value is not None and value is not False and value != expected:
            raise InputError(f"{name} is not supported by gsut.torch.rasterization: {reason}")
    if render_mode not in MODES:
        known = ", ".join(MODES)
        raise InputError(f'render_mode "{render_mode}" is not supported; known: {known}')


@functools.cache
def warn_of_3d() -> None:
    """Warns, once, that the 2D approximation is not made."""
    warnings.warn(
        "gsut evaluates Gaussians in 3D along each ray (with_ut=True, with_eval3d=True): the 2D "
        "approximation, with its eps2d, is not made",
        RuntimeWarning,
        stacklevel=3,
    )


def _read_shutter(rolling_shutter: Any) -> int:
    name = getattr(rolling_shutter, "name", None)
    number = _SHUTTER_NAMES.get(name, -1) if name is not None else rolling_shutter
    if number not in range(len(_SHUTTERS)):
        raise InputError(f"rolling_shutter {rolling_shutter} is unknown; known: 0 to 4")
    return int(number)


@functools.lru_cache(maxsize=len(APIS) + 1)
def read_api(api: str | None) -> str:
    """Reads the version of gsplat; None: the one that is installed, else the newest known.

    Raises:
        InputError: an unknown one.
    """
    if api is None:
        try:
            api = ".".join(importlib.metadata.version("gsplat").split(".")[:2])
        except importlib.metadata.PackageNotFoundError:
            return APIS[-1]
        return min(max(api, APIS[0]), APIS[-1])
    if api not in APIS:
        raise InputError(f'api "{api}" is unknown; known: {", ".join(APIS)}')
    return api


def choose_colors(
    colors: torch.Tensor | None, is_sh: bool, index: tuple[int, ...], lead: tuple[int, ...],
    name: str = "colors",
) -> torch.Tensor | None:  # fmt: skip
    """Chooses one camera's colours: shared by all, one set a scene, or one a camera.

    Raises:
        InputError: a shape that fits no batch of this size.
    """
    if colors is None:
        return None
    extra = colors.ndim - (3 if is_sh else 2)  # dimensions before one set's own
    if extra == 0:
        return colors
    if extra == len(lead) - 1 and tuple(colors.shape[:extra]) == lead[:-1]:
        return colors[index[:-1]]
    if extra == len(lead) and tuple(colors.shape[:extra]) == lead:
        return colors[index]
    raise InputError(f"{name} has shape {tuple(colors.shape)}, which fits no batch of this size")
