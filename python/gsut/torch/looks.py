"""What `rasterization` draws of a camera: colours, depths, normals and signals, as channels."""

from __future__ import annotations

import dataclasses

import torch

from gsut import InputError
from gsut.torch.arguments import FULL_DEGREE, Place, choose_colors
from gsut.torch.functions import make_rotations
from gsut.torch.harmonics import evaluate_harmonics, find_centers
from gsut.torch.info import BatchInfo
from gsut.torch.views import View, render_view

_LEAST_ALPHA = 1e-10  # gsplat's, below which an expected depth is not divided further
_NUM_COLORS = 3  # channels of harmonics that the engine shades by itself
_SHIFT = 0.5  # what harmonics are added to
_NORMALS = "normals"  # their name in gsplat's info
_SIGNALS = "render_extra_signals"  # their name in gsplat's info


@dataclasses.dataclass(frozen=True)
class Look:
    """What is drawn of each camera of a batch; arguments as of `rasterization`.

    Attributes:
        lead: (..., C), how the cameras are arranged.
        tile_size: of `masks`, pixels.
    """

    lead: tuple[int, ...]
    render_mode: str
    colors: torch.Tensor | None
    sh_degree: int | None
    signals: torch.Tensor | None
    signals_sh_degree: int | None
    backgrounds: torch.Tensor | None
    masks: torch.Tensor | None
    return_normals: bool
    tile_size: int

    def render(self, view: View, place: Place, info: BatchInfo) -> dict[str, torch.Tensor]:
        """Renders one camera; the gradients in pixels go to `info`.

        Returns:
            "colors" (H, W, X) and "alphas" (H, W, 1), and what else is wanted under its name.
        """
        sh, channels = self._list_channels(view, place)
        means, quats, scales, opacities = place.scene
        image, alpha, distances, values = render_view(
            view, means, quats, scales, opacities, place.pose, place.lens, sh=sh,
            features=torch.cat(list(channels.values()), 1) if channels else None,
            pose_end=place.pose_end, means2d=info.get_means2d(place.index),
            wants_means2d=info.is_read,
        )  # fmt: skip
        widths = [channel.shape[1] for channel in channels.values()]
        parts = dict(zip(channels, values.split(widths, -1), strict=True)) if channels else {}
        parts["alphas"] = alpha[..., None]
        if sh is not None:
            parts["colors"] = image
        if self.render_mode.endswith("d"):
            parts["depths"] = distances[..., None]
        if self.masks is not None:
            seen = self.masks[place.index]
            for dim in (0, 1):
                seen = seen.repeat_interleave(self.tile_size, dim)
            seen = seen[: view.height, : view.width, None].to(alpha.dtype)
            parts = {name: part * seen for name, part in parts.items()}
        if self.backgrounds is not None and "colors" in parts:
            behind = (1.0 - parts["alphas"]) * self.backgrounds[place.index]
            parts["colors"] = parts["colors"] + behind
        if "E" in self.render_mode:
            parts["depths"] = parts["depths"] / parts["alphas"].clamp(min=_LEAST_ALPHA)
        shown = [parts.pop(name) for name in ("colors", "depths") if name in parts]
        return {"colors": torch.cat(shown, -1) if len(shown) > 1 else shown[0], **parts}

    def _list_channels(
        self, view: View, place: Place
    ) -> tuple[torch.Tensor | None, dict[str, torch.Tensor]]:
        """Lists harmonics (N, K, 3) that the engine shades, and what it blends as it is."""
        sh, channels = None, {}
        if "RGB" in self.render_mode:
            colors = choose_colors(
                self.colors, self.sh_degree is not None, place.index, self.lead, "colors"
            )
            if colors is None:
                raise InputError(f'render_mode "{self.render_mode}" needs colors')
            if self.sh_degree is None:
                channels["colors"] = colors
            elif colors.shape[-1] == _NUM_COLORS and self.sh_degree <= FULL_DEGREE:
                sh = colors
            else:
                shaded = _shade(place, self.sh_degree, colors)
                channels["colors"] = shaded.clamp(min=0.0)
        if self.render_mode.endswith("D"):
            channels["depths"] = _find_depths(view, place)[:, None]
        if self.return_normals:
            channels[_NORMALS] = _find_normals(place)
        if self.signals is not None:
            degree = self.signals_sh_degree
            signals = choose_colors(
                self.signals, degree is not None, place.index, self.lead, "extra_signals"
            )
            assert signals is not None
            channels[_SIGNALS] = signals if degree is None else _shade(place, degree, signals)
        return sh, channels


def _shade(place: Place, degree: int, coefficients: torch.Tensor) -> torch.Tensor:
    """Evaluates harmonics (N, K, D) towards the camera, about a half."""
    directions = place.scene[0] - find_centers(place.pose, place.pose_end)
    return evaluate_harmonics(degree, directions, coefficients) + _SHIFT


def _find_depths(view: View, place: Place) -> torch.Tensor:
    """Finds the centres' z (N,) in the camera, of a rolling shutter in the middle of exposure."""
    pose, means = place.pose, place.scene[0]
    if place.pose_end is not None:  # a constant: the middle has no gradient to either end
        middle = view.make_motion(pose, place.pose_end).at(0.5)
        pose = torch.tensor(middle.tolist(), dtype=means.dtype)
    return means @ pose[2, :3] + pose[2, 3]


def _find_normals(place: Place) -> torch.Tensor:
    """Finds the Gaussians' z axes (N, 3) in the world, turned to the camera."""
    normals = make_rotations(place.scene[1])[..., 2]
    directions = place.scene[0] - find_centers(place.pose, place.pose_end)
    away = (normals * directions).sum(-1, keepdim=True) > 0
    return torch.where(away, -normals, normals)
